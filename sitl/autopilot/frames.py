"""MAVLink frames out of a byte stream: both versions, resynchronising on rubbish, never raising.

Messages that come often are read from `Frame.payload` with a struct; the rest are decoded by pymavlink on
demand.
"""

from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
SIGNATURE_BYTES = 13
MAX_BUFFER = 1 << 16


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame whose checksum is right. `payload` is zero-filled to the message's full length."""

    message_id: int
    system: int
    component: int
    payload: bytes
    raw: bytes


class FrameReader:
    """Feed bytes, get frames. `rubbish_bytes` counts what belonged to none."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._decoder = mavlink.MAVLink(None)
        self.rubbish_bytes = 0

    def feed(self, data: bytes) -> list[Frame]:
        """All complete frames of the stream so far."""
        buffer = self._buffer
        buffer += data
        frames: list[Frame] = []
        start, end = 0, len(buffer)
        while start < end:
            magic = buffer[start]
            if magic == V2:
                header = 10
            elif magic == V1:
                header = 6
            else:
                start += 1
                self.rubbish_bytes += 1
                continue
            if end - start < header + 2:
                break
            size = buffer[start + 1]
            total = header + size + 2
            if magic == V2:
                flags = buffer[start + 2]
                if flags & ~SIGNED:
                    start += 1
                    self.rubbish_bytes += 1
                    continue
                if flags & SIGNED:
                    total += SIGNATURE_BYTES
            if end - start < total:
                break
            frame = self._check(bytes(buffer[start:start + total]), header, size)
            if frame is None:
                start += 1
                self.rubbish_bytes += 1
            else:
                frames.append(frame)
                start += total
        del buffer[:start]
        if len(buffer) > MAX_BUFFER:
            self.rubbish_bytes += len(buffer)
            buffer.clear()
        return frames

    def _check(self, raw: bytes, header: int, size: int) -> Frame | None:
        if header == 10:
            system, component = raw[5], raw[6]
            message_id = raw[7] | raw[8] << 8 | raw[9] << 16
        else:
            system, component, message_id = raw[3], raw[4], raw[5]
        kind = mavlink.mavlink_map.get(message_id)
        if kind is None:
            return None
        stop = header + size
        if x25crc(raw[1:stop] + bytes((kind.crc_extra,))).crc != raw[stop] | raw[stop + 1] << 8:
            return None
        full = kind.unpacker.size
        payload = raw[header:stop]
        if size < full:
            payload += bytes(full - size)
        return Frame(message_id, system, component, payload, raw)

    def decode(self, frame: Frame) -> Any | None:
        """The pymavlink message, or None where pymavlink cannot make one of it."""
        try:
            return self._decoder.decode(bytearray(frame.raw))
        except (mavlink.MAVError, ValueError, UnicodeError):
            return None
