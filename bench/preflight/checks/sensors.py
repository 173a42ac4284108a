"""Every sensor that is present and switched on is healthy, by the autopilot's own word."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "sensors"
LIMITS = (("sensors_unhealthy", "1"), ("sensors_absent", "1"))
ACTION = "check the plug of the sensor named, and power the vehicle up anew while it stands still"
# Other checks look at these, or they do not fly here.
ELSEWHERE = (mavlink.MAV_SYS_STATUS_PREARM_CHECK | mavlink.MAV_SYS_STATUS_SENSOR_GPS
             | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER | mavlink.MAV_SYS_STATUS_TERRAIN
             | mavlink.MAV_SYS_STATUS_GEOFENCE | mavlink.MAV_SYS_STATUS_LOGGING)
NEEDED = {mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO: "gyro", mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL: "accelerometer",
          mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE: "barometer",
          mavlink.MAV_SYS_STATUS_SENSOR_OPTICAL_FLOW: "optical flow",
          mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION: "range finder",
          mavlink.MAV_SYS_STATUS_SENSOR_BATTERY: "battery"}


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("SYS_STATUS")
    if not heard:
        return [Finding(name, None, unit, ACTION, blocked="it sent no SYS_STATUS") for name, unit in LIMITS]
    bad, absent = 0, 0
    for status in heard:
        present, enabled, health = (int(status.fields[f"onboard_control_sensors_{key}"])
                                    for key in ("present", "enabled", "health"))
        bad |= present & enabled & ~health & ~ELSEWHERE
        absent |= ~(present & enabled) & sum(NEEDED)
    return [
        Finding("sensors_unhealthy", float(bad.bit_count()), "1", ACTION, samples=len(heard), heard_s=heard[-1].t_s,
                seen=_names(bad)),
        Finding("sensors_absent", float(absent.bit_count()), "1", "plug it in and switch it on by its parameter",
                samples=len(heard), heard_s=heard[-1].t_s, seen=_names(absent)),
    ]


def _names(bits: int) -> str:
    known = mavlink.enums["MAV_SYS_STATUS_SENSOR"]
    found = [known[bit].name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_").lower().replace("_", " ")
             for bit in sorted(known) if bit & bits and bit.bit_count() == 1]
    return ", ".join(found)
