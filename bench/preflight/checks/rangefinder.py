"""The downward range finder, with the vehicle on the ground: it reads the landing gear's height, steadily."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "rangefinder"
LIMITS = (("ground_range_m", "m"), ("ground_range_spread_m", "m"), ("ground_range_messages_hz", "Hz"))
ACTION = "put it on flat ground; check the sensor's plug, RNGFND1_TYPE, RNGFND1_MIN and what is before the sensor"
DOWNWARD = 25


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = [h for h in vehicle.watched("DISTANCE_SENSOR") if int(h.fields["orientation"]) == DOWNWARD]
    ranges = [float(h.fields["current_distance"]) * 0.01 for h in heard]
    seconds = vehicle.boot_seconds()
    none = "" if heard else "no downward DISTANCE_SENSOR came"
    newest = heard[-1].t_s if heard else vehicle.watch_s[1]
    middle = sorted(ranges)[len(ranges) // 2] if ranges else None
    return [
        Finding("ground_range_m", middle, "m", ACTION, heard_s=newest, samples=len(ranges), blocked=none,
                seen="median"),
        Finding("ground_range_spread_m", max(ranges) - min(ranges) if ranges else None, "m", ACTION, heard_s=newest,
                samples=len(ranges), blocked=none),
        Finding("ground_range_messages_hz", len(heard) / seconds if seconds else None, "Hz", ACTION, heard_s=newest,
                seen=none, blocked="" if seconds else "it sent no SYSTEM_TIME to measure the rate with"),
    ]
