"""Energy over an interval, from what this computer or an instrument beside it can say. One file a source, by `NAME`.

A source module has `NAME`, `ABOUT` (for people) and `build(**options)`, which returns a `PowerSource`. Instruments'
own packages are imported only when their source is opened.
"""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol
from urllib.parse import parse_qsl

from saranga.errors import DeviceError, UsageError
from saranga.plugins import call_with_options, nearest_hint, plugins

IDLE_S = 1.0
LEAST_CALLS = 100


@dataclass(frozen=True)
class Mark:
    """A moment on the source's own clock, with its energy counter (NaN where it has none)."""

    time_s: float
    energy_j: float = math.nan


@dataclass(frozen=True)
class Energy:
    """Between two marks."""

    joules: float
    seconds: float

    @property
    def mean_w(self) -> float:
        return self.joules / self.seconds


class PowerSource(Protocol):
    """`name`, and `origin` of its numbers. All but `close` raise DeviceError naming the source and the cause."""

    name: str
    origin: Literal["measured", "recorded"]

    def open(self) -> str:
        """Connect; returns what it is, for the record."""
        ...

    def mark(self) -> Mark:
        """Now, or as soon as the instrument says something: the mark's own time counts."""
        ...

    def between(self, start: Mark, end: Mark) -> Energy: ...

    def close(self) -> None:
        """May be called twice."""
        ...


def power_source_names() -> list[str]:
    """Names that `load_power_source` knows."""
    return list(plugins(sys.modules[__name__]))


def load_power_source(text: str) -> PowerSource:
    """The source that `NAME` or `NAME:PATH?OPTION=VALUE&...` names, such as rapl or csv:power.csv.

    Raises:
        UsageError: an unknown name or option.
    """
    name, _, rest = text.partition(":")
    known = plugins(sys.modules[__name__])
    if name not in known:
        raise UsageError(f"unknown power source {name!r}{nearest_hint(name, list(known))}: known are "
                         f"{', '.join(known)}")
    path, _, query = rest.partition("?")
    try:
        options: dict[str, Any] = dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError as error:
        raise UsageError(f"power source {text!r}: {error}") from error
    if path:
        options["path"] = path
    source: PowerSource = call_with_options("power source", name, known[name].build, options)
    return source


def difference(name: str, start: Mark, end: Mark) -> Energy:
    """Between two marks of a counter.

    Raises:
        DeviceError: no time between them, or a counter that ran backwards or is not a number.
    """
    seconds, joules = end.time_s - start.time_s, end.energy_j - start.energy_j
    if not seconds > 0.0:
        raise DeviceError(f"{name}: {seconds:g} s between two marks: measure for longer")
    if not (math.isfinite(joules) and joules >= 0.0):
        raise DeviceError(f"{name}: its counter went from {start.energy_j:g} to {end.energy_j:g} J: was it reset or "
                          "unplugged?")
    return Energy(joules, seconds)


@dataclass(frozen=True)
class EnergyPerCall:
    """Of one call: over the idle power as the paper takes it, and in all. Idle is measured before and after."""

    net_j: float
    gross_j: float
    calls: int
    seconds: float
    idle_before_w: float
    idle_after_w: float
    active_w: float
    origin: str


def energy_per_call(call: Callable[[], object], source: PowerSource, calls: int = LEAST_CALLS,
                    idle_s: float = IDLE_S, sleep: Callable[[float], None] = time.sleep) -> EnergyPerCall:
    """Idle, `calls` calls, idle again; E = (P_active - P_idle) t / calls (paper, "Statistical analysis").

    Raises:
        UsageError: fewer than 100 calls or no idle time. DeviceError: the source cannot be read.
    """
    if calls < LEAST_CALLS:
        raise UsageError(f"{calls} calls: at least {LEAST_CALLS} are needed for the energy of one")
    if not 0.0 < idle_s <= 3600.0:
        raise UsageError(f"idle time is {idle_s!r} s: it must be above 0, at most 3600")
    before = source.mark()
    sleep(idle_s)
    start = source.mark()
    for _ in range(calls):
        call()
    end = source.mark()
    sleep(idle_s)
    after = source.mark()
    idle_before, active, idle_after = source.between(before, start), source.between(start, end), \
        source.between(end, after)
    idle_w = 0.5 * (idle_before.mean_w + idle_after.mean_w)
    return EnergyPerCall(
        net_j=(active.joules - idle_w * active.seconds) / calls, gross_j=active.joules / calls, calls=calls,
        seconds=active.seconds, idle_before_w=idle_before.mean_w, idle_after_w=idle_after.mean_w,
        active_w=active.mean_w, origin=source.origin)
