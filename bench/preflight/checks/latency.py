"""The companion's link: round trips of TIMESYNC beside the usual traffic."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, percentile, vehicle_check

NAME = "companion link"
LIMITS = (("round_trip_ms", "ms"), ("round_trip_jitter_ms", "ms"), ("round_trips_lost_share", "1"))
ACTION = "use a faster baud rate, a wire instead of radio, and fewer streams on this link"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    trips, asked = vehicle.round_trips_ms, vehicle.round_trips_asked
    none = "" if trips else "no answer to TIMESYNC came"
    middle = percentile(trips, 0.5)
    return [
        Finding("round_trip_ms", middle if trips else None, "ms", ACTION, samples=len(trips),
                heard_s=vehicle.round_trips_s, blocked=none, seen="median"),
        Finding("round_trip_jitter_ms", percentile(trips, 0.9) - middle if trips else None, "ms", ACTION,
                samples=len(trips), heard_s=vehicle.round_trips_s, blocked=none, seen="90th percentile less median"),
        Finding("round_trips_lost_share", 1.0 - len(trips) / asked if asked else None, "1", ACTION, samples=asked,
                heard_s=vehicle.watch_s[1], seen=f"{len(trips)} of {asked} answered",
                blocked="" if asked else "none was sent"),
    ]
