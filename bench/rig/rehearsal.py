"""`emulated:` where a rig's URL is wanted: one is started on this computer, and ends with the command.

`emulated:`, `emulated:?fault=swapped_sensors&seed=3`.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bench.emulated import Ordered, Started, is_emulated, split_url
from bench.rig.faults import parse_faults
from saranga.errors import DeviceError, UsageError


def order_rig(url: str) -> Ordered:
    """The command of an emulated rig with a pole at 0.8 m, 30 degrees to the right.

    Raises:
        UsageError: an unknown option or fault.
    """
    kind, options = split_url(url, ("fault", "port", "seed", "reflector", "sonar"))
    if kind:
        raise UsageError(f"--rig {url!r}: use emulated: or emulated:?fault=NAME")
    parse_faults([value for key, value in options if key == "fault"])
    command = [sys.executable, "-m", "bench.cli", "rig", "emulate", "--json"]
    for key, value in options:
        command += [f"--{key}", value]
    return Ordered(tuple(command), "emulated rig")


@contextmanager
def live_url(url: str, stop: Callable[[], bool] = lambda: False) -> Iterator[str]:
    """The URL itself, or that of an emulated rig started for it (`emulated:`, `emulated:?fault=swapped_sensors`).

    Raises:
        UsageError: an unknown option or fault. DeviceError: it does not start, or `stop` came before it did.
    """
    if not is_emulated(url):
        yield url
        return
    started = Started(order_rig(url))
    try:
        live = started.url(stop)
        if live is None:
            raise DeviceError(f"{url}: interrupted before it had started")
        yield live
    finally:
        started.close()
