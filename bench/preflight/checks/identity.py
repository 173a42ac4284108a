"""Who answers: an ArduPilot quadrotor, and one vehicle only."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "identity"
LIMITS = (("vehicle_is_quadrotor", "1"), ("vehicle_is_ardupilot", "1"), ("other_vehicles", "1"))
ACTION = "connect the vehicle that is to fly, and only that one"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.last("HEARTBEAT")
    if heard is None:
        return [Finding(name, None, unit, ACTION, blocked="no heartbeat") for name, unit in LIMITS]
    kind, autopilot = int(heard.fields["type"]), int(heard.fields["autopilot"])
    named = mavlink.enums["MAV_TYPE"].get(kind)
    made = mavlink.enums["MAV_AUTOPILOT"].get(autopilot)
    others = ", ".join(map(str, vehicle.other_vehicles))
    return [
        Finding("vehicle_is_quadrotor", float(kind == mavlink.MAV_TYPE_QUADROTOR), "1",
                "flash ArduCopter, set FRAME_CLASS 1", heard_s=heard.t_s, seen=named.name if named else str(kind)),
        Finding("vehicle_is_ardupilot", float(autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA), "1",
                "flash ArduCopter", heard_s=heard.t_s, seen=made.name if made else str(autopilot)),
        Finding("other_vehicles", float(len(vehicle.other_vehicles)), "1",
                "switch the other vehicle off, or give its link another port", heard_s=heard.t_s,
                seen=f"system {vehicle.system}" + (f"; also system {others}" if others else "")),
    ]
