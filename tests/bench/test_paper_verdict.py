"""Sequential and paired tests against published figures, and the verdict of a row."""

import numpy as np
import pytest

from bench.paper_verdict import paper_verdict
from bench.statistics import mcnemar_exact, sprt
from bench.verdict import Verdict


def test_sprt_ends_as_early_as_wald_promises() -> None:
    """0.70 against 0.85 at 5 % errors: 37 to 43 trials on average, and the errors it promises."""
    rng = np.random.default_rng(1)
    for rate, right in ((0.70, "reject"), (0.85, "accept")):
        runs = [sprt(list(rng.random(2000) < rate), 0.70, 0.85) for _ in range(1500)]
        assert 34.0 <= np.mean([r.at_trial for r in runs]) <= 46.0
        assert np.mean([r.decision == right for r in runs]) >= 0.94


def test_sprt_by_hand() -> None:
    up, accept = np.log(0.9 / 0.5), np.log(19.0)
    assert sprt([True] * 10, 0.5, 0.9).at_trial == int(np.ceil(accept / up)) == 6
    assert sprt([False] * 3, 0.5, 0.9).decision == "reject"
    after = sprt([True, False], 0.5, 0.9)
    assert after.decision == "continue" and after.log_ratio == pytest.approx(np.log(1.8) + np.log(0.2))
    assert sprt([], 0.5, 0.9).expected_more == int(np.ceil(accept / (0.9 * np.log(1.8) + 0.1 * np.log(0.2))))
    for bad in ((0.9, 0.5), (0.0, 0.5), (0.5, 1.0)):
        with pytest.raises(ValueError):
            sprt([], *bad)


def test_mcnemar_is_the_sign_test_of_what_differs() -> None:
    assert mcnemar_exact(0, 0) == 1.0
    assert mcnemar_exact(8, 0) == pytest.approx(2 * 0.5**8)
    assert mcnemar_exact(1, 9) == mcnemar_exact(9, 1) == pytest.approx(2 * 11 / 1024)
    with pytest.raises(ValueError):
        mcnemar_exact(-1, 2)


@pytest.mark.parametrize(
    ("outcomes", "paper", "verdict"),
    [([], (17, 22), Verdict.INCONCLUSIVE), ([True] * 4, (17, 22), Verdict.INCONCLUSIVE),
     ([True] * 20, (20, 20), Verdict.PASS), ([True] * 20, (17, 22), Verdict.PASS),
     ([False] * 10, (17, 22), Verdict.FAIL), ([True, False] * 10, (20, 20), Verdict.FAIL),
     ([True, True, False] * 6, (17, 21), Verdict.INCONCLUSIVE)],
)
def test_rows_are_held_to_the_papers_rate(outcomes: list[bool], paper: tuple[int, int], verdict: Verdict) -> None:
    held = paper_verdict(outcomes, *paper)
    assert held.verdict is verdict, held
    assert (held.trials_needed is not None) == (verdict is Verdict.INCONCLUSIVE)
    assert f"of {len(outcomes)}" in held.reason and f"paper {paper[0]} of {paper[1]}" in held.reason
