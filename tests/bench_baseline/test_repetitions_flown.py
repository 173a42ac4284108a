"""The repetitions of `repetitions.py` in small, really flown: worsened stacks are caught, the unchanged one is not."""

import sys
from pathlib import Path

import pytest
import repetitions

from bench.verdict import Verdict

SEEDS, PAIRS = range(1, 21), 10


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_worsened_stacks_are_caught_and_the_unchanged_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "repetitions", repetitions)
    repetitions.fly(tmp_path, repetitions.conditions_of("tbd"), SEEDS)
    found = repetitions.judge(tmp_path, SEEDS, PAIRS, 0.99)
    for name, comparisons in found.items():
        flagged = repetitions.flagged(comparisons)
        said = [c.reason for c in comparisons]
        if name in repetitions.WORSE:
            assert flagged == len(comparisons) == 2, (name, said)
        else:
            assert flagged == 0, (name, said)
    assert all(c.identical == PAIRS and c.verdict is Verdict.PASS for c in found["unchanged"])
    assert all(c.identical == 0 for c in found["nudged"]), "a nudge that changes nothing would prove nothing"
