"""What may be written to a vehicle: a list of what is harmless; everything else is dropped and counted.

Preflight's own requests and those of MAVSDK pass through here, so neither can arm, take off, change a mode, spin a
motor or move a servo, whatever the code above does. Parameters are written only while `parameters_open`.
"""

import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.byte_links import ByteLink
from sitl.autopilot.frames import Frame, FrameReader

READ_ONLY_MESSAGES = frozenset({
    mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST, mavlink.MAVLINK_MSG_ID_TIMESYNC, mavlink.MAVLINK_MSG_ID_PING,
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_LIST, mavlink.MAVLINK_MSG_ID_LOG_REQUEST_DATA,
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_END,
})
READ_ONLY_COMMANDS = frozenset({
    mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS, mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION,
})
# COMMAND_LONG on the wire: seven floats, then the command.
_COMMAND = struct.Struct("<7fH")


def harmless(frame: Frame, parameters_open: bool = False) -> bool:
    """Whether a frame only asks, or sets how often this link is told something."""
    if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
        return _COMMAND.unpack_from(frame.payload)[7] in READ_ONLY_COMMANDS
    if frame.message_id == mavlink.MAVLINK_MSG_ID_PARAM_SET:
        return parameters_open
    return frame.message_id in READ_ONLY_MESSAGES


class GuardedLink:
    """A byte link whose `write` lets harmless MAVLink frames through and nothing else.

    Attributes:
        parameters_open: PARAM_SET may pass (after a confirmation).
        dropped: message ids that were not let through, in order.
    """

    def __init__(self, link: ByteLink) -> None:
        self._link = link
        self._reader = FrameReader()
        self.url = link.url
        self.parameters_open = False
        self.dropped: list[int] = []

    def read(self, timeout_s: float) -> bytes:
        return self._link.read(timeout_s)

    def write(self, data: bytes) -> None:
        passed = b""
        for frame in self._reader.feed(data):
            if harmless(frame, self.parameters_open):
                passed += frame.raw
            else:
                self.dropped.append(frame.message_id)
        if passed:
            self._link.write(passed)

    def close(self) -> None:
        self._link.close()
