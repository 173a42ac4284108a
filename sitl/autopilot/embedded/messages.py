"""What the embedded autopilot says: one builder a message, and the rates at which they go out."""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.arming import prearm_problems
from sitl.autopilot.embedded.vehicle import Vehicle

BANNER = "saranga-bench embedded autopilot"
CUSTOM_VERSION = b"EMBEDDED"
SOFTWARE_VERSION = 0 << 24 | 1 << 16 | 0 << 8  # 0.1.0, development
MIN_INTERVAL_US = 10_000
CELL_COUNT = 4

# ArduCopter with flow reports 367 when its relative position is good, and bit 128 while it is held constant.
_ATTITUDE, _VEL_HORIZ, _VEL_VERT, _POS_REL, _POS_VERT = 1, 2, 4, 8, 32
_POS_AGL, _CONST_POS, _PRED_REL = 64, 128, 256

_SENSORS = (mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
            | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
            | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
            | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
            | mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
            | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
            | mavlink.MAV_SYS_STATUS_AHRS | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
            | mavlink.MAV_SYS_STATUS_PREARM_CHECK)
_FLOW, _RANGE = mavlink.MAV_SYS_STATUS_SENSOR_OPTICAL_FLOW, mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION


def boot_ms(v: Vehicle) -> int:
    return (v.t_us // 1000) & 0xFFFFFFFF


def heartbeat(v: Vehicle) -> Any:
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    if v.aided:
        base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    if v.armed:
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if v.failsafe:
        status = mavlink.MAV_STATE_CRITICAL
    elif not v.estimator_ready:
        status = mavlink.MAV_STATE_BOOT
    else:
        status = mavlink.MAV_STATE_ACTIVE if v.armed and not v.landed else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
                                             base, v.mode, status, 3)


def battery_percent(v: Vehicle) -> int:
    capacity = v.parameters["BATT_CAPACITY"]
    return round(min(max(100.0 * (1.0 - v.used_mah / capacity), 0.0), 100.0)) if capacity > 0 else -1


def sys_status(v: Vehicle) -> Any:
    present = _SENSORS
    if v.parameters["FLOW_TYPE"] > 0:
        present |= _FLOW
    if v.parameters["RNGFND1_TYPE"] > 0:
        present |= _RANGE
    health = present | mavlink.MAV_SYS_STATUS_GEOFENCE  # not present, not breached: as ArduPilot without a fence
    if not v.flow_fresh:
        health &= ~_FLOW
    if float(v.estimate[at.RANGE_AGE]) > 0.5:
        health &= ~_RANGE
    if not v.gyros_ready:
        health &= ~mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    if not v.estimator_ready:
        health &= ~mavlink.MAV_SYS_STATUS_AHRS
    if not v.armed and prearm_problems(v):
        health &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
    return mavlink.MAVLink_sys_status_message(
        present, present, health, 100, min(max(round(v.voltage_v * 1000), 0), 65534),
        min(round(v.current_a * 100), 32767), battery_percent(v), 0, 0, 0, 0, 0, 0)


def ekf_flags(v: Vehicle) -> int:
    """EKF_STATUS_REPORT flags; 0 until the estimator runs."""
    if not v.estimator_ready:
        return 0
    flags = _ATTITUDE | _VEL_VERT | _POS_VERT
    if v.range_fresh:
        flags |= _POS_AGL
    if v.aided:
        return flags | _VEL_HORIZ | _POS_REL | _PRED_REL
    return flags | _CONST_POS


def ekf_status_report(v: Vehicle) -> Any:
    # The observer has no covariances: the figures grow with the age of the sensor, over 1 when it is lost.
    flow = min(float(v.estimate[at.FLOW_AGE]) / 0.9, 5.0)
    height = min(float(v.estimate[at.RANGE_AGE]) / 5.4, 5.0)
    return mavlink.MAVLink_ekf_status_report_message(ekf_flags(v), flow, flow, 0.0, 0.0, height, 0.0)


def attitude(v: Vehicle) -> Any:
    return mavlink.MAVLink_attitude_message(boot_ms(v), *v.attitude_rad, *v.rates_rad_s)


def attitude_quaternion(v: Vehicle) -> Any:
    return mavlink.MAVLink_attitude_quaternion_message(boot_ms(v), *(float(q) for q in v.estimate[:4]),
                                                       *v.rates_rad_s)


def local_position_ned(v: Vehicle) -> Any | None:
    if not v.estimator_ready or v.origin is None:
        return None
    return mavlink.MAVLink_local_position_ned_message(boot_ms(v), *v.position_m, *v.velocity_m_s)


def heading_rad(v: Vehicle) -> float:
    return v.attitude_rad[2] % (2.0 * math.pi)


def global_position_int(v: Vehicle) -> Any | None:
    if v.origin is None:
        return None
    latitude, longitude = v.latitude_longitude_deg()
    speeds = [max(min(round(s * 100), 32767), -32768) for s in v.velocity_m_s]
    return mavlink.MAVLink_global_position_int_message(
        boot_ms(v), round(latitude * 1e7), round(longitude * 1e7), round((v.origin[2] + v.height_m) * 1000),
        round((v.height_m - v.home_height_m) * 1000), *speeds,
        round(math.degrees(heading_rad(v)) * 100) % 36000)


def vfr_hud(v: Vehicle) -> Any:
    north, east, down = v.velocity_m_s
    speed = math.hypot(north, east)
    return mavlink.MAVLink_vfr_hud_message(
        speed, speed, round(math.degrees(heading_rad(v))) % 360, round(100.0 * float(v.estimate[at.THRUST])),
        (v.origin[2] if v.origin else 0.0) + v.height_m, -down)


def battery_status(v: Vehicle) -> Any:
    cell = min(max(round(v.voltage_v * 1000 / CELL_COUNT), 0), 65534)
    return mavlink.MAVLink_battery_status_message(
        0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, 32767,
        [cell] * CELL_COUNT + [65535] * (10 - CELL_COUNT), min(round(v.current_a * 100), 32767),
        round(v.used_mah), -1, battery_percent(v))


def landed_state(v: Vehicle) -> int:
    if v.landed:
        return mavlink.MAV_LANDED_STATE_ON_GROUND
    if v.taking_off:
        return mavlink.MAV_LANDED_STATE_TAKEOFF
    return mavlink.MAV_LANDED_STATE_LANDING if v.landing else mavlink.MAV_LANDED_STATE_IN_AIR


def extended_sys_state(v: Vehicle) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state(v))


def gps_raw_int(v: Vehicle) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(v.t_us, mavlink.GPS_FIX_TYPE_NO_GPS, 0, 0, 0, 65535, 65535, 65535,
                                               65535, 0)


def home_position(v: Vehicle) -> Any | None:
    if v.origin is None:
        return None
    latitude, longitude, altitude = v.origin
    return mavlink.MAVLink_home_position_message(
        round(latitude * 1e7), round(longitude * 1e7), round((altitude + v.home_height_m) * 1000), 0.0, 0.0,
        -v.home_height_m, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, v.t_us)


def gps_global_origin(v: Vehicle) -> Any | None:
    if v.origin is None:
        return None
    latitude, longitude, altitude = v.origin
    return mavlink.MAVLink_gps_global_origin_message(round(latitude * 1e7), round(longitude * 1e7),
                                                     round(altitude * 1000), v.t_us)


def system_time(v: Vehicle) -> Any:
    return mavlink.MAVLink_system_time_message(0, boot_ms(v))


def distance_sensor(v: Vehicle) -> Any | None:
    height = float(v.estimate[at.RANGE_Z])
    if not math.isfinite(height):
        return None
    p = v.parameters
    return mavlink.MAVLink_distance_sensor_message(
        boot_ms(v), round(p["RNGFND1_MIN"] * 100), round(p["RNGFND1_MAX"] * 100),
        min(max(round(height * 100), 0), 65535), mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 0,
        mavlink.MAV_SENSOR_ROTATION_PITCH_270, 0)


def optical_flow(v: Vehicle) -> Any | None:
    if v.flow_rate_rad_s is None:
        return None
    x, y = v.flow_rate_rad_s
    height = max(float(v.estimate[at.RANGE_Z]), 0.0) if math.isfinite(float(v.estimate[at.RANGE_Z])) else 0.0
    return mavlink.MAVLink_optical_flow_message(boot_ms(v), 0, 0, 0, x * height, y * height, v.flow_quality, height,
                                                x, y)


def vibration(v: Vehicle) -> Any:
    """Its inertial sensors have white noise only, no vibration."""
    return mavlink.MAVLink_vibration_message(v.t_us, 0.0, 0.0, 0.0, 0, 0, 0)


def autopilot_version(v: Vehicle) -> Any:
    capabilities = (mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
                    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
                    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
                    | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2)
    return mavlink.MAVLink_autopilot_version_message(
        capabilities, SOFTWARE_VERSION, 0, 0, 0, list(CUSTOM_VERSION), [0] * 8, [0] * 8, 0, 0, 0x5A4A)


BUILDERS: dict[int, Callable[[Vehicle], Any | None]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw_int,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position_ned,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position_int,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: distance_sensor,
    mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW: optical_flow,
    mavlink.MAVLINK_MSG_ID_VIBRATION: vibration,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
}

# ArduPilot's stream groups, for REQUEST_DATA_STREAM.
STREAMS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE),
}
DEFAULT_INTERVALS_US = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1_000_000,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1_000_000,
}


class Schedule:
    """When each message is next due."""

    def __init__(self) -> None:
        self._interval_us = dict(DEFAULT_INTERVALS_US)
        self._next_us = dict.fromkeys(self._interval_us, 0)
        self._earliest_us = 0

    def interval_us(self, message_id: int) -> int:
        """Microseconds between two, -1 when it is off, 0 when there is no such message."""
        if message_id not in BUILDERS:
            return 0
        return self._interval_us.get(message_id, -1)

    def set(self, message_id: int, interval_us: float, t_us: int) -> bool:
        """Microseconds between two; 0 is the default rate, below 0 is off. False for an unknown message."""
        if message_id not in BUILDERS or not math.isfinite(interval_us):
            return False
        if interval_us == 0:
            interval_us = DEFAULT_INTERVALS_US.get(message_id, -1)
        if interval_us < 0:
            # The heartbeat cannot be switched off: ground stations would call the link dead.
            if message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._interval_us.pop(message_id, None)
                self._next_us.pop(message_id, None)
            return True
        self._interval_us[message_id] = max(round(interval_us), MIN_INTERVAL_US)
        self._next_us[message_id] = t_us
        self._earliest_us = t_us
        return True

    def due(self, t_us: int) -> list[int]:
        """Messages to send now."""
        if t_us < self._earliest_us:
            return []
        ready = []
        for message_id, next_us in self._next_us.items():
            if next_us <= t_us:
                ready.append(message_id)
                self._next_us[message_id] = max(next_us + self._interval_us[message_id], t_us + MIN_INTERVAL_US)
        self._earliest_us = min(self._next_us.values())
        return ready
