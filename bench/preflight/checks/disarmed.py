"""The vehicle is disarmed. Gathering stops at the first heartbeat that says otherwise."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding

NAME = "disarmed"
ACTION = "disarm it, take the propellers off, and begin again"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    vehicle = evidence.vehicle
    heard = vehicle.last("HEARTBEAT") if vehicle is not None else None
    if vehicle is None or heard is None:
        return [Finding("vehicle_armed", None, "1", ACTION, blocked=evidence.why_not("vehicle"))]
    return [Finding("vehicle_armed", float(vehicle.armed), "1", ACTION, heard_s=heard.t_s,
                    samples=len(vehicle.all("HEARTBEAT")), seen="vehicle is armed" if vehicle.armed else "disarmed")]
