"""The regression verdict over fabricated runs: what is flagged, what is not, and what is refused."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from fabricated_runs import WORLD, make_run, result_of

from bench import cli
from bench.baseline.flights import Pairs, read_flights
from bench.baseline.report import comparison_markdown, comparison_text
from bench.baseline.verdict import Comparison, compare, compare_runs
from bench.verdict import Verdict
from saranga.errors import UsageError
from sitl.trial_types import Faults

SEEDS = range(1, 21)


def held(run: Path, baseline: Path, paired: bool = True, confidence: float = 0.99) -> Comparison:
    return compare_runs(read_flights(run), read_flights(baseline), paired, confidence)


def test_an_unchanged_stack_passes_and_says_what_it_could_have_seen(tmp_path: Path) -> None:
    base = make_run(tmp_path, SEEDS)
    found = held(make_run(tmp_path, SEEDS), base)
    assert found.verdict is Verdict.PASS and found.identical == 20 and found.pairs == 20
    assert "no regression shown over 20 pairs" in found.reason and "50 points would have been" in found.reason
    assert all(f.verdict is Verdict.PASS for f in found.findings) and len(found.findings) == 7
    assert all(f.would_see >= f.margin for f in found.findings)
    text, page = comparison_text(found), comparison_markdown(found)
    assert "PASS   against" in text and "first_seen_m" in text and "0.99 confidence for all 7 tests" in text
    assert page.startswith("## Against the baseline: PASS") and page.count("| --- |") >= 1
    json.dumps(found.to_dict(), allow_nan=False)


def worse(measure: str, by: float) -> Any:
    def change(result: dict[str, Any], seed: int) -> None:
        home = result if measure in result else result["measures"]
        home[measure] += by * (1.0 + 0.1 * (seed % 5))

    return change


def crashes(result: dict[str, Any], seed: int) -> None:
    if seed % 3:
        result.update(outcome="obstacle_hit", success_strict=False, min_clearance_m=0.0)


@pytest.mark.parametrize(("change", "by"), [
    (worse("first_seen_m", -0.2), "first_seen_m"), (worse("echo_to_setpoint_ms", 100.0), "echo_to_setpoint_ms"),
    (worse("min_clearance_m", -0.1), "min_clearance_m"), (worse("duration_s", 2.0), "duration_s"),
    (crashes, "success")])
def test_a_worsened_stack_fails_by_name(change: Any, by: str, tmp_path: Path) -> None:
    found = held(make_run(tmp_path, SEEDS, change), make_run(tmp_path, SEEDS))
    assert found.verdict is Verdict.FAIL and by in found.reason
    assert by in {f.name for f in found.findings if f.verdict is Verdict.FAIL}


def test_what_is_worse_by_itself_is_not_passed(tmp_path: Path) -> None:
    def clean(result: dict[str, Any], seed: int) -> None:
        result["success_strict"] = True

    def nine_lost(result: dict[str, Any], seed: int) -> None:
        result["success_strict"] = seed == SEEDS[0]

    ten = range(SEEDS[0], SEEDS[0] + 10)
    found = held(make_run(tmp_path, ten, nine_lost), make_run(tmp_path, ten, clean))
    success = found.findings[0]
    assert 0.01 / 7 < success.p < 0.01 and success.verdict is Verdict.INCONCLUSIVE
    assert found.verdict is Verdict.INCONCLUSIVE and "worse by itself" in found.reason


def test_better_is_no_regression(tmp_path: Path) -> None:
    found = held(make_run(tmp_path, SEEDS, worse("first_seen_m", +0.5)), make_run(tmp_path, SEEDS))
    assert found.verdict is Verdict.PASS


def test_what_is_certain_but_small_is_marginal(tmp_path: Path) -> None:
    found = held(make_run(tmp_path, SEEDS, worse("echo_to_setpoint_ms", 1.0)), make_run(tmp_path, SEEDS))
    assert found.verdict is Verdict.MARGINAL and "less than the 5 ms that matter" in found.reason


def test_too_few_pairs_are_inconclusive_and_say_how_many_more(tmp_path: Path) -> None:
    found = held(make_run(tmp_path, range(1, 8), crashes), make_run(tmp_path, SEEDS))
    assert found.verdict is Verdict.INCONCLUSIVE and "fly 3 more" in found.reason and found.findings == ()
    assert any("13 flights that only one of the runs has" in note for note in found.notes)


def test_a_measure_that_vanished_is_not_a_pass(tmp_path: Path) -> None:
    def blind(result: dict[str, Any], seed: int) -> None:
        result["measures"]["first_seen_m"] = None

    found = held(make_run(tmp_path, SEEDS, blind), make_run(tmp_path, SEEDS))
    assert found.verdict is Verdict.INCONCLUSIVE and "first_seen_m" in found.reason
    both = held(make_run(tmp_path, SEEDS, blind), make_run(tmp_path, SEEDS, blind))
    assert both.verdict is Verdict.PASS, "neither run has it, as in live flights: nothing is missing"
    assert [f.verdict for f in both.findings if f.name == "first_seen_m"] == [None]


def test_flights_that_broke_off_are_an_error(tmp_path: Path) -> None:
    def broke(result: dict[str, Any], seed: int) -> None:
        if seed == 4:
            result.update(outcome="infrastructure", success_strict=False, cause="stack: not finite")

    found = held(make_run(tmp_path, SEEDS, broke), make_run(tmp_path, SEEDS))
    assert found.verdict is Verdict.ERROR and "seed 4" in found.reason
    before = held(make_run(tmp_path, SEEDS), make_run(tmp_path, SEEDS, broke))
    assert before.verdict is Verdict.PASS and before.pairs == 19
    assert any("broke off in the baseline" in note for note in before.notes)


@pytest.mark.parametrize("key", ["scene poles", "shield foam", "sonar pair", "airframes"])
def test_another_world_is_refused(key: str, tmp_path: Path) -> None:
    run, base = make_run(tmp_path, SEEDS), make_run(tmp_path, SEEDS, world={**WORLD, key: "other"})
    for paired in (True, False):
        with pytest.raises(UsageError, match=f"{key} changed since baseline"):
            held(run, base, paired)


def test_other_sources_are_told_and_not_refused(tmp_path: Path) -> None:
    found = held(make_run(tmp_path, SEEDS), make_run(tmp_path, SEEDS, world={**WORLD, "stack sources": "g"}))
    assert found.verdict is Verdict.PASS and "stack sources differ between the runs" in found.notes


def test_what_cannot_be_compared_is_one_clear_error(tmp_path: Path) -> None:
    base = make_run(tmp_path, SEEDS)
    with pytest.raises(UsageError, match="does not say with which scene"):
        held(make_run(tmp_path, SEEDS, world={}), base)
    with pytest.raises(UsageError, match="shield 'none' here, 'foam' in the baseline"):
        held(make_run(tmp_path, SEEDS, shield="none"), base)
    with pytest.raises(UsageError, match="no flight in common"):
        held(make_run(tmp_path, range(50, 70)), base)
    with pytest.raises(UsageError, match="share some"):
        held(make_run(tmp_path, SEEDS), base, paired=False)
    with pytest.raises(UsageError, match="kind 'sweep' cannot be compared"):
        held(make_run(tmp_path, SEEDS, kind="sweep"), base)

    def firmware(result: dict[str, Any], seed: int) -> None:
        result["autopilot"] = {"kind": "embedded", "version": "2"}

    with pytest.raises(UsageError, match="what differs would be the firmware"):
        held(make_run(tmp_path, SEEDS, firmware), base)
    with pytest.raises(UsageError, match="--confidence 2"):
        held(make_run(tmp_path, SEEDS), base, confidence=2.0)


def test_another_stack_or_a_planted_fault_is_told(tmp_path: Path) -> None:
    found = held(make_run(tmp_path, SEEDS, stack="none", faults=Faults(setpoint_delay_ms=100.0)),
                 make_run(tmp_path, SEEDS))
    assert any("stack: none here, saranga in the baseline" in note for note in found.notes)
    assert any("setpoint_delay_ms" in note for note in found.notes)


def test_rows_of_a_campaign_are_pairs_of_their_own(tmp_path: Path) -> None:
    run = make_run(tmp_path, SEEDS, kind="campaign", row="thin")
    assert held(run, make_run(tmp_path, SEEDS, kind="campaign", row="thin")).pairs == 20
    with pytest.raises(UsageError, match="no flight in common"):
        held(run, make_run(tmp_path, SEEDS, kind="campaign", row="fog"))


def test_over_twenty_repetitions_the_unchanged_is_not_flagged_and_the_worsened_is() -> None:
    """Flights that differ by chance alone, paired and not; then the same with 0.25 m less of sight."""
    flagged = {"unchanged, paired": 0, "unchanged, other seeds": 0, "worse, paired": 0, "worse, other seeds": 0}
    for repetition in range(20):
        seeds = range(1000 * repetition, 1000 * repetition + 20)
        base = tuple(result_of(s) for s in seeds)
        again = tuple(result_of(s, "again") for s in seeds)
        worsened = tuple(result_of(s, "worse") for s in seeds)
        for result in worsened:
            result["measures"]["first_seen_m"] -= 0.4
        for name, run in (("unchanged", again), ("worse", worsened)):
            for how, paired in (("paired", True), ("other seeds", False)):
                flagged[f"{name}, {how}"] += compare(Pairs((), run, base), paired).verdict is Verdict.FAIL
    assert flagged["unchanged, paired"] <= 1 and flagged["unchanged, other seeds"] <= 1, flagged
    assert flagged["worse, paired"] >= 18 and flagged["worse, other seeds"] >= 18, flagged


def run_cli(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as caught:
        cli.main(list(arguments))
    said = capsys.readouterr()
    return int(caught.value.code or 0), said.out, said.err


def fly_scripted(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, root: Path, script: str,
                 *more: str) -> tuple[int, str, str]:
    from fake_flights import ScriptedFlights

    flights = ScriptedFlights(script)
    monkeypatch.setattr("bench.fly.find_runner", lambda live: flights)
    return run_cli(capsys, "fly", "poles", "--trials", str(len(flights_of(script))), "--no-record", "--quiet", "--out",
                   str(root), *more)


def flights_of(script: str) -> list[str]:
    return script.split(",")


def test_fly_holds_its_flights_to_a_baseline(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                             tmp_path: Path) -> None:
    clean, bad = ",".join(["clean"] * 20), ",".join(["obstacle_hit"] * 14 + ["clean"] * 6)
    before, after = tmp_path / "before", tmp_path / "after"
    assert fly_scripted(capsys, monkeypatch, before, clean)[0] == 0
    code, out, _ = fly_scripted(capsys, monkeypatch, after, clean, "--baseline", str(before))
    assert code == 0 and "no regression shown over 20 pairs, 20 of them bit for bit the same" in out
    code, out, _ = fly_scripted(capsys, monkeypatch, after, bad, "--baseline", str(before), "--json")
    said = json.loads(out)
    assert code == 1 and said["verdict"] == "FAIL" and said["baseline"]["verdict"] == "FAIL"
    assert (Path(said["run"]) / "comparison.json").is_file()
    suites = ElementTree.parse(Path(said["run"]) / "junit.xml").getroot()
    held_to = suites.find("testsuite[@name='baseline']")
    assert len(suites) == 2 and held_to is not None and int(held_to.get("failures", "0")) >= 2
    assert held_to.find("testcase[@name='success']/failure") is not None
    assert "## poles: FAIL" in (Path(said["run"]) / "summary.md").read_text()
    flown = len(list(after.glob("*-fly-*")))
    code, _, err = fly_scripted(capsys, monkeypatch, after, clean, "--baseline", str(before), "--shield", "none",
                                "--max-sim-s", "9")
    assert code == 2 and "shield 'none' here" in err
    assert len(list(after.glob("*-fly-*"))) == flown, "what can never be compared is refused before it is flown"


def test_compare_from_the_command_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                       tmp_path: Path) -> None:
    base, same = make_run(tmp_path, SEEDS), make_run(tmp_path, SEEDS)
    bad, few = make_run(tmp_path, SEEDS, crashes), make_run(tmp_path, range(1, 4))
    step = tmp_path / "step.md"
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(step))
    code, out, _ = run_cli(capsys, "compare", str(same), str(base))
    assert code == 0 and "would have shown" in out and "PASS" in out
    code, out, _ = run_cli(capsys, "compare", str(bad), base.name, "--out", str(tmp_path), "--json")
    assert code == 1 and json.loads(out)["verdict"] == "FAIL"
    assert json.loads((bad / "comparison.json").read_text())["verdict"] == "FAIL"
    assert step.read_text().count("## Against the baseline") == 2 and "FAIL" in (bad / "summary.md").read_text()
    assert run_cli(capsys, "compare", str(few), str(base))[0] == 3
    again = ElementTree.parse(bad / "junit.xml").getroot()
    assert [s.get("name") for s in again] == ["baseline"], "begun anew where a run has none"
    code, _, err = run_cli(capsys, "compare", str(same), "nope", "--out", str(tmp_path))
    assert code == 2 and "nope" in err
