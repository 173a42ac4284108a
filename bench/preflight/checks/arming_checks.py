"""No arming check is switched off: ARMING_CHECK lists what is on, its successor ARMING_SKIPCHK what is off."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "arming checks"
LIMITS = (("arming_checks_skipped", "1"),)
ACTION = "set ARMING_CHECK 1 (all), or ARMING_SKIPCHK 0 (skip none)"
ALL = 1


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    on, off = vehicle.parameter("ARMING_CHECK"), vehicle.parameter("ARMING_SKIPCHK")
    skipped = bool(off) if off is not None else on is not None and not int(on) & ALL
    seen = f"ARMING_SKIPCHK {off:g}" if off is not None else "" if on is None else f"ARMING_CHECK {on:g}"
    return [Finding("arming_checks_skipped", float(skipped), "1", ACTION, heard_s=vehicle.parameters_s, seen=seen,
                    bypassed=f"{seen}: the autopilot arms without its own checks" if skipped else "",
                    blocked="" if seen else "it has neither ARMING_CHECK nor ARMING_SKIPCHK")]
