"""What the rig and the host say to each other (rig protocol v1): one frozen dataclass a message.

The byte layout is in `saranga/wire.py`; `saranga/payloads.py` packs and unpacks it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ALL_SENSORS = 255
MAX_SAMPLES = 680
"""IQ pairs in one ECHO: what the sensor's raw firmware gives at most (hardware.md)."""
FLAG_BOOT = 1
"""HELLO: the first since power-up; sequence numbers, triggers and clock have started again."""
FLAG_OVERRUN = 1
"""ECHO: the device lost at least one cycle of this sensor since the frame before."""
MODE_TRANSMIT_RECEIVE = 0
MODE_RECEIVE_ONLY = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """The header. u32 fields are sent modulo 2^32; `device_time_us` is raw here, the assembler unwraps it."""

    sensor: int = ALL_SENSORS
    sequence: int = 0
    trigger: int = 0
    device_time_us: int = 0
    flags: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorInfo:
    """One sensor in HELLO: `role` left, right, down or "" (none), `self_test` untested, pass or fail."""

    sensor: int
    role: str
    fop_hz: float
    bandwidth_hz: float
    self_test: str = "untested"
    transmits: bool = False
    serial: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello(Message):
    """Device: who I am. Sent at power-up (with FLAG_BOOT) and in answer to HELLO?."""

    firmware: str
    sensors: tuple[SensorInfo, ...]
    has_stand: bool = False
    has_throttle: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Echo(Message):
    """Device: one sensor's record of one trigger. `iq` is int16, shape (n, 2), Q first."""

    fop_hz: float
    odr: int
    mode: int
    iq: NDArray[np.int16]


@dataclass(frozen=True, slots=True, kw_only=True)
class Status(Message):
    """Device, once a second. `state`: 0 idle, 1 transmit/receive, 2 receive only. NaN: not measured."""

    overruns: int = 0
    host_errors: int = 0
    cycles: int = 0
    temperature_c: float = math.nan
    state: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Stand(Message):
    """Device: the thrust stand. NaN: not measured. `throttle` and `token` are what is applied right now."""

    thrust_n: float = math.nan
    torque_n_m: float = math.nan
    rpm: float = math.nan
    voltage_v: float = math.nan
    current_a: float = math.nan
    esc_temperature_c: float = math.nan
    motor_temperature_c: float = math.nan
    throttle: float = 0.0
    token: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault(Message):
    """Device: something is wrong; a latched one stays until power is cycled."""

    code: int
    text: str = ""
    latched: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HelloRequest(Message):
    """Host: say HELLO."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Message):
    """Host: set the sensor named in the header (255: all)."""

    odr: int
    samples: int
    ring_down_samples: int = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Start(Message):
    """Host: trigger at `rate_hz`, `mode` 0 transmit/receive or 1 receive only."""

    mode: int = MODE_TRANSMIT_RECEIVE
    rate_hz: float = 1e6 / 25600


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Message):
    """Host: stop triggering."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfTest(Message):
    """Host: test the sensor in the header. `kind`: 0 built-in test, 1 link test (known IQ sequence)."""

    kind: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Throttle(Message):
    """Host: hold `value` (0 to 1) for at most `deadline_ms`, after which the device idles."""

    value: float
    token: int
    deadline_ms: int
