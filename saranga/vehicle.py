"""The MAVLink link to the autopilot: what it says, and what we ask of it. Bytes in, bytes out; no I/O.

The same class serves the stack (component 191, onboard computer) and the harness's ground station
(system 255). Only the target system's messages change `status`: a foreign system on the same wire cannot.

Sources: MAVLink common dialect; ArduPilot developer guide "Copter Commands in Guided Mode".
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.navigate.base import VelocityCommand
from saranga.signing import SigningMavlink

# Velocity and yaw rate are used, position, acceleration and yaw are ignored.
VELOCITY_TYPE_MASK = 0b010111000111
# ArduCopter refuses frame 12 (BODY_FRD) and stops; 8 is the body-fixed NED frame it takes.
BODY_FRAME = mavlink.MAV_FRAME_BODY_NED

EKF_HORIZONTAL_VELOCITY = 8
EKF_CONST_POSITION = 128

MODE_NAMES = {0: "STABILIZE", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 9: "LAND", 16: "POSHOLD",
              17: "BRAKE", 20: "GUIDED_NOGPS"}
MODE_GUIDED = 4
MODE_LAND = 9


@dataclass
class VehicleStatus:
    """What the autopilot last said. Times are the caller's microseconds; None means never heard."""

    heartbeat_us: int | None = None
    mode: int | None = None
    armed: bool = False
    prearm_ok: bool = False
    ekf_flags: int | None = None
    landed_state: int | None = None
    position_m: tuple[float, float, float] | None = None
    velocity_m_s: tuple[float, float, float] | None = None
    position_us: int | None = None
    voltage_v: float | None = None
    firmware_version: int | None = None
    firmware_hash: str = ""
    vehicle_type: int | None = None
    autopilot_type: int | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    acks: dict[int, int] = field(default_factory=dict)
    texts: deque[tuple[int, int, str]] = field(default_factory=lambda: deque(maxlen=200))

    @property
    def mode_name(self) -> str:
        return "unknown" if self.mode is None else MODE_NAMES.get(self.mode, f"mode {self.mode}")

    @property
    def flow_aiding(self) -> bool:
        """The EKF has a horizontal velocity and is not merely holding its position constant."""
        flags = self.ekf_flags or 0
        return bool(flags & EKF_HORIZONTAL_VELOCITY) and not flags & EKF_CONST_POSITION

    def last_text(self, *words: str) -> str:
        """The newest STATUSTEXT that contains any of `words` (any text when none are given), else ''."""
        for _, _, text in reversed(self.texts):
            if not words or any(word.lower() in text.lower() for word in words):
                return text
        return ""


class VehicleLink:
    """One MAVLink endpoint talking to one vehicle.

    Args:
        system_id: our own system id (the vehicle's own id for a companion, 255 for a ground station).
        component_id: ours; 191 is the onboard computer.
        target_system: the vehicle we listen to and command.
        sign_key: 32 bytes: sign what is sent, hear only what is signed with them (`saranga.signing`). None: neither.
    """

    def __init__(self, system_id: int = 1, component_id: int = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER,
                 target_system: int = 1, vehicle_type: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                 sign_key: bytes | None = None) -> None:
        self._signing = SigningMavlink(system_id, component_id, sign_key) if sign_key is not None else None
        self._mav = self._signing or mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._mav.robust_parsing = True
        self._vehicle_type = vehicle_type
        self.target_system = target_system
        self.status = VehicleStatus()
        self.foreign_messages = 0
        self.bad_messages = 0
        self._out = bytearray()
        self._chunk = (0, 0)
        self._handlers = {
            "HEARTBEAT": self._on_heartbeat, "SYS_STATUS": self._on_sys_status,
            "EKF_STATUS_REPORT": self._on_ekf, "EXTENDED_SYS_STATE": self._on_extended,
            "LOCAL_POSITION_NED": self._on_position, "STATUSTEXT": self._on_text,
            "COMMAND_ACK": self._on_ack, "PARAM_VALUE": self._on_parameter,
            "AUTOPILOT_VERSION": self._on_version, "TIMESYNC": self._on_timesync,
        }

    # ---- bytes -----------------------------------------------------------------------------------
    def feed(self, data: bytes, t_us: int) -> list[Any]:
        """Take received bytes; returns the messages of the target vehicle, after `status` took them in.

        Never raises on rubbish: what does not parse is counted in `bad_messages`.
        """
        if not data:
            return []
        messages = self._mav.parse_buffer(data) or []
        mine = []
        for message in messages:
            kind = message.get_type()
            if kind == "BAD_DATA":
                self.bad_messages += 1
                continue
            if message.get_srcSystem() != self.target_system or message.get_srcComponent() != 1:
                self.foreign_messages += 1
                continue
            handler = self._handlers.get(kind)
            if handler is not None:
                handler(message, t_us)
            mine.append(message)
        return mine

    def take(self) -> bytes:
        """Bytes to send, in order; the queue is emptied."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def send(self, message: Any) -> None:
        """Queue any MAVLink message of the ardupilotmega dialect."""
        if self._signing is not None:
            self._signing.advance_clock()
        self._out += message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) & 0xFF  # pack() does not count; a receiver sees losses by it

    # ---- requests --------------------------------------------------------------------------------
    def send_heartbeat(self) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(
            self._vehicle_type, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))

    def send_velocity(self, command: VelocityCommand, t_us: int) -> None:
        """Body-frame velocity and yaw rate setpoint (SET_POSITION_TARGET_LOCAL_NED)."""
        self.send(mavlink.MAVLink_set_position_target_local_ned_message(
            (t_us // 1000) & 0xFFFFFFFF, self.target_system, 1, BODY_FRAME, VELOCITY_TYPE_MASK,
            0.0, 0.0, 0.0, command.vx_m_s, command.vy_m_s, command.vz_m_s, 0.0, 0.0, 0.0,
            0.0, command.yaw_rate_rad_s))

    def send_command(self, command: int, *parameters: float) -> None:
        """COMMAND_LONG with up to seven parameters; its answer appears in `status.acks[command]`."""
        filled = [*parameters, *([0.0] * (7 - len(parameters)))]
        self.status.acks.pop(command, None)
        self.send(mavlink.MAVLink_command_long_message(self.target_system, 1, command, 0, *filled))

    def send_mode(self, mode: int) -> None:
        self.send_command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode)

    def send_message_interval(self, message_id: int, rate_hz: float) -> None:
        interval_us = -1.0 if rate_hz <= 0 else 1e6 / rate_hz
        self.send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)

    def request_message(self, message_id: int) -> None:
        self.send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)

    def request_parameter(self, name: str) -> None:
        self.send(mavlink.MAVLink_param_request_read_message(self.target_system, 1, name.encode(), -1))

    def send_origin(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN: without GPS the estimator needs to be told where it is."""
        self.send(mavlink.MAVLink_set_gps_global_origin_message(
            self.target_system, round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1000)))

    # ---- what the vehicle says -------------------------------------------------------------------
    def _on_heartbeat(self, message: Any, t_us: int) -> None:
        status = self.status
        status.heartbeat_us = t_us
        status.mode = message.custom_mode
        status.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        status.vehicle_type = message.type
        status.autopilot_type = message.autopilot

    def _on_sys_status(self, message: Any, t_us: int) -> None:
        self.status.prearm_ok = bool(message.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
        self.status.voltage_v = message.voltage_battery / 1000.0

    def _on_ekf(self, message: Any, t_us: int) -> None:
        self.status.ekf_flags = message.flags

    def _on_extended(self, message: Any, t_us: int) -> None:
        self.status.landed_state = message.landed_state

    def _on_position(self, message: Any, t_us: int) -> None:
        self.status.position_m = (message.x, message.y, message.z)
        self.status.velocity_m_s = (message.vx, message.vy, message.vz)
        self.status.position_us = t_us

    def _on_text(self, message: Any, t_us: int) -> None:
        """Texts over 50 characters come in chunks of one id, in order; a missing chunk starts a text of its own."""
        text = message.text.rstrip("\0")
        texts = self.status.texts
        if message.id and message.chunk_seq and self._chunk == (message.id, message.chunk_seq - 1) and texts:
            first_us, severity, begun = texts.pop()
            texts.append((first_us, severity, begun + text))
        else:
            texts.append((t_us, message.severity, text))
        self._chunk = (message.id, message.chunk_seq)

    def _on_ack(self, message: Any, t_us: int) -> None:
        self.status.acks[message.command] = message.result

    def _on_parameter(self, message: Any, t_us: int) -> None:
        self.status.parameters[message.param_id] = message.param_value

    def _on_version(self, message: Any, t_us: int) -> None:
        self.status.firmware_version = message.flight_sw_version
        self.status.firmware_hash = bytes(message.flight_custom_version).rstrip(b"\0").decode("ascii", "replace")

    def _on_timesync(self, message: Any, t_us: int) -> None:
        """The vehicle asks what time it is here: the caller's microseconds, as in `time_boot_ms` of the setpoints."""
        if message.tc1 == 0:
            self.send(mavlink.MAVLink_timesync_message(max(t_us, 1) * 1000, message.ts1))


def version_text(packed: int | None) -> str:
    """AUTOPILOT_VERSION.flight_sw_version as text: 0x04070000 is "4.7.0-dev", type byte 255 is official."""
    if packed is None:
        return "unknown"
    kind = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}.get(packed & 0xFF, f"-type{packed & 0xFF}")
    return f"{packed >> 24 & 0xFF}.{packed >> 16 & 0xFF}.{packed >> 8 & 0xFF}{kind}"
