"""Payloads of rig protocol v1: numbers and texts to bytes and back (layout: `saranga/wire.py`).

Both ways raise ValueError naming the field, its value and its limit, or struct.error, IndexError or
AttributeError where things do not fit at all. The decoder counts these, `encode` turns them into UsageError.
"""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from saranga.messages import (
    ALL_SENSORS,
    MAX_SAMPLES,
    Config,
    Echo,
    Fault,
    Hello,
    HelloRequest,
    Message,
    SelfTest,
    SensorInfo,
    Stand,
    Start,
    Status,
    Stop,
    Throttle,
)

ROLE_CODES = {"left": 0, "right": 1, "down": 2, "": 255}
SELF_TEST_CODES = {"untested": 0, "pass": 1, "fail": 2}
_ROLE_NAMES = {code: name for name, code in ROLE_CODES.items()}
_SELF_TEST_NAMES = {code: name for name, code in SELF_TEST_CODES.items()}


def need(ok: bool, field: str, value: object, limit: str) -> None:
    """Raise ValueError naming field, value and limit unless `ok`."""
    if not ok:
        raise ValueError(f"{field} is {value!r}: it must be {limit}")


def _text(field: str, text: str, most: int) -> bytes:
    data = text.encode()
    need(len(data) <= most, field, text, f"at most {most} bytes of UTF-8")
    return bytes([len(data)]) + data


def _take_text(field: str, data: bytes, at: int, most: int) -> tuple[str, int]:
    end = at + 1 + data[at]
    need(data[at] <= most and end <= len(data), field, data[at], f"at most {most} bytes and inside the frame")
    return data[at + 1:end].decode(), end


_SENSOR = struct.Struct("<BBBBff")


def _check_band(fop_hz: float, bandwidth_hz: float) -> None:
    need(20e3 <= fop_hz <= 200e3, "fop_hz", fop_hz, "20000..200000")
    need(0.0 < bandwidth_hz <= 100e3, "bandwidth_hz", bandwidth_hz, "above 0, at most 100000")


def _check_sensors(sensors: tuple[SensorInfo, ...]) -> None:
    need(len(sensors) <= 16, "sensors", len(sensors), "at most 16")
    numbers = [s.sensor for s in sensors]
    need(len(set(numbers)) == len(numbers) and all(0 <= n < ALL_SENSORS for n in numbers), "sensors", numbers,
         "different numbers in 0..254")
    roles = [s.role for s in sensors if s.role]
    need(len(set(roles)) == len(roles), "sensors", roles, "sensors with different roles")


def _pack_hello(m: Hello) -> bytes:
    _check_sensors(m.sensors)
    capabilities = m.has_stand | m.has_throttle << 1
    parts = [_text("firmware", m.firmware, 64), bytes([capabilities, len(m.sensors)])]
    for s in m.sensors:
        need(s.role in ROLE_CODES, "role", s.role, f"one of {', '.join(map(repr, ROLE_CODES))}")
        need(s.self_test in SELF_TEST_CODES, "self_test", s.self_test, f"one of {', '.join(SELF_TEST_CODES)}")
        _check_band(s.fop_hz, s.bandwidth_hz)
        parts.append(_SENSOR.pack(s.sensor, ROLE_CODES[s.role], SELF_TEST_CODES[s.self_test], s.transmits,
                                  s.fop_hz, s.bandwidth_hz))
        parts.append(_text("serial", s.serial, 32))
    return b"".join(parts)


def _unpack_hello(header: dict[str, int], data: bytes) -> Hello:
    firmware, at = _take_text("firmware", data, 0, 64)
    capabilities, count = data[at], data[at + 1]
    need(capabilities < 4, "capabilities", capabilities, "0..3")
    at += 2
    sensors = []
    for _ in range(count):
        number, role, self_test, transmits, fop_hz, bandwidth_hz = _SENSOR.unpack_from(data, at)
        need(role in _ROLE_NAMES and self_test in _SELF_TEST_NAMES and transmits < 2, "sensor",
             (role, self_test, transmits), "a known role, self test and 0 or 1")
        _check_band(fop_hz, bandwidth_hz)
        serial, at = _take_text("serial", data, at + _SENSOR.size, 32)
        sensors.append(SensorInfo(sensor=number, role=_ROLE_NAMES[role], fop_hz=fop_hz,
                                  bandwidth_hz=bandwidth_hz, self_test=_SELF_TEST_NAMES[self_test],
                                  transmits=bool(transmits), serial=serial))
    need(at == len(data), "length", len(data), f"{at}")
    _check_sensors(tuple(sensors))
    return Hello(firmware=firmware, sensors=tuple(sensors), has_stand=bool(capabilities & 1),
                 has_throttle=bool(capabilities & 2), **header)


_ECHO = struct.Struct("<fBBH")


def _check_echo(fop_hz: float, odr: int, mode: int, n: int) -> None:
    if not (20e3 <= fop_hz <= 200e3 and 2 <= odr <= 6 and 0 <= mode <= 1 and 1 <= n <= MAX_SAMPLES):
        raise ValueError(f"echo is fop_hz {fop_hz!r}, odr {odr!r}, mode {mode!r}, {n!r} samples: it must be "
                         f"20000..200000, 2..6, 0..1, 1..{MAX_SAMPLES}")


def _pack_echo(m: Echo) -> bytes:
    if m.iq.ndim != 2 or m.iq.shape[1] != 2 or m.iq.dtype != np.int16:
        raise ValueError(f"iq is {m.iq.dtype} of shape {m.iq.shape}: it must be int16 of shape (n, 2)")
    _check_echo(m.fop_hz, m.odr, m.mode, len(m.iq))
    return _ECHO.pack(m.fop_hz, m.odr, m.mode, len(m.iq)) + m.iq.astype("<i2", copy=False).tobytes()


def _unpack_echo(header: dict[str, int], data: bytes) -> Echo:
    fop_hz, odr, mode, n = _ECHO.unpack_from(data)
    _check_echo(fop_hz, odr, mode, n)
    if len(data) != _ECHO.size + 4 * n:
        raise ValueError(f"echo of {n} samples is {len(data)} bytes: it must be {_ECHO.size + 4 * n}")
    iq = np.frombuffer(data, "<i2", 2 * n, _ECHO.size).reshape(n, 2)
    return Echo(fop_hz=fop_hz, odr=odr, mode=mode, iq=iq, **header)


_FAULT = struct.Struct("<HB")


def _pack_fault(m: Fault) -> bytes:
    return _FAULT.pack(m.code, m.latched) + _text("text", m.text, 200)


def _unpack_fault(header: dict[str, int], data: bytes) -> Fault:
    code, latched = _FAULT.unpack_from(data)
    need(latched < 2, "latched", latched, "0 or 1")
    text, at = _take_text("text", data, _FAULT.size, 200)
    need(at == len(data), "length", len(data), f"{at}")
    return Fault(code=code, text=text, latched=bool(latched), **header)


def _plain(cls: type[Message], layout: str, *fields: str,
           check: Callable[[Any], None] | None = None) -> tuple[Any, Any]:
    """Packer and unpacker of a message whose payload is a fixed row of numbers."""
    form = struct.Struct(layout)

    def pack(message: Message) -> bytes:
        if check is not None:
            check(message)
        return form.pack(*(getattr(message, name) for name in fields))

    def unpack(header: dict[str, int], data: bytes) -> Message:
        message = cls(**dict(zip(fields, form.unpack(data), strict=True)), **header)
        if check is not None:
            check(message)
        return message

    return pack, unpack


def _check_config(m: Config) -> None:
    need(2 <= m.odr <= 6, "odr", m.odr, "2..6")
    need(1 <= m.samples <= MAX_SAMPLES, "samples", m.samples, f"1..{MAX_SAMPLES}")
    need(0 <= m.ring_down_samples <= MAX_SAMPLES, "ring_down_samples", m.ring_down_samples,
         f"0..{MAX_SAMPLES}")


def _check_start(m: Start) -> None:
    need(m.mode in (0, 1), "mode", m.mode, "0 or 1")
    need(0.1 <= m.rate_hz <= 200.0, "rate_hz", m.rate_hz, "0.1..200")


def _check_throttle(m: Throttle) -> None:
    need(0.0 <= m.value <= 1.0, "value", m.value, "0..1")
    need(1 <= m.deadline_ms <= 5000, "deadline_ms", m.deadline_ms, "1..5000")


def _check_status(m: Status) -> None:
    need(0 <= m.state <= 2, "state", m.state, "0..2")


def _check_self_test(m: SelfTest) -> None:
    need(m.kind in (0, 1), "kind", m.kind, "0 or 1")


FIRST_HOST_TYPE = 0x81
CODECS: dict[int, tuple[type[Message], Callable[[Any], bytes], Callable[[dict[str, int], bytes], Any]]] = {
    0x01: (Hello, _pack_hello, _unpack_hello),
    0x02: (Echo, _pack_echo, _unpack_echo),
    0x03: (Status, *_plain(Status, "<IIIfB", "overruns", "host_errors", "cycles", "temperature_c", "state",
                           check=_check_status)),
    0x04: (Stand, *_plain(Stand, "<ffffffffI", "thrust_n", "torque_n_m", "rpm", "voltage_v", "current_a",
                          "esc_temperature_c", "motor_temperature_c", "throttle", "token")),
    0x05: (Fault, _pack_fault, _unpack_fault),
    0x81: (HelloRequest, *_plain(HelloRequest, "<")),
    0x82: (Config, *_plain(Config, "<BHH", "odr", "samples", "ring_down_samples", check=_check_config)),
    0x83: (Start, *_plain(Start, "<Bf", "mode", "rate_hz", check=_check_start)),
    0x84: (Stop, *_plain(Stop, "<")),
    0x85: (SelfTest, *_plain(SelfTest, "<B", "kind", check=_check_self_test)),
    0x86: (Throttle, *_plain(Throttle, "<fIH", "value", "token", "deadline_ms", check=_check_throttle)),
}
"""Type byte -> class, packer, unpacker."""
TYPE_CODES: dict[type[Message], int] = {entry[0]: code for code, entry in CODECS.items()}
