"""MAVLink as an enemy sends it: rubbish, damaged frames, and frames that are right in form and mad in content."""

import math
import struct

from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
SIZES = {number: (kind.unpacker.size, kind.crc_extra) for number, kind in mavlink.mavlink_map.items() if number >= 0}
HANDLED = [0, 1, 11, 20, 21, 22, 23, 24, 30, 32, 43, 44, 45, 48, 66, 69, 70, 75, 76, 77, 82, 84, 86, 100, 106, 110, 111,
           117, 119, 132, 148, 193, 241, 245, 253]
"""What some listener of the project does something with, and what steers other autopilots (joystick, RC, actuators)."""
ODD = st.sampled_from([0.0, 1.0, -1.0, 0.5, 2.0, 1.0000001, 2989.0, 21196.0, 4.0, 1e38, -1e38, math.nan, math.inf,
                       -math.inf])


def frame(message_id: int, payload: bytes, system: int, component: int, sequence: int = 0, version: int = 2) -> bytes:
    """A whole frame with the right checksum, whatever its payload says."""
    extra = SIZES[message_id][1]
    if version == 1 and message_id < 256:
        body = bytes([len(payload), sequence, system, component, message_id]) + payload
        head = b"\xfe"
    else:
        body = bytes([len(payload), 0, 0, sequence, system, component]) + message_id.to_bytes(3, "little") + payload
        head = b"\xfd"
    return head + body + struct.pack("<H", x25crc(body + bytes([extra])).crc)


@st.composite
def frames(draw: st.DrawFn, systems: st.SearchStrategy[int], components: st.SearchStrategy[int]) -> bytes:
    """Any message of the dialect, those that matter more often, its payload at random."""
    number = draw(st.one_of(st.sampled_from(HANDLED), st.sampled_from(sorted(SIZES))))
    size = SIZES[number][0]
    payload = draw(st.one_of(st.binary(min_size=size, max_size=size), st.binary(max_size=size),
                             st.sampled_from([b"\0" * size, b"\xff" * size])))
    return frame(number, payload[:255], draw(systems), draw(components), draw(st.integers(0, 255)),
                 draw(st.sampled_from([1, 2])))


@st.composite
def commands(draw: st.DrawFn, systems: st.SearchStrategy[int], components: st.SearchStrategy[int]) -> bytes:
    """COMMAND_LONG and COMMAND_INT, those that fly first, with parameters of every kind."""
    command = draw(st.one_of(st.sampled_from([ARM, 22, 21, 20, 16, 115, 176, 185, 300, 400, 401, 511, 512, 520, 241]),
                             st.integers(0, 65535)))
    target = draw(st.sampled_from([0, 1, 1, 1, 2, 255])), draw(st.sampled_from([0, 1, 1, 191]))
    p = [draw(ODD) for _ in range(7)]
    if draw(st.booleans()):
        payload = struct.pack("<7fHBBB", *p, command, *target, 0)
        return frame(76, payload, draw(systems), draw(components))
    whole = [draw(st.integers(-2**31, 2**31 - 1)) for _ in range(2)]
    payload = struct.pack("<4fiifHBBBBB", *p[:4], *whole, p[6], command, *target, draw(st.integers(0, 20)), 0, 0)
    return frame(75, payload, draw(systems), draw(components))


@st.composite
def damaged(draw: st.DrawFn, good: st.SearchStrategy[bytes]) -> bytes:
    data = bytearray(draw(good))
    at = draw(st.integers(0, len(data) - 1))
    kind = draw(st.sampled_from(["flip", "cut", "insert"]))
    if kind == "flip":
        data[at] ^= draw(st.integers(1, 255))
    elif kind == "cut":
        del data[at:]
    else:
        data[at:at] = draw(st.binary(min_size=1, max_size=8))
    return bytes(data)


def stream(systems: st.SearchStrategy[int], components: st.SearchStrategy[int] | None = None
           ) -> st.SearchStrategy[bytes]:
    """Pieces of all of these, joined."""
    if components is None:
        components = st.sampled_from([0, 1, 1, 190, 191, 255])
    good = st.one_of(frames(systems, components), commands(systems, components))
    return st.lists(st.one_of(good, good, damaged(good), st.binary(max_size=40)), max_size=8).map(b"".join)


def is_arm_order(message: object) -> bool:
    """A command to arm, to this vehicle or to all: the only thing that may arm."""
    return (getattr(message, "command", None) == ARM and getattr(message, "param1", 0.0) == 1.0
            and getattr(message, "target_system", 0) in (0, 1) and getattr(message, "target_component", 0) in (0, 1))
