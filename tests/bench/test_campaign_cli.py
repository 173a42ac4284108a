"""`saranga-bench campaign` as a person types it; the flights are fabricated, everything else is real."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import ClassVar

import fake_campaign
import pytest

from bench import cli
from bench.campaign.flying import Task
from bench.campaign.workers import Done
from bench.journal import read_journal

Answer = Callable[[Task], str]


class InProcess:
    """Workers that answer at once."""

    answer: Answer = staticmethod(lambda task: "clean")
    flown: ClassVar[list[Task]] = []
    stop_after: int | None = None

    def __init__(self, count: int) -> None:
        self.count = count

    def run(self, tasks: Sequence[Task], cancelled: Callable[[], bool]) -> Iterator[Done]:
        for task in tasks:
            if cancelled():
                return
            InProcess.flown.append(task)
            if InProcess.stop_after is not None and len(InProcess.flown) >= InProcess.stop_after:
                import os
                import signal

                InProcess.stop_after = None
                os.kill(os.getpid(), signal.SIGINT)
            yield Done(task, fake_campaign.flown(task, type(self).answer(task)))

    def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def workers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> type[InProcess]:
    monkeypatch.setattr("bench.campaign.workers.LocalWorkers", InProcess)
    monkeypatch.setenv("SARANGA_BENCH_RUNS", str(tmp_path / "runs"))
    monkeypatch.setattr(InProcess, "flown", [])
    monkeypatch.setattr(InProcess, "stop_after", None)
    monkeypatch.setattr(InProcess, "answer", staticmethod(lambda task: "clean"))
    return InProcess


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as caught:
        cli.main(["campaign", *arguments])
    said = capsys.readouterr()
    return int(caught.value.code or 0), said.out, said.err


def test_a_suite_by_name_with_its_table(capsys: pytest.CaptureFixture[str], workers: type[InProcess]) -> None:
    code, out, err = run(capsys, "paper", "--rows", "thin, fog", "--trials", "20", "--denoiser", "tbd", "--seed", "5")
    assert code == 0 and "thin" in out and "20 of 20, 100 %" in out and "PASS" in out
    assert len(workers.flown) == 40 and {t.request.denoiser for t in workers.flown} == {"tbd"}
    assert {t.request.seed for t in workers.flown} == set(range(5, 25))
    assert "40/40" in err


def test_json_is_one_object_and_quiet_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "paper", "--rows", "thin", "--trials", "2", "--json", "--quiet")
    summary = json.loads(out)
    assert code == 3 and summary["verdict"] == "INCONCLUSIVE" and "2/2" not in err
    assert summary["rows"][0]["trials_needed"] == 3


def test_a_failing_row_is_exit_code_one(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(InProcess, "answer", staticmethod(lambda task: "obstacle_hit"))
    code, out, _ = run(capsys, "paper", "--rows", "thin")
    assert code == 1 and "FAIL" in out


def test_ctrl_c_then_resume_flies_only_the_rest(capsys: pytest.CaptureFixture[str], tmp_path: Path,
                                                workers: type[InProcess]) -> None:
    workers.stop_after = 4
    code, out, _ = run(capsys, "paper", "--rows", "thin", "--trials", "10")
    assert code == 130 and "INCONCLUSIVE" in out
    before = len(workers.flown)
    assert 4 <= before < 10
    code, _, _ = run(capsys, "paper", "--resume", "last")
    assert code == 0 and len(workers.flown) == 10
    assert len({t.key for t in workers.flown}) == 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [([], "give one SUITE, or --hardest SCENE"), (["paper", "--hardest", "boxes"], "give one SUITE"),
     (["paper", "--budget", "90"], "--budget belongs to a search"), (["paper", "--stack", "none"], "--stack belongs"),
     (["--hardest", "boxes", "--trials", "9"], "--trials belongs to a suite"),
     (["--hardest", "boxes", "--screen"], "--screen belongs to a suite"),
     (["--hardest", "boxes", "--rule", "soft"], "must be strict or lenient"),
     (["--hardest", "boxes", "--budget", "10"], "60 flights are the least"),
     (["--hardest", "open"], "draws no obstacles"), (["--hardest", "holes"], "holes"),
     (["paper", "--screen", "--autopilot", "embedded"], "--screen flies both"),
     (["paper", "--rows", "thick"], "has no row thick"), (["papers"], "did you mean 'paper'"),
     (["paper", "--resume", "abc"], "no run 'abc'")],
)
def test_bad_input_is_one_line_and_exit_code_two(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str],
                                                 tmp_path: Path) -> None:
    code, _, err = run(capsys, *arguments)
    assert code == 2 and words in err and err.count("\n") == 1
    assert not (tmp_path / "runs").exists() or not list((tmp_path / "runs").glob("*-*"))


@pytest.mark.parametrize("arguments", [["paper", "--autopilot", "arducopter"], ["paper", "--screen"],
                                       ["--hardest", "boxes", "--autopilot", "arducopter"]])
def test_without_the_real_autopilot_nothing_begins(arguments: list[str], capsys: pytest.CaptureFixture[str],
                                                   monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ARDUCOPTER", str(tmp_path / "absent"))
    code, _, err = run(capsys, *arguments)
    assert code == 4 and "binary not found" in err and "saranga-bench sitl install" in err
    assert not (tmp_path / "runs").exists()


def test_screening_from_the_command_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                         tmp_path: Path) -> None:
    binary = tmp_path / "arducopter"
    binary.write_text("#!/bin/sh\n")
    binary.chmod(0o755)
    monkeypatch.setenv("ARDUCOPTER", str(binary))
    code, out, _ = run(capsys, "paper", "--rows", "thin,fog", "--trials", "20", "--screen")
    assert code == 0 and "screening: PASS" in out and "may screen, with an error of at most" in out
    folder = next((tmp_path / "runs").glob("*campaign*"))
    page = (folder / "report.html").read_text()
    assert "Embedded autopilot against the real one" in page
    assert "screening" in (folder / "junit.xml").read_text()
    assert "**screening**: PASS" in (folder / "summary.md").read_text()
    monkeypatch.setattr(InProcess, "answer", staticmethod(
        lambda task: "obstacle_hit" if task.request.autopilot == "arducopter" else "clean"))
    code, out, _ = run(capsys, "paper", "--rows", "thin", "--trials", "20", "--screen")
    assert code == 1 and "must not screen" in out


def hard_at_seed_four(task: Task) -> str:
    """The course that seed 4 draws is flown badly, however it is moved; the rest are flown well."""
    hard = task.row == "seed-4" or task.row.startswith("move-")
    return "obstacle_hit" if hard and task.request.seed % 8 else "clean"


def test_the_search_keeps_a_regression_scene(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                             tmp_path: Path, workers: type[InProcess]) -> None:
    monkeypatch.setattr(InProcess, "answer", staticmethod(hard_at_seed_four))
    kept = tmp_path / "kept.toml"
    code, out, err = run(capsys, "--hardest", "boxes", "--budget", "60", "--denoiser", "tbd", "--keep", str(kept))
    assert code == 0 and "a harder course was found" in out and "fresh seeds" in out
    assert "/60" in err and "min left" in err and len(workers.flown) <= 66
    assert all(t.scene_text is not None for t in workers.flown), "a worker elsewhere has no file of ours"
    from sitl.scene import build_scene, load_scene

    spec = load_scene(str(kept))
    assert spec.generator is None and build_scene(spec, 1).obstacles == build_scene(spec, 2).obstacles
    folder = next((tmp_path / "runs").glob("*hardest*"))
    page = (folder / "report.html").read_text()
    assert "The hardest course of boxes" in page and "https://" not in page
    assert kept.read_text() == (folder / "hardest.toml").read_text() and kept.read_text().startswith("# Hardest course")
    before = (folder / "summary.json").read_text()
    with pytest.raises(SystemExit) as caught:
        cli.main(["report", str(folder)])
    assert not caught.value.code and (folder / "summary.json").read_text() == before


def test_the_search_goes_on_where_it_was(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                         tmp_path: Path, workers: type[InProcess]) -> None:
    monkeypatch.setattr(InProcess, "answer", staticmethod(hard_at_seed_four))
    workers.stop_after = 30
    code, out, _ = run(capsys, "--hardest", "boxes", "--budget", "60", "--denoiser", "tbd")
    assert code == 130 and "did not come to its end" in out
    folder = next((tmp_path / "runs").glob("*hardest*"))
    first = len(read_journal(folder / "journal.jsonl").of("flight"))
    assert 30 <= first < 60
    code, _, _ = run(capsys, "--hardest", "boxes", "--resume", "last")
    assert code == 0
    flights = [(r["course"], r["seed"]) for r in read_journal(folder / "journal.jsonl").of("flight")]
    assert len(flights) == len(set(flights)), "a flight was made twice"
    whole = json.loads((folder / "summary.json").read_text())
    run(capsys, "--hardest", "boxes", "--budget", "60", "--denoiser", "tbd", "--out", str(tmp_path / "other"))
    straight = json.loads((next((tmp_path / "other").glob("*hardest*")) / "summary.json").read_text())
    assert whole["found"] == straight["found"]


def test_a_search_whose_flights_break_off_is_an_error(capsys: pytest.CaptureFixture[str],
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(InProcess, "answer", staticmethod(
        lambda task: "infrastructure" if task.request.seed == 1 else "clean"))
    code, out, err = run(capsys, "--hardest", "boxes", "--budget", "60", "--denoiser", "tbd")
    assert code == 4 and "ERROR" in out and "seed 1" in err
