"""How far it is, on stderr."""

import sys
from time import perf_counter

REPORT_S = 1.0


class Progress:
    """One line that is written over, with the time left; `total` in any unit."""

    def __init__(self, total: int) -> None:
        self._total = max(total, 1)
        self._done = 0
        self._began = self._said = perf_counter()

    def add(self, what: str, count: int) -> None:
        """`count` more done, of `what`."""
        self._done += count
        now = perf_counter()
        if now - self._said >= REPORT_S:
            self._said = now
            share = self._done / self._total
            left_s = (now - self._began) * (1.0 / share - 1.0)
            print(f"\r{what}: {100 * share:.0f} % in all, {left_s:.0f} s left".ljust(60), end="", file=sys.stderr,
                  flush=True)

    def end(self) -> None:
        """Leave the line, if there is one."""
        if self._said > self._began:
            print(file=sys.stderr, flush=True)
