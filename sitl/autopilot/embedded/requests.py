"""What the embedded autopilot answers: commands, parameters, empty missions, time synchronisation."""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilot.embedded import arming
from sitl.autopilot.embedded.messages import BUILDERS, MIN_INTERVAL_US, STREAMS, Schedule
from sitl.autopilot.embedded.modes import Modes, Setpoint
from sitl.autopilot.embedded.parameters import DEFINITIONS, INDEX
from sitl.autopilot.embedded.vehicle import LAND, WARNING, Vehicle

FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0
ACCEPTED, DENIED, UNSUPPORTED, FAILED = (
    mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED, mavlink.MAV_RESULT_FAILED)
PARAMETERS_A_SLOT = 2
FTP_NAK, FTP_FILE_NOT_FOUND = 129, 10
GLOBAL_FRAMES_RELATIVE = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
GLOBAL_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)

Send = Callable[[Any], None]
Parameters7 = tuple[float, float, float, float, float, float, float]


class Requests:
    """Handles decoded messages that are not sensors or velocity setpoints."""

    def __init__(self, vehicle: Vehicle, modes: Modes, schedule: Schedule, send: Send) -> None:
        self._vehicle = vehicle
        self._modes = modes
        self._schedule = schedule
        self._send = send
        self._next_parameter = len(DEFINITIONS)
        self._handlers: dict[str, Callable[[Any], None]] = {
            "COMMAND_LONG": self._command_long, "COMMAND_INT": self._command_int, "SET_MODE": self._set_mode,
            "PARAM_REQUEST_LIST": self._parameter_list, "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set, "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_COUNT": self._mission_count, "MISSION_CLEAR_ALL": self._mission_clear,
            "REQUEST_DATA_STREAM": self._data_stream, "TIMESYNC": self._timesync, "PING": self._ping,
            "SET_GPS_GLOBAL_ORIGIN": self._origin,
            "SET_POSITION_TARGET_GLOBAL_INT": self._global_target, "FILE_TRANSFER_PROTOCOL": self._file_transfer,
            "LOG_REQUEST_LIST": self._log_list,
        }
        self._commands: dict[int, Callable[[Parameters7], tuple[int, str | None]]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm, mavlink.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            mavlink.MAV_CMD_NAV_LAND: self._land, mavlink.MAV_CMD_DO_SET_MODE: self._mode,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mavlink.MAV_CMD_RUN_PREARM_CHECKS: self._prearm, mavlink.MAV_CMD_CONDITION_YAW: self._yaw,
            mavlink.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
        }

    def handle(self, message: Any) -> None:
        """Act on one message that is for us, or for everybody."""
        handler = self._handlers.get(message.get_type())
        if handler is None:
            return
        target = getattr(message, "target_system", 0)
        if target in (0, self._vehicle.parameters["SYSID_THISMAV"]) and \
                getattr(message, "target_component", 0) in (0, mavlink.MAV_COMP_ID_AUTOPILOT1):
            handler(message)

    def update(self) -> None:
        """Go on with a parameter list that was asked for."""
        for _ in range(PARAMETERS_A_SLOT):
            if self._next_parameter >= len(DEFINITIONS):
                return
            self._send_parameter(self._next_parameter)
            self._next_parameter += 1

    # ---- commands --------------------------------------------------------------------------------
    def _command_long(self, m: Any) -> None:
        self._run(m, (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7))

    def _command_int(self, m: Any) -> None:
        self._run(m, (m.param1, m.param2, m.param3, m.param4, float(m.x), float(m.y), m.z))

    def _run(self, m: Any, parameters: Parameters7) -> None:
        handler = self._commands.get(m.command)
        if handler is None:
            result, reason = UNSUPPORTED, None
        else:
            result, reason = handler(parameters)
        if reason is not None:
            self._vehicle.say(WARNING, reason)
        self._send(mavlink.MAVLink_command_ack_message(m.command, result, 0, 0, m.get_srcSystem(),
                                                       m.get_srcComponent()))

    def _arm(self, p: Parameters7) -> tuple[int, str | None]:
        if p[0] == 1.0:
            reason = arming.arm(self._vehicle, forced=p[1] in (FORCE_ARM, FORCE_DISARM))
        elif p[0] == 0.0:
            reason = arming.disarm(self._vehicle, forced=p[1] == FORCE_DISARM)
        else:
            return DENIED, f"Arm: parameter 1 is {p[0]:g}, must be 0 or 1"
        return (ACCEPTED, None) if reason is None else (FAILED, reason)

    def _takeoff(self, p: Parameters7) -> tuple[int, str | None]:
        reason = self._modes.takeoff(p[6])
        return (ACCEPTED, None) if reason is None else (FAILED, reason)

    def _land(self, p: Parameters7) -> tuple[int, str | None]:
        return self._change(LAND)

    def _mode(self, p: Parameters7) -> tuple[int, str | None]:
        if not math.isfinite(p[0]) or not math.isfinite(p[1]):
            return DENIED, "Mode change refused: not a number"
        if not int(p[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return DENIED, "Mode change refused: not a custom mode"
        return self._change(int(p[1]))

    def _change(self, mode: int) -> tuple[int, str | None]:
        reason = self._modes.change(mode)
        return (ACCEPTED, None) if reason is None else (FAILED, reason)

    def _set_mode(self, m: Any) -> None:
        if m.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            result, reason = self._change(m.custom_mode)
        else:
            result, reason = DENIED, "Mode change refused: not a custom mode"
        if reason is not None:
            self._vehicle.say(WARNING, reason)
        self._send(mavlink.MAVLink_command_ack_message(mavlink.MAVLINK_MSG_ID_SET_MODE, result, 0, 0,
                                                       m.get_srcSystem(), m.get_srcComponent()))

    def _interval(self, p: Parameters7) -> tuple[int, str | None]:
        known = math.isfinite(p[0]) and self._schedule.set(int(p[0]), p[1], self._vehicle.t_us)
        return (ACCEPTED if known else FAILED), None

    def _get_interval(self, p: Parameters7) -> tuple[int, str | None]:
        if not math.isfinite(p[0]) or not 0 <= p[0] < 65536:
            return DENIED, None
        self._send(mavlink.MAVLink_message_interval_message(int(p[0]), self._schedule.interval_us(int(p[0]))))
        return ACCEPTED, None

    def _message(self, p: Parameters7) -> tuple[int, str | None]:
        build = BUILDERS.get(int(p[0])) if math.isfinite(p[0]) else None
        message = build(self._vehicle) if build is not None else None
        if message is None:
            return FAILED, None
        self._send(message)
        return ACCEPTED, None

    def _capabilities(self, p: Parameters7) -> tuple[int, str | None]:
        self._send(BUILDERS[mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION](self._vehicle))
        return ACCEPTED, None

    def _prearm(self, p: Parameters7) -> tuple[int, str | None]:
        for problem in arming.prearm_problems(self._vehicle):
            self._vehicle.say(WARNING, f"PreArm: {problem}")
        return ACCEPTED, None

    def _yaw(self, p: Parameters7) -> tuple[int, str | None]:
        if not all(map(math.isfinite, p[:4])):
            return DENIED, "Yaw refused: not a number"
        angle = math.radians(p[0])
        relative = p[3] == 1.0
        if relative:
            angle = self._vehicle.attitude_rad[2] + (-angle if p[2] < 0 else angle)
        reason = self._modes.turn_to(angle)
        return (ACCEPTED, None) if reason is None else (FAILED, reason)

    def _terminate(self, p: Parameters7) -> tuple[int, str | None]:
        if p[0] != 1.0:
            return DENIED, None
        arming.disarm(self._vehicle, forced=True)
        return ACCEPTED, None

    # ---- parameters ------------------------------------------------------------------------------
    def _send_parameter(self, index: int) -> None:
        definition = DEFINITIONS[index]
        self._send(mavlink.MAVLink_param_value_message(
            definition.name.encode(), self._vehicle.parameters[definition.name], definition.kind, len(DEFINITIONS),
            index))

    def _parameter_list(self, m: Any) -> None:
        self._next_parameter = 0

    def _parameter_read(self, m: Any) -> None:
        index = m.param_index if m.param_index >= 0 else INDEX.get(_name(m.param_id), -1)
        if 0 <= index < len(DEFINITIONS):
            self._send_parameter(index)
            return
        self._send(mavlink.MAVLink_param_error_message(
            m.get_srcSystem(), m.get_srcComponent(), _name(m.param_id).encode()[:16], m.param_index,
            mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST))

    def _parameter_set(self, m: Any) -> None:
        name = _name(m.param_id)
        reason = self._vehicle.parameters.set(name, m.param_value)
        if reason is not None:
            self._vehicle.say(WARNING, f"PARAM refused: {reason}")
        if name in INDEX:
            self._send_parameter(INDEX[name])

    # ---- the rest --------------------------------------------------------------------------------
    def _mission_list(self, m: Any) -> None:
        self._send(mavlink.MAVLink_mission_count_message(m.get_srcSystem(), m.get_srcComponent(), 0, m.mission_type))

    def _mission_count(self, m: Any) -> None:
        self._vehicle.say(WARNING, "Missions are not supported")
        self._send(mavlink.MAVLink_mission_ack_message(m.get_srcSystem(), m.get_srcComponent(),
                                                       mavlink.MAV_MISSION_UNSUPPORTED, m.mission_type))

    def _mission_clear(self, m: Any) -> None:
        self._send(mavlink.MAVLink_mission_ack_message(m.get_srcSystem(), m.get_srcComponent(),
                                                       mavlink.MAV_MISSION_ACCEPTED, m.mission_type))

    def _data_stream(self, m: Any) -> None:
        on = m.start_stop == 1 and m.req_message_rate > 0
        interval_us = max(1e6 / m.req_message_rate, MIN_INTERVAL_US) if on else -1.0
        groups = [m.req_stream_id] if m.req_stream_id != mavlink.MAV_DATA_STREAM_ALL else list(STREAMS)
        for group in groups:
            for message_id in STREAMS.get(group, ()):
                self._schedule.set(message_id, interval_us, self._vehicle.t_us)

    def _timesync(self, m: Any) -> None:
        if m.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(self._vehicle.t_us * 1000, m.ts1))

    def _ping(self, m: Any) -> None:
        if m.target_system == 0:
            self._send(mavlink.MAVLink_ping_message(m.time_usec, m.seq, m.get_srcSystem(), m.get_srcComponent()))

    def _log_list(self, m: Any) -> None:
        """It keeps no log: an empty list."""
        self._send(mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))

    def _file_transfer(self, m: Any) -> None:
        """There are no files: say so at once, so that ground stations need not wait for it."""
        sequence = (m.payload[0] | m.payload[1] << 8) + 1 & 0xFFFF
        reply = [sequence & 0xFF, sequence >> 8, m.payload[2], FTP_NAK, 1, m.payload[3], 0, 0, 0, 0, 0, 0,
                 FTP_FILE_NOT_FOUND]
        self._send(mavlink.MAVLink_file_transfer_protocol_message(
            0, m.get_srcSystem(), m.get_srcComponent(), reply + [0] * (251 - len(reply))))

    def _origin(self, m: Any) -> None:
        self._vehicle.set_origin(m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3)
        if self._vehicle.origin is not None:
            for message_id in (mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
                self._send(BUILDERS[message_id](self._vehicle))

    def _global_target(self, m: Any) -> None:
        vehicle = self._vehicle
        reason = None
        if m.type_mask & 0x007:
            reason = "only positions in global frames"
        elif m.coordinate_frame not in GLOBAL_FRAMES + GLOBAL_FRAMES_RELATIVE:
            reason = f"frame {m.coordinate_frame} (use 0, 3, 5 or 6)"
        elif vehicle.origin is None or not math.isfinite(m.alt):
            reason = "no origin, or no height"
        if reason is not None or vehicle.origin is None:
            vehicle.say(WARNING, f"Setpoint refused: {reason}")
            self._modes.stop()
            return
        north, east = vehicle.local_m(m.lat_int * 1e-7, m.lon_int * 1e-7)
        height = m.alt if m.coordinate_frame in GLOBAL_FRAMES_RELATIVE else m.alt - vehicle.origin[2]
        down = -max(height, 0.0) - vehicle.parameters["RNGFND1_GNDCLR"]
        yaw = None if m.type_mask & 0x400 or not math.isfinite(m.yaw) else m.yaw
        self._modes.set_target(Setpoint(vehicle.t_us, position=(north, east, down), yaw_rad=yaw))


def _name(param_id: str | bytes) -> str:
    text = param_id.decode("ascii", "replace") if isinstance(param_id, bytes) else param_id
    return text.rstrip("\0")
