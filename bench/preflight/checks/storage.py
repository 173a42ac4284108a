"""The flight will be recorded: the autopilot's log is on and healthy."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "storage"
LIMITS = (("log_healthy", "1"),)
ACTION = "put a card in (or clear it) and set LOG_BACKEND_TYPE 1"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    status, backend = vehicle.last("SYS_STATUS"), vehicle.parameter("LOG_BACKEND_TYPE")
    logs = vehicle.last("LOG_ENTRY")
    listed = "" if logs is None else f"{int(logs.fields['num_logs'])} logs kept"
    if status is None:
        return [Finding("log_healthy", None, "1", ACTION, blocked="it sent no SYS_STATUS")]
    if vehicle.embedded:
        return [Finding("log_healthy", 0.5, "1", "nothing: the bench keeps the record of embedded flights",
                        heard_s=status.t_s, seen="the embedded autopilot keeps no log")]
    bit = mavlink.MAV_SYS_STATUS_LOGGING
    healthy = all(int(status.fields[f"onboard_control_sensors_{key}"]) & bit for key in ("present", "health"))
    off = backend is not None and int(backend) == 0
    return [Finding("log_healthy", float(healthy and not off), "1", ACTION, heard_s=status.t_s, seen=listed,
                    bypassed="LOG_BACKEND_TYPE is 0: the flight leaves no record" if off else "")]
