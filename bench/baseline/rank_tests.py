"""One-sided rank tests of "worse", with an estimate of the shift and one-sided bounds that invert the same test.

Paired: Wilcoxon's signed-rank test, its null distribution exact for the ranks at hand (ties share their mean rank,
zeros are left out), the Hodges-Lehmann estimate, and bounds from the ordered Walsh averages. Independent: the
Mann-Whitney-Wilcoxon test with the estimate and the bounds from the ordered differences.
M. Hollander, D. A. Wolfe, E. Chicken, "Nonparametric Statistical Methods", 3rd ed. (2014), sections 3.1-3.3, 4.1-4.3.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
EXACT_UP_TO = 60
"""Pairs; beyond it the normal approximation of the bounds' rank is good to a rank or two."""


@dataclass(frozen=True)
class Shift:
    """Positive = worse. `p`: of so large a worsening by chance; `low`, `high`: one-sided bounds, each at the level
    asked for (infinite where the pairs are too few for one)."""

    n: int
    p: float
    estimate: float
    low: float
    high: float


def paired_shift(worse_by: Floats, alpha: float) -> Shift:
    """Test of worsenings (n,), one a pair.

    Raises:
        ValueError: no pairs, values that are not finite, or a level outside (0, 0.5).
    """
    _check(worse_by, alpha)
    d = np.asarray(worse_by, dtype=np.float64)
    n = len(d)
    i, j = np.triu_indices(n)
    walsh = np.sort((d[i] + d[j]) / 2.0)
    k = _lower_rank(n, alpha)
    low, high = (walsh[k - 1], walsh[len(walsh) - k]) if k >= 1 else (-math.inf, math.inf)
    return Shift(n, _signed_rank_p(d[d != 0.0]), float(np.median(walsh)), float(low), float(high))


def independent_shift(run: Floats, baseline: Floats, alpha: float) -> Shift:
    """Test of two sets of flights that have nothing to do with each other; values oriented so that more is worse.

    Raises:
        ValueError: as `paired_shift`.
    """
    _check(run, alpha)
    _check(baseline, alpha)
    from scipy.stats import mannwhitneyu

    x, y = np.asarray(run, dtype=np.float64), np.asarray(baseline, dtype=np.float64)
    m, n = len(x), len(y)
    apart = np.sort((x[:, None] - y[None, :]).ravel())
    z = NormalDist().inv_cdf(1.0 - alpha)
    k = math.floor(m * n / 2.0 - z * math.sqrt(m * n * (m + n + 1) / 12.0))
    low, high = (apart[k - 1], apart[len(apart) - k]) if k >= 1 else (-math.inf, math.inf)
    p = 1.0 if np.ptp(np.concatenate([x, y])) == 0.0 else float(mannwhitneyu(x, y, alternative="greater").pvalue)
    return Shift(min(m, n), p, float(np.median(apart)), float(low), float(high))


def least_pairs(alpha: float) -> int:
    """Pairs below which no result at all could be significant at `alpha`: 2^-n <= alpha."""
    return math.ceil(math.log2(1.0 / alpha))


def _signed_rank_p(d: Floats) -> float:
    """P(W+ at least as large) over all signs, given the ranks of |d|."""
    if not len(d):
        return 1.0
    from scipy.stats import rankdata

    doubled = np.rint(2.0 * rankdata(np.round(np.abs(d), 12))).astype(np.int64)
    ways = _sums(doubled)
    return float(ways[int(doubled[d > 0].sum()):].sum())


def _sums(ranks: NDArray[np.int64]) -> Floats:
    """Probability of every sum (0 .. total) of the ranks whose fair coin shows heads."""
    ways = np.zeros(int(ranks.sum()) + 1)
    ways[0] = 1.0
    for rank in ranks:
        shifted = np.zeros_like(ways)
        shifted[rank:] = ways[:len(ways) - rank]
        ways = (ways + shifted) / 2.0
    return ways


def _lower_rank(n: int, alpha: float) -> int:
    """Number of the ordered Walsh average that is the lower bound; 0 where there is none at this level."""
    if n > EXACT_UP_TO:
        half = n * (n + 1) / 4.0
        return max(math.floor(half - NormalDist().inv_cdf(1 - alpha) * math.sqrt(half * (2 * n + 1) / 6.0)), 0)
    tail = np.cumsum(_sums(np.arange(1, n + 1)))
    return int(np.searchsorted(tail, alpha, side="right"))


def _check(values: Floats, alpha: float) -> None:
    if not len(values) or not np.isfinite(values).all():
        raise ValueError(f"{len(values)} values, not all finite: a test needs finite ones")
    if not 0.0 < alpha < 0.5:
        raise ValueError(f"level {alpha}: must lie between 0 and 0.5")
