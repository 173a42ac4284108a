"""Screening: pairs of rows over the same seeds, and when the fast one may stand for the slow one."""

import json
from pathlib import Path
from typing import Any

import pytest

from bench.campaign.screening import MARGIN, screening_of, screening_suite
from bench.campaign.suite import load_suite, parse_suite
from bench.campaign_table import screening_cells
from saranga.errors import UsageError

PAIR = [{"name": "a", "fast": "a.embedded", "slow": "a.arducopter"}]
RULES = {"a.embedded": "strict", "a.arducopter": "strict"}


def trial(row: str, seed: int, good: bool, folder: Path | None = None, y_m: float = 0.0,
          outcome: str | None = None) -> dict[str, Any]:
    files = {}
    if folder is not None:
        name = f"{row}-{seed}.json"
        track = [[0.25 * k, 0.8 + 0.25 * k, y_m, -1.0] for k in range(30)]
        (folder / name).write_text(json.dumps({"track": track}))
        files["trial"] = name
    return {"row": row, "seed": seed, "outcome": outcome or ("clean" if good else "obstacle_hit"),
            "success_strict": good, "success_lenient": good, "files": files}


def pairs(table: list[tuple[bool, bool]], folder: Path | None = None) -> list[dict[str, Any]]:
    return [t for seed, (fast, slow) in enumerate(table, 1)
            for t in (trial("a.embedded", seed, fast, folder, 0.1), trial("a.arducopter", seed, slow, folder, -0.1))]


def test_every_row_is_flown_by_both_over_the_same_seeds() -> None:
    suite = screening_suite(load_suite("paper").changed(["thin", "3d"], 5, seed=40))
    assert [row.name for row in suite.rows] == ["thin.embedded", "thin.arducopter", "3d.embedded", "3d.arducopter"]
    requests = [suite.request(row, 40) for row in suite.rows]
    assert [r.autopilot for r in requests] == ["embedded", "arducopter"] * 2
    assert [r.sonar for r in requests] == ["pair", "pair", "triple", "triple"]
    assert len({tuple(suite.seeds(row)) for row in suite.rows}) == 1
    assert all(row.paper is None for row in suite.rows), "this is no test against the paper"
    again = parse_suite(json.loads(json.dumps(suite.to_dict())), suite.path)
    assert again.rows == suite.rows and again.screenings == suite.screenings
    with pytest.raises(UsageError, match=r"screening 'x' names row 'nope', which is not there"):
        wrong = {"name": "x", "fast": "nope", "slow": "3d.embedded"}
        parse_suite({**suite.to_dict(), "screening": [wrong]}, suite.path)


@pytest.mark.parametrize(
    ("table", "verdict", "words"),
    [([(True, True)] * 40 + [(False, False)] * 20, "PASS", "may screen, with an error of at most 4 points"),
     ([(True, False)] * 20 + [(True, True)] * 20, "FAIL", "more than 10 points apart, must not screen"),
     ([(True, True)] * 10, "INCONCLUSIVE", "more pairs would show that"),
     ([(True, True)] * 8 + [(True, False)] * 2, "INCONCLUSIVE", "no number of pairs would show that"),
     ([(True, True)] * 9, "INCONCLUSIVE", "9 pairs: 10 are the least"),
     ([], "INCONCLUSIVE", "0 pairs")],
)
def test_the_verdict_is_the_interval_against_the_margin(table: list[tuple[bool, bool]], verdict: str,
                                                         words: str) -> None:
    found = screening_of(PAIR, RULES, pairs(table), None)
    assert found is not None
    assert (found["verdict"], found["margin"]) == (verdict, MARGIN) and words in found["reason"], found["reason"]
    assert len(screening_cells(found)) == 3


def test_what_is_said_of_the_pairs(tmp_path: Path) -> None:
    outcomes = pairs([(True, True)] * 6 + [(True, False)] * 3 + [(False, True)] * 1 + [(False, False)] * 2, tmp_path)
    outcomes += [trial("a.embedded", 90, True), trial("a.arducopter", 90, False, outcome="infrastructure"),
                 trial("a.embedded", 91, True)]
    found = screening_of(PAIR, RULES, outcomes, tmp_path)
    assert found is not None
    whole = found["all"]
    assert whole["pairs"] == 12, "a flight that broke off, or has no partner, is no pair"
    assert (whole["only_fast"], whole["only_slow"]) == (3, 1) and whole["agreement"]["count"] == 8
    assert whole["difference"]["value"] == pytest.approx(2 / 12)
    assert whole["fast_rate"] == pytest.approx(9 / 12) and whole["slow_rate"] == pytest.approx(7 / 12)
    assert whole["kappa"]["value"] == pytest.approx((8 / 12 - 0.5416667) / (1 - 0.5416667), abs=1e-3)
    assert whole["paths"]["rms_m"] == pytest.approx(0.2) and whole["paths"]["max_m"] == pytest.approx(0.2)
    assert whole["stated_error"] == pytest.approx(max(map(abs, whole["difference"]["interval"])))
    (tmp_path / "a.embedded-1.json").write_text("{")
    damaged = screening_of(PAIR, RULES, outcomes, tmp_path)
    assert damaged is not None and damaged["all"]["paths"]["compared"] == 11
    assert screening_of([], RULES, outcomes, tmp_path) is None
