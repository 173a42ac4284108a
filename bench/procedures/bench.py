"""What a procedure needs of a bench, whatever stands there: time, a throttle, what was heard, and hands to mount."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from bench.procedures.plan import Condition
from bench.thrust_stand.protocol import StandReading
from saranga.echo import EchoCycle


@dataclass
class Heard:
    """What came since the last look."""

    readings: list[StandReading] = field(default_factory=list)
    cycles: list[EchoCycle] = field(default_factory=list)


@dataclass(frozen=True)
class BenchInfo:
    """Who is there, for the journal. `origin`: "measured" or "emulated", the worse of rig and stand."""

    origin: str
    rig: dict[str, Any]
    stand: dict[str, Any]


Hands = Callable[[str], None]
"""Asked to do something on the bench; returns when it is done."""


class Bench(Protocol):
    """A rig, a stand and a throttle. Every method but `close` and `stop` raises DeviceError, naming what has failed."""

    by_hand: bool
    """Whether a person mounts things (and so needs time)."""
    real_time: bool
    """Whether things go on spinning while nobody polls."""

    def open(self) -> BenchInfo: ...

    def now_s(self) -> float:
        """Seconds on the clock of `StandReading.time_s`."""
        ...

    def set_throttle(self, value: float) -> None:
        """Wanted throttle; must be called again at least every 50 ms while something spins."""
        ...

    def poll(self, timeout_s: float) -> Heard:
        """What came, waiting at most `timeout_s`."""
        ...

    def mount(self, condition: Condition) -> None:
        """Have this condition mounted; only called with the motor standing still."""
        ...

    def trouble(self) -> str | None:
        """Why the throttle was taken away, None while all is well."""
        ...

    def counters(self) -> dict[str, Any]:
        """Losses on the link so far."""
        ...

    def stop(self) -> dict[str, Any]:
        """Idle now; says whether the device confirmed it. Never raises."""
        ...

    def close(self) -> None: ...
