"""`saranga-bench runs`, `view`, `report`, and what a person sees on a real terminal."""

import json
import os
import pty
import signal
import subprocess
from pathlib import Path

import pytest
from fake_flights import SCENE, command

import bench.view
from bench.cli import main
from bench.store import Store


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SARANGA_BENCH_RUNS", str(tmp_path / "runs"))
    (tmp_path / "corridor.toml").write_text(SCENE)
    return tmp_path / "runs"


def fly(root: Path, script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(script, "fly", str(root.parent / "corridor.toml"), *arguments),
        capture_output=True,
        text=True,
        timeout=30,
    )


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    try:
        main(list(arguments))
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


def test_runs_lists_newest_first(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "runs")[1].startswith("no runs in")
    fly(root, "clean", "--no-record")
    fly(root, "stuck,clean,stuck", "--trials", "3", "--no-record")
    code, out, _ = run(capsys, "runs")
    lines = out.splitlines()
    assert code == 0
    assert lines[0].split()[:3] == ["ID", "KIND", "WHAT"]
    assert "FAIL" in lines[1]
    assert "2 stuck, 1 clean" in lines[1]
    assert "PASS" in lines[2]
    rows = json.loads(run(capsys, "runs", "--json", "--limit", "1")[1])["runs"]
    assert [(r["verdict"], r["state"]) for r in rows] == [("FAIL", "finished")]
    assert (root / Path(rows[0]["run"]).name / "run.json").is_file()


def test_view_opens_the_run_or_one_flight_of_it(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[tuple[Path, bool]] = []
    monkeypatch.setattr(bench.view, "open_run", lambda path, web=False: opened.append((path, web)) or 0)
    fly(root, "clean,clean", "--trials", "2")
    folder = Store(root).resolve("last")
    assert [
        run(capsys, "view", *more)[0]
        for more in (("last",), (folder.name, "--seed", "2"), (str(folder / "flight-1.rrd"), "--web"))
    ] == [0, 0, 0]
    assert opened == [(folder, False), (folder / "flight-2.rrd", False), (folder / "flight-1.rrd", True)]
    code, _, err = run(capsys, "view", "last", "--seed", "9")
    assert code == 2
    assert "no recording of seed 9: it has flight-1.rrd, flight-2.rrd" in err
    assert run(capsys, "view", "/nowhere/x.rrd")[0] == 2
    assert run(capsys, "view", "zzz")[0] == 2
    assert len(opened) == 3


def test_report_is_made_of_a_run_that_was_killed(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = fly(root, "stuck,kill", "--trials", "2", "--no-record")
    assert done.returncode == -signal.SIGKILL
    code, out, _ = run(capsys, "report", "last")
    assert code == 0
    page = Path(out.strip())
    assert page.parent == Store(root).resolve("last")
    assert "stuck" in page.read_text()
    assert json.loads((page.parent / "summary.json").read_text())["verdict"] == "FAIL"
    assert 'failures="2"' in (page.parent / "junit.xml").read_text()


def test_on_a_terminal_there_is_a_bar_and_ctrl_c_ends_the_flight(root: Path) -> None:
    """Ctrl-C as a person presses it: the terminal sends the signal."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["TERM"] = "xterm-256color"
        os.environ["COLUMNS"] = "120"
        words = command("clean,hang", "fly", str(root.parent / "corridor.toml"), "--trials", "2", "--no-record")
        os.execv(words[0], words)
    seen, pressed = b"", False
    try:
        while True:
            try:
                piece = os.read(terminal, 65536)
            except OSError:
                break
            if not piece:
                break
            seen += piece
            if b"flying" in seen and b"1.0 of 10.0 m" in seen and not pressed:
                pressed = True
                os.write(terminal, b"\x03")
    finally:
        os.close(terminal)
        _, status = os.waitpid(pid, 0)
    text = seen.decode(errors="replace")
    assert os.waitstatus_to_exitcode(status) == 130
    assert "flight 1 of 2, seed 1" in text
    assert "1.0 of 10.0 m" in text
    assert "PASS" in text
    assert "SIGINT: ending the flight" in text
    assert "INCONCLUSIVE" in text
    assert "cut short: 2 of 2 flights are in it" in text
