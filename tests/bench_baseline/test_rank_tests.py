"""The tests behind the regression verdict: known values, and how often they cry wolf."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, wilcoxon

from bench.baseline.rank_tests import independent_shift, least_pairs, paired_shift
from bench.baseline.success_test import independent_drop, paired_drop

ALPHA = 0.01 / 7


def test_the_signed_rank_p_is_that_of_scipy() -> None:
    rng = np.random.default_rng(1)
    for n in (5, 9, 20):
        d = rng.normal(0.3, 1.0, n)
        assert paired_shift(d, 0.05).p == pytest.approx(wilcoxon(d, alternative="greater", method="exact").pvalue)
    x, y = rng.normal(0.5, 1, 15), rng.normal(0, 1, 12)
    assert independent_shift(x, y, 0.05).p == pytest.approx(mannwhitneyu(x, y, alternative="greater").pvalue)


def test_ties_and_zeros_are_exact() -> None:
    assert paired_shift(np.full(10, 100.0), 0.05).p == pytest.approx(2.0**-10)
    assert paired_shift(np.zeros(12), 0.05) == paired_shift(np.zeros(12), 0.05)
    same = paired_shift(np.zeros(12), 0.05)
    assert (same.p, same.estimate, same.low, same.high) == (1.0, 0.0, 0.0, 0.0)


def test_the_bound_is_where_the_test_turns() -> None:
    d = np.random.default_rng(4).normal(0.4, 1.0, 18)
    low = paired_shift(d, ALPHA).low
    assert paired_shift(d - low - 1e-9, ALPHA).p > ALPHA >= paired_shift(d - low + 1e-9, ALPHA).p


def test_too_few_pairs_have_no_bound() -> None:
    assert least_pairs(ALPHA) == 10 and least_pairs(0.05 / 7) == 8
    assert paired_shift(np.ones(9), ALPHA).low == -np.inf and np.isfinite(paired_shift(np.ones(10), ALPHA).low)
    with pytest.raises(ValueError, match="not all finite"):
        paired_shift(np.array([1.0, np.nan]), 0.05)
    with pytest.raises(ValueError, match="0 values"):
        paired_shift(np.array([]), 0.05)
    with pytest.raises(ValueError, match="level"):
        paired_shift(np.ones(3), 0.6)


@pytest.mark.parametrize("shift", [0.0, 1.5])
def test_how_often_it_says_worse(shift: float) -> None:
    """At level 0.05: at most that where nothing has changed, nearly always where 1.5 deviations have."""
    rng = np.random.default_rng(7)
    trials = [rng.normal(shift, 1.0, 20) for _ in range(400)]
    paired = sum(paired_shift(d, 0.05).p < 0.05 for d in trials) / len(trials)
    alone = sum(independent_shift(d, rng.normal(0, 1, 20), 0.05).p < 0.05 for d in trials) / len(trials)
    covered = sum(paired_shift(d, 0.05).low <= shift for d in trials) / len(trials)
    assert covered >= 0.92
    assert (paired <= 0.08 and alone <= 0.08) if shift == 0.0 else (paired > 0.95 and alone > 0.95)


def test_a_drop_of_the_rate() -> None:
    yes, no = [True] * 20, [True] * 8 + [False] * 12
    drop = paired_drop(no, yes, ALPHA)
    assert drop.p == pytest.approx(2.0**-12) and drop.value == pytest.approx(0.6) and 0 < drop.low < 0.6 < drop.high
    same = paired_drop(yes, yes, ALPHA)
    assert same.p == 1.0 and same.seen_from == pytest.approx(10 / 20), "ten pairs one way are needed"
    assert paired_drop(yes, no, ALPHA).p == 1.0, "better is never a regression"
    seen = [True] * 10 + [False] * 10
    assert paired_drop(seen, yes, ALPHA).p < ALPHA <= paired_drop([True] * 11 + [False] * 9, yes, ALPHA).p
    assert paired_drop([True] * 5, [True] * 5, ALPHA).seen_from is None


def test_a_drop_of_independent_rates() -> None:
    yes, no = [True] * 20, [False] * 15 + [True] * 5
    assert independent_drop(no, yes, ALPHA).p < 1e-5 and independent_drop(yes, no, ALPHA).p == pytest.approx(1.0)
    seen = independent_drop(yes, yes, ALPHA).seen_from
    assert seen is not None
    k = round(20 * (1 - seen))
    assert independent_drop([True] * k + [False] * (20 - k), yes, ALPHA).p < ALPHA
    assert independent_drop([True] * (k + 1) + [False] * (19 - k), yes, ALPHA).p >= ALPHA
