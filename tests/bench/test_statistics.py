"""Wilson's interval and the number of trials, against the paper's own rates and a brute-force count."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.statistics import trials_needed, wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (17, 22, 0.57, 0.90),  # film
        (17, 21, 0.60, 0.92),  # thin
        (15, 20, 0.53, 0.89),  # snow
        (18, 20, 0.70, 0.97),  # fog
        (20, 20, 0.84, 1.00),  # low light
        (16, 22, 0.52, 0.87),  # 3-D
    ],
)
def test_intervals_of_the_papers_flights(successes: int, trials: int, low: float, high: float) -> None:
    got = wilson_interval(successes, trials)
    assert got == (pytest.approx(low, abs=0.006), pytest.approx(high, abs=0.006))


def test_nothing_tried_says_nothing() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("successes", "trials"), [(2, 1), (-1, 3), (0, -1)])
def test_impossible_counts_are_refused(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match="cannot be"):
        wilson_interval(successes, trials)


def test_trials_needed_is_where_the_interval_first_leaves_the_limit() -> None:
    # all of n: the lower bound is n / (n + 3.8415), so 0.6 takes n = 5.76 -> 6
    assert trials_needed(0, 0, 0.6) == 6
    assert trials_needed(3, 3, 0.6) == 3
    assert trials_needed(6, 6, 0.6) == 0
    # none of n: the upper bound is 3.8415 / (n + 3.8415) < 0.6 from n = 2.56 -> 3
    assert trials_needed(0, 1, 0.6) == 2


def test_a_rate_on_the_limit_is_never_decided() -> None:
    assert trials_needed(6, 10, 0.6) is None


@given(st.integers(1, 60), st.data())
def test_flying_the_number_it_says_decides(trials: int, data: st.DataObject) -> None:
    """Independent of the closed form: repeat what was seen m times and ask scipy."""
    successes = data.draw(st.integers(0, trials))
    more = trials_needed(successes, trials, 0.6)
    if more is None or more > 3000:
        return
    times = -(-(trials + more) // trials)
    low, high = wilson_interval(successes * times, trials * times)
    assert low >= 0.6 or high < 0.6
    if more > 1:
        low, high = wilson_interval(successes, trials)
        assert low < 0.6 <= high
