"""KISS ESC telemetry, as BLHeli32 and AM32 send it too: 10 bytes at 115200 baud, big-endian.

    0 temperature, C (i8)    1 voltage, 10 mV (u16)    3 current, 10 mA (u16)    5 used charge, mAh (u16)
    7 electrical speed, 100 rpm (u16)    9 CRC-8, polynomial 0x07, start 0, over bytes 0..8

There is no start mark: a reader that has lost its place slides on byte by byte until a CRC fits. An ESC that sends
at pauses is found sooner by them. One frame in 256 would fit by chance, so the first after a loss needs a second.
"""

import struct
from dataclasses import dataclass

FRAME_BYTES = 10
_LAYOUT = struct.Struct(">bHHHH")


@dataclass(frozen=True)
class EscTelemetry:
    """What an ESC says. `erpm` is electrical; a motor with P poles turns at 2 erpm / P."""

    temperature_c: float
    voltage_v: float
    current_a: float
    charge_mah: int
    erpm: int

    def rpm(self, poles: int) -> float:
        """Mechanical speed of a motor with this many poles (magnets of the bell)."""
        return 2.0 * self.erpm / poles


def crc8(data: bytes) -> int:
    """CRC-8, polynomial x^8 + x^2 + x + 1 (0x07), start 0, not reflected."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x07 if crc & 0x80 else crc << 1) & 0xFF
    return crc


def decode(frame: bytes) -> EscTelemetry | None:
    """One frame of 10 bytes; None where its length or CRC is wrong."""
    if len(frame) != FRAME_BYTES or crc8(frame[:-1]) != frame[-1]:
        return None
    temperature, voltage, current, charge, erpm = _LAYOUT.unpack(frame[:-1])
    return EscTelemetry(float(temperature), voltage * 0.01, current * 0.01, charge, erpm * 100)


def encode(telemetry: EscTelemetry) -> bytes:
    """The frame an ESC would send."""
    body = _LAYOUT.pack(round(telemetry.temperature_c), round(telemetry.voltage_v * 100),
                        round(telemetry.current_a * 100), telemetry.charge_mah, round(telemetry.erpm / 100))
    return body + bytes([crc8(body)])


class KissDecoder:
    """Frames out of a byte stream, cut anywhere. `lost_bytes` counts what belonged to no frame."""

    def __init__(self) -> None:
        self.lost_bytes = 0
        self._rest = b""
        self._in_step = False

    def feed(self, data: bytes) -> list[EscTelemetry]:
        """Frames completed by `data`, in order."""
        self._rest += data
        found = []
        while len(self._rest) >= (FRAME_BYTES if self._in_step else 2 * FRAME_BYTES):
            frame = decode(self._rest[:FRAME_BYTES])
            second = self._in_step or decode(self._rest[FRAME_BYTES:2 * FRAME_BYTES]) is not None
            if frame is not None and second:
                found.append(frame)
                self._in_step = True
                self._rest = self._rest[FRAME_BYTES:]
            else:
                self._in_step = False
                if len(self._rest) < 2 * FRAME_BYTES:
                    break
                self.lost_bytes += 1
                self._rest = self._rest[1:]
        return found
