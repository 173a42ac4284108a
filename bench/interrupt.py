"""Ctrl-C and SIGTERM: the first ends the flight and lets the run be written, the second leaves at once."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

EXIT_INTERRUPTED = 130
# A shell, make and timeout may each pass one Ctrl-C on: what follows this closely is the same press.
SAME_PRESS_S = 0.3
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Whether the operator wants to stop, and by which signal."""

    def __init__(self) -> None:
        self.signal_name: str | None = None
        self._first_s = 0.0

    def asked(self) -> bool:
        """For `run_trial(cancel=...)`."""
        return self.signal_name is not None

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The signal handler."""
        now = time.monotonic()
        if self.signal_name is not None and now - self._first_s < SAME_PRESS_S:
            return
        if self.signal_name is not None:
            os.write(2, b"\naborted: finished flights are in the journal\n")
            os._exit(EXIT_INTERRUPTED)  # the journal is on disk, and children die with this process
        self.signal_name = signal.Signals(number).name
        self._first_s = now
        os.write(
            2,
            f"\n{self.signal_name}: ending the flight and writing the run; again to abort at once\n".encode(),
        )


@contextmanager
def interruptible() -> Iterator[Interrupts]:
    """Handle the signals inside the block, as they were handled before outside it. Main thread only."""
    interrupts = Interrupts()
    before: dict[signal.Signals, Any] = {}
    for name in SIGNALS:
        if name is signal.SIGHUP and signal.getsignal(name) is signal.SIG_IGN:
            continue  # nohup asked for that
        before[name] = signal.signal(name, interrupts.handle)
    try:
        yield interrupts
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
