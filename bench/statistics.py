"""Rates from few trials: Wilson's interval, and how many more trials a decision needs.

E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
"""

import math
from statistics import NormalDist

CONFIDENCE = 0.95
MOST_TRIALS = 100_000


def wilson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Two-sided Wilson score interval of a rate; (0, 1) when nothing was tried.

    Raises:
        ValueError: counts that cannot be, or a confidence outside (0, 1).
    """
    _check_counts(successes, trials, confidence)
    if trials == 0:
        return 0.0, 1.0
    from scipy.stats import binomtest  # late: scipy.stats costs half a second to import

    interval = binomtest(successes, trials).proportion_ci(confidence_level=confidence, method="wilson")
    return float(interval.low), float(interval.high)


def trials_needed(successes: int, trials: int, limit: float, confidence: float = CONFIDENCE) -> int | None:
    """Further trials until the interval no longer contains `limit`, if the rate stays as it was observed.

    With no trials yet the rate is taken as 1, so this is the least number that could pass.

    Returns:
        0 when it is decided already; None when no practical number (100 000) would decide.

    Raises:
        ValueError: counts that cannot be, or a confidence or limit outside (0, 1).
    """
    _check_counts(successes, trials, confidence)
    if not 0 < limit < 1:
        raise ValueError(f"limit {limit}: a rate to decide on lies between 0 and 1")
    rate = successes / trials if trials else 1.0

    def decided(total: int) -> bool:
        low, high = _wilson(rate, total, confidence)
        return low >= limit or high < limit

    if trials and decided(trials):
        return 0
    low, high = max(trials, 1), MOST_TRIALS
    if not decided(high):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle + 1, high)
    return low - trials


def _wilson(rate: float, trials: int, confidence: float) -> tuple[float, float]:
    """Closed form for a rate that need not be a whole count; the half width falls as trials grow."""
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    shrink = 1 + z * z / trials
    centre = (rate + z * z / (2 * trials)) / shrink
    half = z * math.sqrt(rate * (1 - rate) / trials + (z / (2 * trials)) ** 2) / shrink
    return centre - half, centre + half


def _check_counts(successes: int, trials: int, confidence: float) -> None:
    if trials < 0 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials cannot be")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence {confidence}: must lie between 0 and 1")
