"""The firmware's version: one that this bench has been flown with."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check
from saranga.vehicle import version_text

NAME = "firmware"
LIMITS = (("firmware_version", "version"),)
ACTION = "flash ArduCopter 4.5 to 4.7"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.last("AUTOPILOT_VERSION")
    if heard is None:
        return [Finding("firmware_version", None, "version", ACTION,
                        blocked="it did not answer when asked for AUTOPILOT_VERSION")]
    major, minor = vehicle.major_minor
    seen = f"{version_text(vehicle.version)} {vehicle.firmware_hash}"
    name = "firmware_embedded_version" if vehicle.embedded else "firmware_version"
    return [Finding(name, major + minor / 100.0, "version", ACTION, heard_s=heard.t_s, seen=seen)]
