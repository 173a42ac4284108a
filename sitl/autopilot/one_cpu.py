"""Running two processes in lockstep on one CPU.

They never run at the same time, and a hand-over within one CPU costs a context switch where one between CPUs costs
waking an idle one: measured, the real autopilot's share of a flight falls from 69 to 36 ms a simulated second.
Several simulators on one machine each take a CPU of their own, by a lock file a CPU; with none left nothing is pinned.
"""

import ctypes
import fcntl
import os
import tempfile
from pathlib import Path
from typing import IO


def _lock_file(cpu: int) -> Path:
    return Path(tempfile.gettempdir()) / f"saranga-bench-cpu{cpu}-{os.getuid()}.lock"


def _current_cpu() -> int:
    try:
        return int(ctypes.CDLL(None).sched_getcpu())
    except AttributeError:
        return -1


class OneCpu:
    """Pins this process and a child to one CPU until `release`; does nothing where that cannot be had."""

    def __init__(self) -> None:
        self.cpu: int | None = None
        self._before: set[int] | None = None
        self._lock: IO[str] | None = None

    def take(self, child: int) -> None:
        """Choose a free CPU, the current one first, and move to it with process `child`."""
        if not hasattr(os, "sched_setaffinity") or self.cpu is not None:
            return
        before = os.sched_getaffinity(0)
        if len(before) < 2:
            return
        current = _current_cpu()
        for cpu in sorted(before, key=lambda number: (number != current, number)):
            lock = self._locked(cpu)
            if lock is None:
                continue
            try:
                os.sched_setaffinity(child, {cpu})
                os.sched_setaffinity(0, {cpu})
            except OSError:
                lock.close()
                return
            self.cpu, self._before, self._lock = cpu, before, lock
            return

    @staticmethod
    def _locked(cpu: int) -> IO[str] | None:
        try:
            lock = _lock_file(cpu).open("a")
        except OSError:
            return None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            return None
        return lock

    def release(self) -> None:
        """Go back to the CPUs we had; may be called twice."""
        if self._before is not None:
            os.sched_setaffinity(0, self._before)
        if self._lock is not None:
            self._lock.close()
        self.cpu = self._before = self._lock = None
