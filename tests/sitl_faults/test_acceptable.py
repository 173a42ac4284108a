"""What a flight with a fault did, held to what is acceptable: nothing that is not known passes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bench import cli
from bench.campaign.behaviour import Acceptable, behaviour_of, judge_row
from bench.campaign.flying import Flown, Task
from bench.campaign.runner import Plan, run_campaign
from bench.campaign.suite import load_suite, parse_suite
from bench.campaign.workers import Done
from bench.campaign_table import table_text
from bench.interrupt import Interrupts
from bench.store import Store
from bench.verdict import Verdict
from saranga.errors import UsageError
from sitl.faults import fault_modules

REASON = "because a test says so"
LEFT = "autopilot left guided flight (mode LAND, armed True): "


def flight(outcome: str, cause: str = "so", seed: int = 1, speed: float | None = 0.1, clean: bool | None = None
           ) -> dict[str, Any]:
    return {"outcome": outcome, "cause": cause, "seed": seed, "measures": {"end_speed_m_s": speed},
            "success_strict": outcome == "clean" if clean is None else clean}


@pytest.mark.parametrize(("result", "word"), [
    (flight("clean"), "flew_on"), (flight("clean", clean=False), "lost"), (flight("obstacle_hit"), "touched"),
    (flight("net_hit"), "touched"), (flight("stuck"), "stopped"), (flight("timeout"), "stopped"),
    (flight("infrastructure", "stack: sensor right silent for 1.3 s"), "held"),
    (flight("infrastructure", "stack: sensor right silent for 1.3 s", speed=0.9), "lost"),
    (flight("infrastructure", "stack: sensor right silent for 1.3 s", speed=None), "lost"),
    (flight("infrastructure", "arducopter process ended"), "broken"),
    (flight("infrastructure", "fault flow_lost=1@60 never happened"), "broken"), (flight("interrupted"), "broken"),
    (flight("estimator_failure", LEFT + "'EKF'; landed after 4.2 s"), "failsafe"),
    (flight("estimator_failure", LEFT + "'EKF'; came down on its side after 2.0 s"), "lost"),
    (flight("estimator_failure", LEFT + "'EKF'; then front of the body hit obstacle 2 at 0.4 m/s"), "touched"),
    (flight("estimator_failure", LEFT + "'EKF'"), "lost"), (flight("estimator_failure", "touched the ground"), "lost"),
    (flight("something new"), "broken"), ({}, "broken")])
def test_one_word_for_every_end(result: dict[str, Any], word: str) -> None:
    assert behaviour_of(result) == word


def allow(*may: Any, **more: Any) -> Acceptable:
    return Acceptable(may=list(may), reason=REASON, **more)


def test_every_flight_must_do_what_it_may() -> None:
    good, bad = flight("stuck"), flight("obstacle_hit", "hit a pole", seed=7)
    assert judge_row(allow("stopped"), [good] * 3, 3).verdict is Verdict.PASS
    found = judge_row(allow("stopped"), [good, good, bad], 3)
    assert found.verdict is Verdict.FAIL and "seed 7: hit a pole" in found.reason and found.did["touched"] == 1
    assert judge_row(allow("stopped"), [good] * 2, 3).verdict is Verdict.INCONCLUSIVE
    assert judge_row(allow("stopped"), [], 3).verdict is Verdict.INCONCLUSIVE
    broken = judge_row(allow("stopped"), [good, flight("infrastructure", "no binary")], 2)
    assert broken.verdict is Verdict.ERROR and "no binary" in broken.reason


def test_the_rate_of_touches_is_judged_by_its_interval() -> None:
    rule = allow("flew_on", touched_at_most=0.4)
    clean, hit = flight("clean"), flight("obstacle_hit")
    assert judge_row(rule, [clean] * 12, 12).verdict is Verdict.PASS
    few = judge_row(rule, [clean] * 3, 3)
    assert few.verdict is Verdict.INCONCLUSIVE and few.trials_needed and "more flights would decide" in few.reason
    assert judge_row(rule, [hit] * 10 + [clean] * 2, 12).verdict is Verdict.FAIL


def test_it_must_end_for_the_right_reason() -> None:
    rule = allow("held", says="sensor right silent")
    assert judge_row(rule, [flight("infrastructure", "stack: sensor right silent for 1 s")], 1).verdict is Verdict.PASS
    wrong = judge_row(rule, [flight("infrastructure", "stack: echo source silent for 1 s")], 1)
    assert wrong.verdict is Verdict.FAIL and "another reason" in wrong.reason


SUITE = """
[suite]
name = "mine"
description = "a test"
trials = 12
denoiser = "tbd"
[[row]]
name = "healthy"
scene = "poles"
acceptable = { may = ["flew_on"], reason = "nothing is broken here" }
[[row]]
name = "dead"
scene = "poles"
faults = { dead_sensor = "right", flow_lost = "1@3" }
acceptable = { may = ["held"], says = "right", reason = "it must say which sensor" }
[[comparison]]
name = "it is noticed"
a = "healthy"
b = "dead"
expect = "regression"
"""


@pytest.mark.parametrize(("change", "words"), [
    (("flow_lost = \"1@3\"", "flow_lots = 1"), "row dead: unknown fault 'flow_lots'"),
    (("acceptable = { may = [\"held\"], says = \"right\", reason = \"it must say which sensor\" }", ""),
     "say what is acceptable, and why"),
    (("may = [\"held\"]", "may = [\"flew\"]"), "must be 'flew_on'"),
    (("it must say which sensor", "so"), "at least 10 characters"),
    (("may = [\"held\"]", "may = [\"touched\"], touched_at_most = 0.5"), "leave one of them out"),
    (("faults = { d", "paper = { successes = 1, trials = 2 }\nfaults = { d"), "not to both")])
def test_a_bad_row_is_one_clear_error(change: tuple[str, str], words: str, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(SUITE.replace(*change))
    with pytest.raises(UsageError) as caught:
        load_suite(str(tmp_path / "bad.toml"))
    assert words in str(caught.value)


def test_the_shipped_suite_has_a_row_for_every_kind_of_fault() -> None:
    suite = load_suite("faults")
    planted = {name for row in suite.rows for name in row.faults}
    assert set(fault_modules()) <= planted, "a fault that no row plants"
    assert {"dead_sensor", "setpoint_delay_ms", "corrupt_probability"} <= planted
    assert all(row.acceptable is not None for row in suite.rows)
    again = parse_suite(suite.to_dict(), suite.path)
    assert again.to_dict() == suite.to_dict() and [r.planted for r in again.rows] == [r.planted for r in suite.rows]


class AtOnce:
    """Workers that answer without flying."""

    count = 1

    def __init__(self, answer: Callable[[Task], dict[str, Any]]) -> None:
        self.answer = answer

    def run(self, tasks: Any, cancelled: Any) -> Any:
        for task in tasks:
            result = {**flight("clean", seed=task.request.seed), "label": None, "min_clearance_m": 0.3,
                      "duration_s": 10.0, "path_excess": 1.0, "determinism_hash": f"{task.key}", **self.answer(task)}
            result["measures"] |= {"first_seen_m": 1.4, "dodge_from_m": 1.0, "echo_to_setpoint_ms": 41.0}
            yield Done(task, Flown(result, {}, [], None, {}, "here", 1.0))

    def close(self) -> None:
        """Nothing to end."""


def fly(root: Path, answer: Callable[[Task], dict[str, Any]]) -> dict[str, Any]:
    (root / "mine.toml").write_text(SUITE)
    workers: Any = AtOnce(answer)
    return run_campaign(Plan(load_suite(str(root / "mine.toml")), lambda: workers), Store(root / "runs"), Interrupts(),
                        lambda text: None)


def test_a_campaign_of_faults_is_judged_by_behaviour(tmp_path: Path) -> None:
    def held(task: Task) -> dict[str, Any]:
        assert (task.request.faults is not None) == (task.row == "dead")
        return flight("infrastructure", "stack: sensor right silent", task.request.seed) if task.row == "dead" else {}

    summary = fly(tmp_path, held)
    rows = {row["name"]: row for row in summary["rows"]}
    assert rows["dead"]["verdict"] == "PASS" and rows["dead"]["behaviours"] == {"held": 12} and not summary["errors"]
    assert rows["healthy"]["verdict"] == "PASS"
    assert summary["comparisons"][0]["verdict"] == "INCONCLUSIVE", "held flights are no pairs to compare"
    dead = [t for t in summary["outcomes"] if t["row"] == "dead"]
    assert all(t["verdict"] == "PASS" and "--fault flow_lost=1@3" in t["replay"] for t in dead)
    folder = Path(summary["run"])
    assert "acceptable: held, saying \"right\"" in table_text(summary)
    assert "it must say which sensor" in (folder / "report.html").read_text()
    assert "| dead (dead_sensor=right, flow_lost=1@3) | PASS |" in (folder / "summary.md").read_text()
    assert 'errors="0"' in (folder / "junit.xml").read_text()


@pytest.mark.parametrize(("loss_m", "verdict"), [(0.5, "PASS"), (0.0, "FAIL")])
def test_a_worsening_must_be_noticed(loss_m: float, verdict: str, tmp_path: Path) -> None:
    def seen(task: Task) -> dict[str, Any]:
        return {"duration_s": 10.0 + 5.0 * loss_m * (task.row == "dead")}

    summary = fly(tmp_path, seen)
    assert summary["comparisons"][0]["verdict"] == verdict
    assert {r["name"]: r["verdict"] for r in summary["rows"]} == {"healthy": "PASS", "dead": "FAIL"}


def test_a_campaign_is_held_to_an_earlier_one(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                              tmp_path: Path) -> None:
    lost_m = 0.0

    def seen(task: Task) -> dict[str, Any]:
        held = flight("infrastructure", "stack: sensor right silent", task.request.seed) if task.row == "dead" else {}
        return {**held, "min_clearance_m": 0.3 - lost_m}

    def run(*more: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as caught:
            cli.main(["campaign", str(tmp_path / "mine.toml"), "--quiet", "--out", str(tmp_path / "runs"), *more])
        return int(caught.value.code or 0), capsys.readouterr().out

    monkeypatch.setattr("bench.campaign.workers.LocalWorkers", lambda count: AtOnce(seen))
    (tmp_path / "mine.toml").write_text(SUITE.partition("[[comparison]]")[0])
    assert run()[0] == 0
    first = next((tmp_path / "runs").glob("*-campaign-*"))
    code, out = run("--baseline", str(first))
    assert code == 0 and "no regression shown over 24 pairs" in out, out
    lost_m = 0.2
    code, out = run("--baseline", str(first))
    assert code == 1 and "min_clearance_m: worse by 0.2 m" in out, out
