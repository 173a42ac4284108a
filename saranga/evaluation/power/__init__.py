"""Energy of an inference, where the machine can say. One file a power source, found by name."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, sleep
from typing import Any, Protocol

from saranga.errors import UsageError
from saranga.plugins import call_with_options, nearest_hint, plugins

IDLE_S = 1.0
BUSY_S = 2.0


class PowerMeter(Protocol):
    """`name`, and `energy_j()`: joules since any moment, never falling. Raises DeviceError when it cannot be read."""

    name: str

    def energy_j(self) -> float: ...


@dataclass(frozen=True)
class Energy:
    """Of one inference: over the idle power as the paper takes it, and in all."""

    net_mj: float
    gross_mj: float
    idle_w: float
    calls: int


def power_names() -> list[str]:
    """Names that `load_power` knows."""
    return list(plugins(sys.modules[__name__]))


def load_power(name: str, **options: Any) -> PowerMeter:
    """The power source called `name`.

    Raises:
        UsageError: an unknown name or option. DeviceError: there is none on this machine.
    """
    known = plugins(sys.modules[__name__])
    if name not in known:
        raise UsageError(f"unknown power source {name!r}{nearest_hint(name, list(known))}: known are "
                         f"{', '.join(known)}")
    meter: PowerMeter = call_with_options("power source", name, known[name].build, options)
    return meter


def idle_power_w(meter: PowerMeter, seconds: float = IDLE_S) -> float:
    """Power while this program sleeps."""
    start, began = meter.energy_j(), perf_counter()
    sleep(seconds)
    return (meter.energy_j() - start) / (perf_counter() - began)


def energy_of(call: Callable[[], object], meter: PowerMeter, idle_w: float, seconds: float = BUSY_S) -> Energy:
    """`call` again and again for some seconds; idle power times time is taken off (paper, "Statistical analysis")."""
    start, began, calls = meter.energy_j(), perf_counter(), 0
    while perf_counter() - began < seconds or calls == 0:
        call()
        calls += 1
    spent, joules = perf_counter() - began, meter.energy_j() - start
    return Energy(1e3 * (joules - idle_w * spent) / calls, 1e3 * joules / calls, idle_w, calls)
