"""Where heading comes from: a compass that is on and used, or a set-up that does without one; nothing in between."""

import math
from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, Heard, VehicleEvidence, vehicle_check

NAME = "yaw source"
LIMITS = (("yaw_settings_wrong", "1"), ("heading_drift_deg_min", "deg/min"))
ACTION = ("with a compass: EK3_SRC1_YAW 1, COMPASS_ENABLE 1, COMPASS_USE 1; without: EK3_SRC1_YAW 0 and COMPASS_USE 0 "
          "(all of them)")
COMPASS, NONE = 1, 0
USES = ("COMPASS_USE", "COMPASS_USE2", "COMPASS_USE3")


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    source, enabled = vehicle.parameter("EK3_SRC1_YAW"), vehicle.parameter("COMPASS_ENABLE")
    used = [name for name in USES if vehicle.parameters.get(name, 0.0) > 0]
    wrong = []
    if source == COMPASS and (not enabled or not used):
        wrong.append("EK3_SRC1_YAW is 1 (compass), but no compass is enabled and used")
    elif source == NONE and enabled and used:
        wrong.append(f"EK3_SRC1_YAW is 0 (none), but {used[0]} is 1")
    elif source not in (COMPASS, NONE):
        wrong.append(f"EK3_SRC1_YAW is {source if source is None else int(source)}: needs what an indoor vehicle lacks")
    turned, seconds, heard_s = _drift(vehicle)
    return [
        Finding("yaw_settings_wrong", float(len(wrong)), "1", ACTION, heard_s=vehicle.parameters_s,
                seen="; ".join(wrong) or ("from the compass" if source == COMPASS else "free of the compass"),
                blocked="" if vehicle.parameters else "it sent no parameters"),
        Finding("heading_drift_deg_min", None if seconds <= 0 else abs(turned) / seconds * 60.0, "deg/min",
                "keep magnets and currents away; calibrate compass and gyros with the vehicle still", heard_s=heard_s,
                blocked="" if seconds > 0 else "it sent no ATTITUDE"),
    ]


def _drift(vehicle: VehicleEvidence) -> tuple[float, float, float | None]:
    """Degrees turned from the first third of the watch to the last, over how many seconds of the vehicle's clock."""
    heard = vehicle.watched("ATTITUDE")
    third = len(heard) // 3
    if third < 2:
        return 0.0, 0.0, None
    first, last = heard[:third], heard[-third:]
    reference = float(first[0].fields["yaw"])

    def mean(rows: list[Heard], key: Callable[[Heard], float]) -> float:
        return sum(map(key, rows)) / len(rows)

    def yaw(row: Heard) -> float:
        return (float(row.fields["yaw"]) - reference + math.pi) % (2 * math.pi) - math.pi

    def time_s(row: Heard) -> float:
        return float(row.fields["time_boot_ms"]) * 1e-3

    return math.degrees(mean(last, yaw) - mean(first, yaw)), mean(last, time_s) - mean(first, time_s), heard[-1].t_s
