"""How well two ways to fly agree over the same seeds: outcomes, rates, paths.

Paired difference of rates: D. G. Bonett, R. M. Price, "Adjusted Wald confidence interval for a difference of binomial
proportions based on paired data", J. Educational and Behavioral Statistics 37 (2012). Independent difference: R. G.
Newcombe, "Interval estimation for the difference between independent proportions", Statistics in Medicine 17 (1998),
method 10. Kappa: J. Cohen, Educational and Psychological Measurement 20 (1960), with its large-sample error.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from bench.statistics import CONFIDENCE, wilson_interval

STEP_M = 0.1
TAKE_OFF_M = 0.3
"""Of the course at its start that is not compared: the vehicle climbs there."""
LEAST_COMMON_M = 1.0


@dataclass(frozen=True)
class Difference:
    """`value` = rate of a - rate of b, with its interval, all -1 .. 1."""

    value: float
    low: float
    high: float

    @property
    def largest(self) -> float:
        """The largest difference that the interval allows, without its sign."""
        return max(abs(self.low), abs(self.high))


def paired_difference(a: Sequence[bool], b: Sequence[bool], confidence: float = CONFIDENCE) -> Difference:
    """Difference of two success rates over the same seeds.

    Raises:
        ValueError: of unequal length, or empty.
    """
    if len(a) != len(b) or not a:
        raise ValueError(f"{len(a)} and {len(b)} outcomes: pairs are needed")
    n = len(a)
    only_a = sum(x and not y for x, y in zip(a, b, strict=True))
    only_b = sum(y and not x for x, y in zip(a, b, strict=True))
    low, high = _bonett_price(only_a, only_b, n, confidence)
    return Difference((only_a - only_b) / n, low, high)


def _bonett_price(only_a: float, only_b: float, n: float, confidence: float) -> tuple[float, float]:
    pa, pb = (only_a + 1.0) / (n + 2.0), (only_b + 1.0) / (n + 2.0)
    half = _z(confidence) * math.sqrt((pa + pb - (pa - pb) ** 2) / (n + 2.0))
    return max(pa - pb - half, -1.0), min(pa - pb + half, 1.0)


def pairs_needed(only_a: int, only_b: int, n: int, margin: float, confidence: float = CONFIDENCE) -> int | None:
    """Further pairs until the interval lies within +-margin if what was seen goes on; None where it never will."""
    if not n or abs(only_a - only_b) / n >= margin:
        return None
    for total in range(n, 50 * n + 1000):
        low, high = _bonett_price(only_a * total / n, only_b * total / n, total, confidence)
        if -margin <= low and high <= margin:
            return total - n
    return None


def independent_difference(successes_a: int, trials_a: int, successes_b: int, trials_b: int,
                           confidence: float = CONFIDENCE) -> Difference:
    """Difference of two rates from trials that have nothing to do with each other.

    Raises:
        ValueError: counts that cannot be, or no trials.
    """
    if not trials_a or not trials_b:
        raise ValueError("no trials: there is no rate")
    (la, ha), (lb, hb) = (wilson_interval(k, n, confidence)
                          for k, n in ((successes_a, trials_a), (successes_b, trials_b)))
    pa, pb = successes_a / trials_a, successes_b / trials_b
    return Difference(pa - pb, pa - pb - math.hypot(pa - la, hb - pb), pa - pb + math.hypot(ha - pa, pb - lb))


def cohens_kappa(a: Sequence[bool], b: Sequence[bool], confidence: float = CONFIDENCE
                 ) -> tuple[float, float, float] | None:
    """Kappa with its interval; None where chance alone agrees fully (both always the same one outcome)."""
    if len(a) != len(b) or not a:
        raise ValueError(f"{len(a)} and {len(b)} outcomes: pairs are needed")
    n = len(a)
    seen = sum(x == y for x, y in zip(a, b, strict=True)) / n
    rate_a, rate_b = sum(a) / n, sum(b) / n
    chance = rate_a * rate_b + (1.0 - rate_a) * (1.0 - rate_b)
    if chance >= 1.0:
        return None
    kappa = (seen - chance) / (1.0 - chance)
    half = _z(confidence) * math.sqrt(seen * (1.0 - seen) / n) / (1.0 - chance)
    return kappa, max(kappa - half, -1.0), min(kappa + half, 1.0)


@dataclass(frozen=True)
class PathAgreement:
    """Distance between two paths across the course, at equal distance along it.

    Attributes:
        common_m: how much of the course both have flown.
        rms_m, max_m: over that.
        at_m: along the course, where the largest one is.
    """

    common_m: float
    rms_m: float
    max_m: float
    at_m: float


def path_agreement(a: NDArray[np.float64], b: NDArray[np.float64]) -> PathAgreement | None:
    """Compare two tracks (K, 4), (L, 4) of t_s, x, y, z where each first passed every 0.1 m of x.

    None where less than a metre is common.
    """
    first, second = _advancing(a), _advancing(b)
    begin = max(first[0, 0], second[0, 0]) + TAKE_OFF_M
    end = min(first[-1, 0], second[-1, 0])
    if end - begin < LEAST_COMMON_M:
        return None
    x = np.arange(begin, end, STEP_M)
    apart = np.hypot(*(np.interp(x, first[:, 0], first[:, k]) - np.interp(x, second[:, 0], second[:, k])
                       for k in (1, 2)))
    at = int(np.argmax(apart))
    return PathAgreement(float(end - begin), float(np.sqrt(np.mean(apart**2))), float(apart[at]), float(x[at]))


def _advancing(track: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M, 3) x, y, z where x is larger than ever before."""
    xyz = np.asarray(track, dtype=np.float64).reshape(-1, 4)[:, 1:]
    if not len(xyz):
        return np.zeros((1, 3))
    before = np.concatenate([[-np.inf], np.maximum.accumulate(xyz[:, 0])[:-1]])
    return xyz[xyz[:, 0] > before]


def _z(confidence: float) -> float:
    return NormalDist().inv_cdf(0.5 + confidence / 2.0)
