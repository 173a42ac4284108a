"""The bytes that docs/companion.md shows, made by the project's own code."""

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.navigate import VelocityCommand
from saranga.vehicle import VehicleLink
from saranga.wire import Echo, HelloRequest, Start, encode

IQ = np.array([[0, 0], [1, -2], [256, -20984]], np.int16)


def setpoint() -> bytes:
    link = VehicleLink()
    link._mav.seq = 7
    link.send_velocity(VelocityCommand(1.0, -0.25, 0.5, 0.1), 2_000_000)
    return link.take()


def from_vehicle(message: mavlink.MAVLink_message) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))


def examples() -> dict[str, bytes]:
    """By the name that stands before them in the document."""
    return {
        "HELLO?": encode(HelloRequest()),
        "START": encode(Start(mode=0, rate_hz=39.0625, sequence=1)),
        "ECHO": encode(Echo(sensor=1, sequence=0x01020304, trigger=0x0A0B0C0D, device_time_us=0xFFFFFFFE, flags=1,
                            fop_hz=53000.0, odr=6, mode=1, iq=IQ)),
        "HEARTBEAT": from_vehicle(mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4,
            mavlink.MAV_STATE_ACTIVE, 3)),
        "EXTENDED_SYS_STATE": from_vehicle(mavlink.MAVLink_extended_sys_state_message(
            0, mavlink.MAV_LANDED_STATE_IN_AIR)),
        "TIMESYNC": from_vehicle(mavlink.MAVLink_timesync_message(0, 0x0102030405060708)),
        "SET_POSITION_TARGET_LOCAL_NED": setpoint(),
    }
