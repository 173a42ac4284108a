"""What a thrust stand is to the rest of the bench. Measuring and spinning are two things, even on one device."""

from dataclasses import dataclass
from math import nan
from typing import Literal, Protocol

Origin = Literal["measured", "emulated", "recorded"]


@dataclass(frozen=True)
class StandReading:
    """One sample; NaN: this stand does not measure it. thrust_n is positive when the propeller pulls as it should."""

    time_s: float
    """Host monotonic seconds at arrival (recordings: from the file)."""
    thrust_n: float = nan
    torque_n_m: float = nan
    rpm: float = nan
    voltage_v: float = nan
    current_a: float = nan
    esc_temperature_c: float = nan
    motor_temperature_c: float = nan
    vibration_m_s2: float = nan
    throttle: float = nan
    """What is applied right now as the device itself says (readback), 0..1; NaN: no readback."""
    token: int = 0
    """Of the throttle command that is applied."""


@dataclass(frozen=True)
class StandInfo:
    """What a stand says of itself. `quantities` are the fields of StandReading that it measures."""

    name: str
    firmware: str
    quantities: frozenset[str]
    origin: Origin
    has_throttle: bool
    dead_man_s: float | None
    """Longest time the device holds a throttle without a fresh command; None: it has no dead-man of its own."""


class ThrustStand(Protocol):
    """Measures. `close` may be called twice."""

    url: str

    def open(self) -> StandInfo:
        """Connect. Raises DeviceError naming URL and cause."""
        ...

    def read(self, timeout_s: float) -> list[StandReading]:
        """What came since the last call, waiting at most `timeout_s`. Raises DeviceError when the stand is gone."""
        ...

    def tare(self) -> float:
        """Take the present thrust as zero; returns the offset taken, N."""
        ...

    def close(self) -> None: ...


class ThrottleOutput(Protocol):
    """Spins: only the supervisor may hold one. `readback`: whether `applied` is what the device says."""

    url: str
    readback: bool

    def open(self) -> None: ...

    def command(self, value: float, token: int, deadline_s: float) -> None:
        """Throttle 0..1; the device idles by itself when `deadline_s` has passed without another command."""
        ...

    def applied(self) -> tuple[float, int] | None:
        """(throttle, token) the device last reported, None: nothing yet."""
        ...

    def close(self) -> None:
        """Idles first."""
        ...
