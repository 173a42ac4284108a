"""The vehicle knows where it is: without GPS somebody must tell it, or GUIDED is refused."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "origin"
LIMITS = (("origin_known", "1"),)
ACTION = "send SET_GPS_GLOBAL_ORIGIN once from the ground station (docs/ground-stations.md)"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.last("GPS_GLOBAL_ORIGIN")
    asked_s = vehicle.watch_s[1]
    if heard is None:
        return [Finding("origin_known", 0.0, "1", ACTION, heard_s=asked_s, seen="it was asked, and told none")]
    where = f"{heard.fields['latitude'] * 1e-7:.5f}, {heard.fields['longitude'] * 1e-7:.5f}"
    return [Finding("origin_known", 1.0, "1", ACTION, heard_s=heard.t_s, seen=where)]
