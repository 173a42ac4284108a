"""Rates from few trials: Wilson's interval, how many more trials a decision needs, sequential and paired tests.

E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
A. Wald, "Sequential tests of statistical hypotheses", Annals of Mathematical Statistics 16 (1945).
Q. McNemar, "Note on the sampling error of the difference between correlated proportions", Psychometrika 12 (1947).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

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


@dataclass(frozen=True)
class Sprt:
    """Wald's sequential test of "the rate is p1" against "it is p0", p0 < p1.

    Attributes:
        decision: "accept" (p1), "reject" (p0 is more likely) or "continue".
        at_trial: number of the trial that decided, from 1; None while it goes on.
        log_ratio: log likelihood ratio there, or after all trials.
        expected_more: further trials until a decision if the rate stays as it was observed (as p1 where nothing was
            observed); 0 when decided, None when it would not end in 100 000.
    """

    decision: Literal["accept", "reject", "continue"]
    at_trial: int | None
    log_ratio: float
    expected_more: int | None
    p0: float
    p1: float


def sprt(outcomes: Sequence[bool], p0: float, p1: float, alpha: float = 0.05, beta: float = 0.05) -> Sprt:
    """Run the test over outcomes in the order they were drawn; what comes after the decision is not looked at.

    Raises:
        ValueError: not 0 < p0 < p1 < 1, or an error rate outside (0, 0.5).
    """
    if not 0.0 < p0 < p1 < 1.0:
        raise ValueError(f"rates {p0}, {p1}: 0 < p0 < p1 < 1 is needed")
    if not (0.0 < alpha < 0.5 and 0.0 < beta < 0.5):
        raise ValueError(f"error rates {alpha}, {beta}: must lie between 0 and 0.5")
    up, down = math.log(p1 / p0), math.log((1.0 - p1) / (1.0 - p0))
    accept, reject = math.log((1.0 - beta) / alpha), math.log(beta / (1.0 - alpha))
    ratio = 0.0
    for number, success in enumerate(outcomes, start=1):
        ratio += up if success else down
        if ratio >= accept:
            return Sprt("accept", number, ratio, 0, p0, p1)
        if ratio <= reject:
            return Sprt("reject", number, ratio, 0, p0, p1)
    rate = sum(outcomes) / len(outcomes) if outcomes else p1
    drift = rate * up + (1.0 - rate) * down
    left = (accept - ratio) / drift if drift > 0.0 else (reject - ratio) / drift if drift < 0.0 else math.inf
    return Sprt("continue", None, ratio, math.ceil(left) if left <= MOST_TRIALS else None, p0, p1)


def mcnemar_exact(only_a: int, only_b: int) -> float:
    """Two-sided exact p-value of paired trials: `only_a` pairs that only A passed, `only_b` that only B passed.

    1.0 where the two never differed.

    Raises:
        ValueError: a negative count.
    """
    if only_a < 0 or only_b < 0:
        raise ValueError(f"{only_a}, {only_b}: counts cannot be negative")
    if only_a + only_b == 0:
        return 1.0
    from scipy.stats import binomtest

    return float(binomtest(only_a, only_a + only_b, 0.5).pvalue)


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
