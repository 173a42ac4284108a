"""95 % intervals: of rates, counts, medians, and of anything that can be computed again from resampled images."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Interval = tuple[float, float]
NONE: Interval = (math.nan, math.nan)
_Z = 1.959963984540054
_TAIL = 0.025
RESAMPLES = 400


def wilson(successes: int, trials: int) -> Interval:
    """Of a rate (Wilson 1927); (0, 1) when nothing was tried."""
    if trials == 0:
        return 0.0, 1.0
    rate, z2 = successes / trials, _Z * _Z / trials
    middle = (rate + z2 / 2.0) / (1.0 + z2)
    half = _Z * math.sqrt(rate * (1.0 - rate) / trials + z2 / (4.0 * trials)) / (1.0 + z2)
    return max(0.0, middle - half), min(1.0, middle + half)


def poisson(events: int, frames: int) -> Interval:
    """Of events a frame, for events that come one by one (Garwood 1936)."""
    from scipy.special import gammaincinv  # here, not above: half a second that a training run need not wait for

    if frames == 0:
        return NONE
    low = float(gammaincinv(events, _TAIL)) if events else 0.0
    return low / frames, float(gammaincinv(events + 1, 1.0 - _TAIL)) / frames


def median(values: NDArray[np.float64]) -> Interval:
    """Of a median, by order statistics: ranks n / 2 -+ 0.98 sqrt(n); the extremes of fewer than 6 values say less."""
    n = values.size
    if n == 0:
        return NONE
    ordered = np.sort(values)
    half = _Z * math.sqrt(n) / 2.0
    low, high = math.floor((n - 1) / 2.0 - half), math.ceil((n - 1) / 2.0 + half)
    return float(ordered[max(low, 0)]), float(ordered[min(high, n - 1)])


def bootstrap(count: int, statistic: Callable[[NDArray[np.intp]], float]) -> Interval:
    """Of `statistic(indices)` over images drawn again with replacement, always the same draws."""
    if count == 0:
        return NONE
    rng = np.random.default_rng(count)
    values = np.array([statistic(rng.integers(0, count, count)) for _ in range(RESAMPLES)])
    values = values[np.isfinite(values)]
    if values.size == 0:
        return NONE
    return float(np.quantile(values, _TAIL)), float(np.quantile(values, 1.0 - _TAIL))
