"""`emulated:` where a rig's URL is wanted: one is started on this computer, and ends with the command."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bench.preflight.emulated import SCHEME, Started, order_rig
from saranga.errors import DeviceError


@contextmanager
def live_url(url: str, stop: Callable[[], bool] = lambda: False) -> Iterator[str]:
    """The URL itself, or that of an emulated rig started for it (`emulated:`, `emulated:?fault=swapped_sensors`).

    Raises:
        UsageError: an unknown option or fault. DeviceError: it does not start, or `stop` came before it did.
    """
    if not url.startswith(SCHEME):
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
