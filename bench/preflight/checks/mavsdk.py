"""The same vehicle through MAVSDK, an independent reader: version, health, battery, log list."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding

NAME = "mavsdk"
LIMITS = (("mavsdk_version_differs", "1"), ("mavsdk_unhealthy", "1"), ("mavsdk_voltage_difference_v", "V"))
ACTION = "two readers of one vehicle disagree: look at both values, and at what else talks on this link"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    seen, vehicle = evidence.mavsdk, evidence.vehicle
    if vehicle is None or vehicle.stopped:
        why = evidence.why_not("vehicle") if vehicle is None else vehicle.stopped
        return [Finding(name, None, unit, ACTION, blocked=why) for name, unit in LIMITS]
    if seen is None or seen.get("failed"):
        # It only confirms what the other checks have read by themselves: without it a remark, not a no.
        why = evidence.absent.get("mavsdk", "it was not asked") if seen is None else str(seen["failed"])
        return [Finding("mavsdk_answers", 0.5, "1", "nothing: the other checks read the vehicle by themselves",
                        heard_s=evidence.now_s, seen=why)]
    major, minor = vehicle.major_minor
    bad = [name for name, good in seen["health"].items() if not good]
    volts = list(vehicle.values("SYS_STATUS", "voltage_battery"))
    both = bool(volts) and seen["voltage_v"] is not None and vehicle.parameter("BATT_MONITOR") != 0.0
    return [
        Finding("mavsdk_version_differs", float([major, minor] != seen["version"][:2]), "1", ACTION,
                heard_s=seen["heard_s"], seen=".".join(map(str, seen["version"]))),
        Finding("mavsdk_unhealthy", float(len(bad)), "1", "calibrate what is named", heard_s=seen["heard_s"],
                seen=", ".join(bad) or ", ".join(seen["health"])),
        Finding("mavsdk_voltage_difference_v", abs(seen["voltage_v"] - volts[-1] * 1e-3) if both else None, "V", ACTION,
                heard_s=seen["heard_s"], blocked="" if both else "one of them has no voltage"),
    ]
