"""`saranga-bench rig emulate | check | record | replay` as their users run them: processes, URLs, exit codes, JSON."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rig_process import served

from saranga.recording import read_recording
from saranga.sources import FileSource, open_source
from sitl.process import die_with_parent

pytestmark = [pytest.mark.wall_time, pytest.mark.xdist_group("wall_time")]
ROOT = Path(__file__).resolve().parents[2]
# A cold cache compiles the acoustics first, on a machine that may be busy.
START_S = 200.0

Started = Callable[..., tuple["subprocess.Popen[str]", str]]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "bench.cli", "rig", *arguments]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))}


def run(*arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command(*arguments), capture_output=True, text=True, cwd=cwd, env=environment(),
                          timeout=START_S, check=False, stdin=subprocess.DEVNULL, preexec_fn=die_with_parent)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Started]:
    """Start a command that prints its URL first; it is ended with the test."""
    running: list[subprocess.Popen[str]] = []

    def start_one(*arguments: str) -> tuple["subprocess.Popen[str]", str]:
        process = subprocess.Popen(command(*arguments), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=environment(),
                                   preexec_fn=die_with_parent)
        running.append(process)
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url, process.stderr.read() if process.stderr else ""
        return process, url

    yield start_one
    for process in running:
        process.kill()
        process.communicate()


def cycles_of(path: Path) -> list[Any]:
    source = FileSource(path)
    source.open()
    cycles = []
    while not source.exhausted:
        cycles += source.poll(0.0)
    return cycles


@pytest.mark.timeout(400)
def test_emulate_check_and_orders_over_processes(start, tmp_path):
    truth = tmp_path / "truth.jsonl"
    process, url = start("emulate", "--port", "tcp", "--fault", "noisy-sensor", "--shield", "foam=9.5", "--truth",
                         str(truth))
    assert url.startswith("tcp://127.0.0.1:")
    done = run("check", url, "--json", "--seconds", "4", "--out", "runs", cwd=tmp_path)
    answer = json.loads(done.stdout)
    assert done.returncode == 1 and answer["verdict"] == "FAIL" and any("too loud" in c for c in answer["causes"])
    assert answer["provenance"]["origin"] == "emulated"
    folder = tmp_path / answer["run"]
    assert (folder / "journal.jsonl").is_file() and len(cycles_of(folder / "echoes.mcap")) > 100
    assert process.stdin is not None and process.stderr is not None
    process.stdin.write("shield none\nshield tin\nquit\n")
    process.stdin.flush()
    assert process.wait(20.0) == 0
    said = process.stderr.read()
    assert "done shield none" in said and "refused shield tin" in said
    events = [json.loads(line) for line in truth.read_text().splitlines()]
    given = next(e for e in events if e["event"] == "given")
    assert given["noise"]["insertion_loss_db"]["foam"] == 9.5 and given["faults"] == {"noisy_sensor": "right"}
    assert [e["shield"] for e in events if e["event"] == "mount"] == ["foam", "none"]


def test_record_and_replay_give_the_same_cycles(start, tmp_path):
    with served() as emulated:
        done = run("record", emulated.url, "--out", "echoes.mcap", "--seconds", "1.5", "--mode", "receive", "--odr",
                   "6", "--samples", "340", "--rate", "50", "--json", cwd=tmp_path)
    answer = json.loads(done.stdout)
    assert done.returncode == 0 and answer["verdict"] == "PASS", done.stderr
    assert answer["counters"]["sequence_gaps"] == 0
    recorded = cycles_of(tmp_path / "echoes.mcap")
    assert len(recorded) == answer["cycles"] > 40
    process, url = start("replay", "echoes.mcap", "--speed", "0")
    source = open_source(url)
    hello = source.open()
    assert [s.role for s in hello.sensors] == ["left", "right"]
    played: list[Any] = []
    until = time.monotonic() + 60.0
    while len(played) < len(recorded) and time.monotonic() < until:
        played += source.poll(0.2)
    source.close()
    assert [c.trigger for c in played] == [c.trigger for c in recorded]
    for mine, theirs in zip(played, recorded, strict=True):
        assert all((mine.frames[role].iq == theirs.frames[role].iq).all() for role in ("left", "right"))
    assert process.wait(30.0) == 0


def test_a_recording_survives_a_kill(tmp_path):
    path = tmp_path / "echoes.mcap"
    with served() as emulated:
        process = subprocess.Popen(command("record", emulated.url, "--out", str(path), "--rate", "50"), cwd=tmp_path,
                                   env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                   preexec_fn=die_with_parent)
        until = time.monotonic() + START_S
        while (not path.is_file() or path.stat().st_size < 150_000) and time.monotonic() < until:
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
        process.wait()
    recording = read_recording(path)
    assert sum(1 for _ in recording.frames()) > 60 and not recording.complete
    assert len(cycles_of(path)) > 30


@pytest.mark.parametrize(("arguments", "code", "why"), [
    (("check", "tcp://127.0.0.1:1"), 4, "does anything serve this port"),
    (("check", "serial:///dev/nothing"), 4, "cannot be opened"),
    (("check", "here"), 2, "not understood"),
    (("check", "tcp://127.0.0.1:1", "--seconds", "nan"), 2, "--seconds nan"),
    (("check", "tcp://127.0.0.1:1", "--reflector", "up"), 2, "left, right or none"),
    (("record", "tcp://127.0.0.1:1", "--out", "x.txt"), 2, ".mcap"),
    (("replay", "nothing.mcap"), 2, "does not exist"),
    (("emulate", "--port", "usb"), 2, "pty, tcp or tcp:PORT"),
    (("emulate", "--fault", "swaped"), 2, "known are"),
])
def test_bad_input_is_named_and_has_its_exit_code(arguments, code, why, tmp_path, capsys, monkeypatch):
    from bench.cli import main

    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["rig", *arguments])
    assert ended.value.code == code and why in capsys.readouterr().err
    # A check that never began leaves no run behind.
    assert not [p for p in tmp_path.rglob("*") if p.name == "run.json"]
