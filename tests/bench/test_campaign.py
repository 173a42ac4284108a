"""Campaigns with workers that need no simulator: nothing is lost, nothing passes that should not."""

import json
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_campaign
import pytest

from bench.campaign.runner import Plan, run_campaign, suite_of, tasks_of
from bench.campaign.suite import Suite, load_suite
from bench.campaign.summary import rebuild_campaign
from bench.campaign.workers import LocalWorkers
from bench.campaign_markdown import markdown_summary
from bench.campaign_page import write_campaign_page
from bench.interrupt import Interrupts
from bench.journal import read_journal
from bench.store import Store
from saranga.errors import UsageError

SUITE = """
[suite]
name = "small"
description = "a test with <angles>"
trials = 4
denoiser = "gaussian"

[[row]]
name = "a"
scene = "poles"
paper = { successes = 17, trials = 21 }

[[row]]
name = "b"
scene = "boxes"
stack = "none"

[[comparison]]
name = "a against b"
a = "a"
b = "b"
"""


@pytest.fixture
def suite(tmp_path: Path) -> Suite:
    (tmp_path / "small.toml").write_text(SUITE)
    return load_suite(str(tmp_path / "small.toml"))


def quiet(_: str) -> None:
    pass


def fly(suite: Suite, root: Path, worker: Callable[..., Any], jobs: int = 2, interrupts: Interrupts | None = None,
        resume: Path | None = None, say: Callable[[str], None] = quiet) -> dict[str, Any]:
    plan = Plan(suite, lambda: LocalWorkers(jobs, worker))
    return run_campaign(plan, Store(root / "runs"), interrupts or Interrupts(), say, resume)


def test_the_shipped_suites_are_the_papers_table() -> None:
    paper = load_suite("paper")
    assert len(paper.rows) == 13 and all(row.paper is not None for row in paper.rows)
    rates = {row.name: (row.paper.successes, row.paper.trials) for row in paper.rows if row.paper}
    assert rates["transparent"] == (17, 22) and rates["low-light"] == (20, 20) and rates["3d"] == (16, 22)
    assert paper.request(next(r for r in paper.rows if r.name == "3d"), 1).sonar == "triple"
    batdeck = load_suite("batdeck")
    assert [batdeck.request(row, 1).sonar for row in batdeck.rows] == ["pair", "batdeck"]
    assert {row.scene for row in batdeck.rows} == {"paper-composite"}
    assert len(load_suite("speed").rows) == 3


@pytest.mark.parametrize(
    ("change", "words"),
    [(("scene = \"poles\"", "scene = \"holes\""), "unknown scene 'holes' (row a)"),
     (("stack = \"none\"", "stack = \"nope\"\nsonar = \"ears\""), "sonar 'ears' (row b); stack 'nope' (row b)"),
     (("name = \"b\"\nscene", "name = \"a\"\nscene"), "rows a are given twice"),
     (("b = \"b\"", "b = \"c\""), "names row 'c', which is not there"),
     (("trials = 4", "trials = 0"), "trials"), (("[[row]]", "[[line]]"), "unknown table [line]"),
     (("successes = 17", "successes = 27"), "successes = 27 of trials = 21 cannot be")],
)
def test_a_bad_suite_is_one_clear_error(change: tuple[str, str], words: str, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(SUITE.replace(*change))
    with pytest.raises(UsageError) as caught:
        load_suite(str(tmp_path / "bad.toml"))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_table_from_workers(suite: Suite, tmp_path: Path) -> None:
    said: list[str] = []
    summary = fly(suite, tmp_path, fake_campaign.fly_third_fails, say=said.append)
    assert [(t["row"], t["seed"]) for t in summary["outcomes"]] == [(r, s) for r in "ab" for s in range(1, 5)]
    a = summary["rows"][0]
    assert (a["strict"]["successes"], a["trials"], a["verdict"]) == (3, 4, "INCONCLUSIVE")
    assert a["trials_needed"] == 1 and a["labels"] == {"clean": 3, "late": 1}
    assert summary["comparisons"][0]["p_value"] == 1.0 and summary["comparisons"][0]["verdict"] == "INCONCLUSIVE"
    assert summary["verdict"] == "INCONCLUSIVE" and summary["metrics"]["planned"] == 8
    assert len(said) == 8 and said[-1].startswith("8/8") and "min left" in said[-1]
    folder = Path(summary["run"])
    assert (folder / "failures" / "a-3-log.npz").read_bytes() == b"not a log"
    assert json.loads((folder / "trials" / "b-2.json").read_text())["result"]["seed"] == 2
    assert summary["outcomes"][2]["replay"].endswith("--seed 3")
    assert rebuild_campaign(folder) == json.loads((folder / "summary.json").read_text())


@pytest.mark.parametrize(("worker", "outcome", "verdict"), [("die_once", "clean", "INCONCLUSIVE"),
                                                            ("die_always", "infrastructure", "ERROR"),
                                                            ("raise_at_two", "infrastructure", "ERROR")])
def test_a_dying_worker_costs_only_its_trial(worker: str, outcome: str, verdict: str, suite: Suite, tmp_path: Path,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_CAMPAIGN", str(tmp_path))
    summary = fly(suite.changed(["a"]), tmp_path, getattr(fake_campaign, worker))
    outcomes = {t["seed"]: t["outcome"] for t in summary["outcomes"]}
    assert outcomes == {1: "clean", 2: outcome, 3: "clean", 4: "clean"}
    assert summary["verdict"] == verdict
    if outcome == "infrastructure":
        assert summary["rows"][0]["verdict"] == "ERROR" and summary["rows"][0]["trials"] == 3


def test_an_interrupted_campaign_goes_on_where_it_was(suite: Suite, tmp_path: Path) -> None:
    interrupts = Interrupts()

    def stop_after_three(line: str) -> None:
        if line.startswith("3/"):
            interrupts.signal_name = "SIGINT"

    first = fly(suite, tmp_path, fake_campaign.fly_third_fails, 1, interrupts, say=stop_after_three)
    assert first["interrupted"] and first["verdict"] == "INCONCLUSIVE" and len(first["outcomes"]) == 3
    folder = Path(first["run"])
    said: list[str] = []
    whole = fly(suite_of(folder), tmp_path, fake_campaign.fly_third_fails, 1, resume=folder, say=said.append)
    assert len(said) == 5 and not whole["interrupted"] and len(whole["outcomes"]) == 8
    straight = fly(suite, tmp_path, fake_campaign.fly_third_fails)
    for key in ("rows", "comparisons", "verdict"):
        assert whole[key] == straight[key]
    with pytest.raises(UsageError, match="the suite changed"):
        fly(suite.changed(trials=5), tmp_path, fake_campaign.fly_clean, resume=folder)


def test_a_campaign_killed_at_once_loses_no_finished_trial(suite: Suite, tmp_path: Path) -> None:
    code = f"""
import sys, time
sys.path[:0] = {[str(Path(__file__).parent)]!r}
import fake_campaign
from pathlib import Path
from bench.campaign.runner import Plan, run_campaign
from bench.campaign.suite import load_suite
from bench.campaign.workers import LocalWorkers
from bench.interrupt import Interrupts
from bench.store import Store
def say(line):
    print(line, flush=True)
    if line.startswith("3/"):
        time.sleep(60)
if __name__ == "__main__":
    run_campaign(Plan(load_suite({str(suite.path)!r}), lambda: LocalWorkers(1, fake_campaign.fly_clean)),
                 Store(Path({str(tmp_path / "runs")!r})), Interrupts(), say)
"""
    script = tmp_path / "killed.py"
    script.write_text(code)
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("3/"):
            break
    import psutil

    children = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()
    folder = next((tmp_path / "runs").glob("*campaign*"))
    assert len(read_journal(folder / "journal.jsonl").of("trial")) == 3
    until = time.monotonic() + 5.0
    workers = [c for c in children if "spawn_main" in " ".join(_command(c))]
    while any(w.is_running() and w.status() != "zombie" for w in workers) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(w.is_running() and w.status() != "zombie" for w in workers), "a worker outlived its campaign"
    summary = fly(suite, tmp_path, fake_campaign.fly_clean, resume=folder)
    assert len(summary["outcomes"]) == 8 and len(read_journal(folder / "journal.jsonl").of("trial")) == 8


def _command(process: Any) -> list[str]:
    import psutil

    try:
        return list(process.cmdline())
    except psutil.Error:
        return []


def test_reports_escape_what_flights_say_and_never_show_green_for_red(suite: Suite, tmp_path: Path) -> None:
    summary = fly(suite, tmp_path, fake_campaign.fly_third_fails)
    folder = Path(summary["run"])
    page = write_campaign_page(folder).read_text()
    assert "a test with &lt;angles&gt;" in page and "<angles>" not in page
    assert "not drawn" in page and "http://" not in page.replace("http://www.w3.org", "") and "https://" not in page
    text = markdown_summary(summary)
    assert "INCONCLUSIVE" in text.splitlines()[0] and "`saranga-bench fly poles" in text and "<angles>" not in text
    root = ET.parse(folder / "junit.xml").getroot()
    row = root.find("testsuite[@name='a']")
    assert row is not None and (row.get("tests"), row.get("failures"), row.get("skipped")) == ("5", "1", "1")
    (folder / "trials" / "a-1.json").write_text("{")
    assert "not drawn" in write_campaign_page(folder).read_text()


def test_tasks_take_a_seed_of_every_row_in_turn(suite: Suite) -> None:
    assert [(t.row, t.request.seed) for t in tasks_of(suite)][:4] == [("a", 1), ("b", 1), ("a", 2), ("b", 2)]
