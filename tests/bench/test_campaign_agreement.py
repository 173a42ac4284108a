"""Agreement of two ways to fly: intervals that hold what they promise, and paths compared where both have been."""

import math

import numpy as np
import pytest

from bench.campaign.agreement import (
    cohens_kappa,
    independent_difference,
    paired_difference,
    pairs_needed,
    path_agreement,
)


def test_the_paired_interval_is_that_of_bonett_and_price() -> None:
    # 3 seeds only a, 1 only b, of 20: (4/22 - 2/22) +- 1.95996 sqrt((6/22 - (2/22)^2) / 22)
    a = [True] * 13 + [True] * 3 + [False] + [False] * 3
    b = [True] * 13 + [False] * 3 + [True] + [False] * 3
    found = paired_difference(a, b)
    half = 1.959964 * math.sqrt((6 / 22 - (2 / 22) ** 2) / 22)
    assert found.value == pytest.approx(0.1)
    assert (found.low, found.high) == (pytest.approx(2 / 22 - half, abs=1e-6), pytest.approx(2 / 22 + half, abs=1e-6))
    assert found.largest == found.high


@pytest.mark.parametrize("rates", [(0.05, 0.05), (0.10, 0.02), (0.0, 0.15)])
@pytest.mark.parametrize("n", [20, 60])
def test_the_paired_interval_covers_the_truth_as_often_as_it_says(rates: tuple[float, float], n: int) -> None:
    rng = np.random.default_rng(7)
    draws = rng.multinomial(n, [*rates, 1.0 - sum(rates)], 1500)
    truth = rates[0] - rates[1]
    covered = 0
    for only_a, only_b, same in draws.tolist():
        a = [True] * only_a + [False] * only_b + [True] * same
        b = [False] * only_a + [True] * only_b + [True] * same
        found = paired_difference(a, b)
        covered += found.low <= truth <= found.high
    assert covered / 1500 > 0.93


def test_newcombes_interval_is_the_one_he_printed() -> None:
    found = independent_difference(56, 70, 48, 80)  # his example (a), method 10
    assert (found.low, found.high) == (pytest.approx(0.0524, abs=2e-4), pytest.approx(0.3339, abs=2e-4))
    with pytest.raises(ValueError, match="no trials"):
        independent_difference(0, 0, 1, 2)


def test_kappa_of_a_known_table_and_where_it_says_nothing() -> None:
    a = [True] * 20 + [True] * 5 + [False] * 10 + [False] * 15
    b = [True] * 20 + [False] * 5 + [True] * 10 + [False] * 15
    kappa = cohens_kappa(a, b)
    assert kappa is not None and kappa[0] == pytest.approx(0.4) and kappa[1] < 0.4 < kappa[2]
    assert cohens_kappa([True] * 9, [True] * 9) is None
    with pytest.raises(ValueError, match="pairs are needed"):
        cohens_kappa([True], [])


def test_pairs_needed_is_the_first_number_that_fits() -> None:
    more = pairs_needed(0, 0, 10, 0.10)
    assert more is not None and more > 0
    total = 10 + more
    inside = paired_difference([True] * total, [True] * total)
    outside = paired_difference([True] * (total - 1), [True] * (total - 1))
    assert inside.largest <= 0.10 < outside.largest
    assert pairs_needed(5, 0, 20, 0.10) is None, "a difference beyond the margin is shown by no number of pairs"


def track(y_m: float, to_x_m: float, jitter: float = 0.0) -> np.ndarray:
    x = np.concatenate([np.full(8, 0.8), np.arange(0.8, to_x_m, 0.25)])
    z = np.concatenate([np.linspace(0.0, -1.0, 8), np.full(len(x) - 8, -1.0)])
    y = np.where(x > 3.0, y_m, 0.0) + jitter
    return np.column_stack([np.arange(len(x)) * 0.25, x, y, z])


def test_paths_are_compared_where_both_have_been() -> None:
    same = path_agreement(track(0.5, 9.5), track(0.5, 9.5))
    assert same is not None and same.max_m == 0.0
    apart = path_agreement(track(0.5, 9.5), track(-0.3, 5.0))
    assert apart is not None and apart.common_m == pytest.approx(4.8 - 1.1, abs=0.05)
    assert apart.max_m == pytest.approx(0.8) and 3.0 < apart.at_m < 5.0 and 0.4 < apart.rms_m < 0.8
    assert path_agreement(track(0.5, 9.5), track(0.5, 1.5)) is None
    back = np.concatenate([track(0.0, 5.0), [[99.0, 3.0, 2.0, -1.0], [99.2, 2.0, 2.0, -1.0]]])
    returned = path_agreement(track(0.0, 5.0), back)
    assert returned is not None and returned.max_m == 0.0, "the way back is not the way"
