"""When a motor has settled: by the slope of what the stand reads, not only by time.

Settled: at least `least_s` have passed and, over the last `window_s`, the slope and twice its standard error are
together within `per_second` of the mean (or within `floor` a second, where the mean is near zero).
"""

import math
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Slope:
    """Least-squares slope a second with its standard error, and the mean; NaN with fewer than three samples."""

    slope: float
    error: float
    mean: float
    samples: int


def slope_of(time_s: list[float], value: list[float]) -> Slope:
    """The slope of finite values; samples that are NaN are left out."""
    t, v = np.asarray(time_s, dtype=np.float64), np.asarray(value, dtype=np.float64)
    finite = np.isfinite(v) & np.isfinite(t)
    t, v = t[finite], v[finite]
    if t.size < 3 or np.ptp(t) <= 0.0:
        return Slope(math.nan, math.nan, float(v.mean()) if v.size else math.nan, int(t.size))
    t = t - t.mean()
    spread = float(np.sum(t * t))
    slope = float(np.sum(t * v) / spread)
    residual = v - v.mean() - slope * t
    error = math.sqrt(float(np.sum(residual**2)) / (t.size - 2) / spread)
    return Slope(slope, error, float(v.mean()), int(t.size))


@dataclass
class Settling:
    """Watches one quantity from the moment the throttle was set.

    Args:
        least_s, most_s: not settled before, given up after.
        window_s: stretch the slope is taken over.
        per_second: tolerated relative change.
        floor: tolerated absolute change a second, in the quantity's unit.
    """

    least_s: float
    most_s: float
    window_s: float = 1.0
    per_second: float = 0.02
    floor: float = 0.02
    _time_s: list[float] = field(default_factory=list)
    _value: list[float] = field(default_factory=list)

    def add(self, since_s: float, value: float) -> None:
        """One reading, `since_s` after the throttle was set."""
        self._time_s.append(since_s)
        self._value.append(value)
        while self._time_s and self._time_s[0] < since_s - self.window_s:
            del self._time_s[0], self._value[0]

    def slope(self) -> Slope:
        """Over the window."""
        return slope_of(self._time_s, self._value)

    def settled(self, now_s: float) -> bool:
        """Whether it has settled `now_s` after the throttle was set."""
        if now_s < max(self.least_s, self.window_s) or self._covered_s() < 0.8 * self.window_s:
            return False
        s = self.slope()
        return bool(abs(s.slope) + 2.0 * s.error <= max(self.per_second * abs(s.mean), self.floor))

    def given_up(self, now_s: float) -> bool:
        """Whether to go on regardless; the step is then marked as not settled."""
        return now_s >= self.most_s

    def _covered_s(self) -> float:
        return self._time_s[-1] - self._time_s[0] if self._time_s else 0.0
