"""Simulated time in integer microseconds, and the one order of events.

At every physics tick the world does, in this order: motor outputs act on the physics; flight sensors; echo
cycles whose trigger has come (every 25.6 ms); cycles whose record has arrived reach the stack; the stack's
tick (every 62.5 ms); commands whose compute latency has passed go out; the ground station. Two things due at
the same microsecond therefore never race.
"""

from collections import deque
from dataclasses import dataclass, field

ECHO_CYCLE_US = 25_600
STACK_TICK_US = 62_500


class Periodic:
    """Something that happens every `period_us`, first at `offset_us`.

    Raises:
        ValueError: the period is not positive.
    """

    def __init__(self, period_us: int, offset_us: int = 0) -> None:
        if period_us <= 0:
            raise ValueError(f"period {period_us} us must be positive")
        self.period_us = period_us
        self.next_us = offset_us
        self.count = 0

    def due(self, t_us: int) -> bool:
        """True once for every period that has begun by `t_us`; call again until it says no to catch up."""
        if t_us < self.next_us:
            return False
        self.next_us += self.period_us
        self.count += 1
        return True


@dataclass
class Delayed:
    """Bytes that take effect later: a queue in time order (a later entry never overtakes an earlier one)."""

    _queue: deque[tuple[int, bytes]] = field(default_factory=deque)

    def put(self, at_us: int, data: bytes) -> None:
        if self._queue:
            at_us = max(at_us, self._queue[-1][0])
        self._queue.append((at_us, data))

    def take(self, t_us: int) -> bytes:
        """Everything due by `t_us`."""
        if not self._queue or self._queue[0][0] > t_us:
            return b""
        parts = []
        while self._queue and self._queue[0][0] <= t_us:
            parts.append(self._queue.popleft()[1])
        return b"".join(parts)
