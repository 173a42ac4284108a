"""Nothing alarming was said while we listened."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "messages"
LIMITS = (("alarming_texts", "1"),)
ACTION = "do what the autopilot's message says"
ERROR_SEVERITY = 3


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    alarming = list(dict.fromkeys(text for _, severity, text in vehicle.texts
                                  if severity <= ERROR_SEVERITY and not text.lower().startswith("prearm")))
    return [Finding("alarming_texts", float(len(alarming)), "1", ACTION, heard_s=vehicle.watch_s[1],
                    samples=len(vehicle.texts) + 1, seen="; ".join(alarming[:3]))]
