"""`emulated:` where a rig's URL is wanted: one is started on this computer, and ends with the command."""

from collections.abc import Iterator
from contextlib import contextmanager

from bench.preflight.emulated import Started, is_emulated, order_rig


@contextmanager
def live_url(url: str) -> Iterator[str]:
    """The URL itself, or that of an emulated rig started for it (`emulated:`, `emulated:?fault=swapped_sensors`).

    Raises:
        UsageError: an unknown option or fault. DeviceError: it does not start.
    """
    if not is_emulated(url):
        yield url
        return
    started = Started(order_rig(url))
    try:
        yield started.url()
    finally:
        started.close()
