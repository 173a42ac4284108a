"""Frames on the wire: header, CRC-32, COBS and 0x00 (rig protocol v1, layout in `saranga/wire.py`)."""

import struct
import zlib
from dataclasses import dataclass, field

from cobs import cobs

from saranga.errors import UsageError
from saranga.messages import FLAG_BOOT, Echo, Hello, Message, Stand, Status
from saranga.payloads import CODECS, FIRST_HOST_TYPE, TYPE_CODES

VERSION = 1
HEADER = struct.Struct("<BBBBIII")
CRC = struct.Struct("<I")
CRC_RESIDUE = 0x2144DF1C
"""CRC-32 of any bytes followed by their own CRC-32, little-endian."""
MAX_FRAME_BYTES = 4096
"""Longest run without a zero that is kept; the longest frame, an ECHO of 680 pairs, is 2760 bytes."""
WINDOW = 64
"""Sequence numbers a sensor's frame may be late by; further back means that the device has restarted."""


def encode(message: Message) -> bytes:
    """The message as wire bytes: COBS frame and its closing 0x00.

    Raises:
        UsageError: a field does not fit; names message, field, value and limit.
    """
    name = type(message).__name__
    try:
        code = TYPE_CODES[type(message)]
        head = HEADER.pack(VERSION, code, message.flags, message.sensor, message.sequence & 0xFFFFFFFF,
                           message.trigger & 0xFFFFFFFF, message.device_time_us & 0xFFFFFFFF)
        body = head + CODECS[code][1](message)
    except KeyError:
        raise UsageError(f"{name} is no message of rig protocol v{VERSION}") from None
    except (ValueError, struct.error, OverflowError) as error:
        raise UsageError(f"{name} cannot be sent: {error}") from error
    return bytes(cobs.encode(body + CRC.pack(zlib.crc32(body)))) + b"\0"


@dataclass
class LinkCounters:
    """What came in and what was wrong. `sequence_gaps`: frames of the device that never arrived.

    `overruns` and `host_errors` are the device's own counts, from its last STATUS. `restarts` counts sequence
    numbers that started again. The stream's first piece, joined in the middle of a frame, counts as bad.
    """

    bytes_in: int = 0
    messages: int = 0
    bad_cobs: int = 0
    bad_crc: int = 0
    bad_message: int = 0
    sequence_gaps: int = 0
    duplicates: int = 0
    overruns: int = 0
    host_errors: int = 0
    restarts: int = 0
    gaps_by_sensor: dict[int, int] = field(default_factory=dict)


class Decoder:
    """Wire bytes to messages. Never raises, whatever the bytes; memory is bounded by MAX_FRAME_BYTES.

    An ECHO or STAND seen before (same sensor and sequence number) is dropped and counted; what says the same
    when it is said twice (HELLO, STATUS, FAULT) is passed on. `foreign_version` is the last protocol version
    heard that is not ours, with a valid CRC.
    """

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.foreign_version: int | None = None
        self._rest = b""
        self._skipping = False
        # sensor -> [newest sequence number, bit k set: newest - k has been seen]
        self._seen: dict[int, list[int]] = {}

    def feed(self, data: bytes) -> list[Message]:
        """Messages completed by `data`, in order of arrival."""
        self.counters.bytes_in += len(data)
        parts = (self._rest + data).split(b"\0")
        messages = []
        for part in parts[:-1]:
            if self._skipping:
                self._skipping = False
            elif part:
                message = self._message(part)
                if message is not None:
                    messages.append(message)
        self._rest = b"" if self._skipping else parts[-1]
        if len(self._rest) > MAX_FRAME_BYTES:
            self.counters.bad_cobs += 1
            self._rest, self._skipping = b"", True
        self.counters.messages += len(messages)
        return messages

    def _message(self, part: bytes) -> Message | None:
        counters = self.counters
        if len(part) > MAX_FRAME_BYTES:
            counters.bad_cobs += 1
            return None
        try:
            raw: bytes = cobs.decode(part)
        except cobs.DecodeError:
            counters.bad_cobs += 1
            return None
        if len(raw) < HEADER.size + CRC.size or zlib.crc32(raw) != CRC_RESIDUE:
            counters.bad_crc += 1
            return None
        version, code, flags, sensor, sequence, trigger, device_time_us = HEADER.unpack_from(raw)
        if version != VERSION:
            self.foreign_version = version
        codec = CODECS.get(code)
        if version != VERSION or codec is None:
            counters.bad_message += 1
            return None
        header = {"flags": flags, "sensor": sensor, "sequence": sequence, "trigger": trigger,
                  "device_time_us": device_time_us}
        try:
            message: Message = codec[2](header, raw[HEADER.size:-CRC.size])
        except (ValueError, IndexError, struct.error):
            counters.bad_message += 1
            return None
        if code < FIRST_HOST_TYPE and not self._fresh(message):
            counters.duplicates += 1
            return None
        if isinstance(message, Status):
            counters.overruns, counters.host_errors = message.overruns, message.host_errors
        return message

    def _fresh(self, message: Message) -> bool:
        """Keep account of the sensor's sequence numbers; False for one that was there already."""
        if isinstance(message, Hello) and message.flags & FLAG_BOOT and self._seen:
            self.counters.restarts += 1
            self._seen.clear()
        sensor, sequence = message.sensor, message.sequence
        seen = self._seen.get(sensor)
        if seen is None:
            self._seen[sensor] = [sequence, 1]
            return True
        step = (sequence - seen[0]) & 0xFFFFFFFF
        if 0 < step < 0x80000000:
            seen[0] = sequence
            seen[1] = (seen[1] << step | 1) & (1 << WINDOW) - 1 if step < WINDOW else 1
            self._count_gap(sensor, step - 1)
            return True
        age = -step & 0xFFFFFFFF
        if age >= WINDOW:
            self.counters.restarts += 1
            self._seen[sensor] = [sequence, 1]
            return True
        if seen[1] >> age & 1:
            return not isinstance(message, Echo | Stand)
        seen[1] |= 1 << age
        # Late, not lost: it was counted as a gap when its successor came, or it precedes the first frame.
        if self.counters.gaps_by_sensor.get(sensor, 0):
            self._count_gap(sensor, -1)
        return True

    def _count_gap(self, sensor: int, count: int) -> None:
        if count:
            gaps = self.counters.gaps_by_sensor
            gaps[sensor] = gaps.get(sensor, 0) + count
            self.counters.sequence_gaps += count
