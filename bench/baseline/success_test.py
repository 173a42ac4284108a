"""Has the rate of clean flights dropped? McNemar's exact test over pairs, Fisher's where there are none."""

from collections.abc import Sequence
from dataclasses import dataclass

from bench.campaign.agreement import independent_difference, paired_difference


@dataclass(frozen=True)
class Drop:
    """`value` = rate of the baseline - rate of the run, positive = worse, with one-sided bounds; `seen_from`: the least
    drop that would have been significant, given how often the run was the better one (None: no drop would)."""

    n: int
    baseline: int
    run: int
    only_baseline: int | None
    only_run: int | None
    p: float
    value: float
    low: float
    high: float
    seen_from: float | None


def paired_drop(run: Sequence[bool], baseline: Sequence[bool], alpha: float) -> Drop:
    """Pairs of flights, both lists in the same order.

    Raises:
        ValueError: of unequal length, or empty.
    """
    both = paired_difference(baseline, run, 1.0 - 2.0 * alpha)
    n = len(run)
    lost = sum(b and not r for r, b in zip(run, baseline, strict=True))
    won = sum(r and not b for r, b in zip(run, baseline, strict=True))
    seen = next((k for k in range(won + 1, n - won + 1) if _tail(k, won) < alpha), None)
    return Drop(n, sum(baseline), sum(run), lost, won, _tail(lost, won), both.value, both.low, both.high,
                None if seen is None else (seen - won) / n)


def independent_drop(run: Sequence[bool], baseline: Sequence[bool], alpha: float) -> Drop:
    """Flights of different seeds.

    Raises:
        ValueError: one of them is empty.
    """
    m, n, a, b = len(run), len(baseline), sum(run), sum(baseline)
    apart = independent_difference(b, n, a, m, 1.0 - 2.0 * alpha)
    seen = next((k for k in range(a, -1, -1) if _fisher(k, m, b, n) < alpha), None)
    return Drop(min(m, n), b, a, None, None, _fisher(a, m, b, n), apart.value, apart.low, apart.high,
                None if seen is None else b / n - seen / m)


def _tail(lost: int, won: int) -> float:
    """P(at least `lost` of the pairs that differ go that way)."""
    if not lost:
        return 1.0
    from scipy.stats import binomtest

    return float(binomtest(lost, lost + won, 0.5, alternative="greater").pvalue)


def _fisher(run: int, trials: int, baseline: int, baseline_trials: int) -> float:
    from scipy.stats import fisher_exact

    table = [[run, trials - run], [baseline, baseline_trials - baseline]]
    return float(fisher_exact(table, alternative="less").pvalue)
