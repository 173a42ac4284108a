"""GUIDED may be chosen, and the vehicle stops when the stack falls silent."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check
from saranga.vehicle import MODE_GUIDED

NAME = "guided"
LIMITS = (("guided_blocked", "1"), ("guided_timeout_s", "s"))
ACTION = "clear bit 4 of FLTMODE_GCSBLOCK"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    timeout = vehicle.parameter("GUID_TIMEOUT")
    blocked_modes = vehicle.parameter("FLTMODE_GCSBLOCK")
    closed = bool(int(blocked_modes or 0) >> MODE_GUIDED & 1)
    # A firmware with GUIDED in it has its parameters; 4.5 has no FLTMODE_GCSBLOCK and closes nothing.
    absent = "" if timeout is not None else "the firmware has no GUID_TIMEOUT, so perhaps no GUIDED"
    return [
        Finding("guided_blocked", float(closed), "1", ACTION, heard_s=vehicle.parameters_s, blocked=absent,
                seen="FLTMODE_GCSBLOCK closes GUIDED to the companion" if closed else "GUIDED may be chosen"),
        Finding("guided_timeout_s", timeout, "s", "set GUID_TIMEOUT to 3", heard_s=vehicle.parameters_s,
                blocked=absent, seen="silence before it brakes"),
    ]
