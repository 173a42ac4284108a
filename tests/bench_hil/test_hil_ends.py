"""How a companion in the loop can go wrong, and what is said then: never a PASS."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hil_helpers import ROOT, fly

from bench.cli import main
from bench.flight_summary import trial_verdict
from bench.journal import read_journal
from bench.verdict import Verdict
from saranga.errors import DeviceError

# Connects as a companion does, and hangs up soon after.
QUITTER = """
import os, sys, time
from saranga.sources import open_source
from saranga.transport import open_transport
vehicle = open_transport(os.environ["SARANGA_VEHICLE"])
source = open_source(os.environ["SARANGA_ECHOES"])
source.open()
time.sleep(0.5)
print("FAULT had enough", flush=True)
"""


def ended(result) -> str:
    assert result.outcome == "infrastructure" and trial_verdict(result.to_dict()) is Verdict.ERROR
    return result.cause


def test_nobody_comes(tmp_path: Path) -> None:
    result, figures = fly(tmp_path, (), wait_s=0.3)
    assert "START on the echo port and a connection to the MAVLink port did not come within 0.3 s" in ended(result)
    assert figures["setpoints"] == 0 and figures["deadline_miss_share"] is None


def test_a_companion_that_ends_at_once_is_quoted(tmp_path: Path) -> None:
    words = "import sys; print('no good', *sys.argv[1:]); sys.exit(3)"
    result, _ = fly(tmp_path, (sys.executable, "-c", words, "{speed}", "{echoes}"))
    assert "companion ended (exit code 3): no good 1 tcp://127.0.0.1:" in ended(result)


def test_a_companion_that_leaves_in_flight_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    script = tmp_path / "quitter.py"
    script.write_text(QUITTER)
    result, _ = fly(tmp_path, (sys.executable, str(script)))
    assert "companion" in ended(result) and "FAULT had enough" in result.cause


def test_a_port_that_is_taken_is_said_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(DeviceError, match="cannot be listened on"):
        from bench.hil.flight import HilSetup, run_hil_trial
        from sitl.trial_types import TrialRequest

        run_hil_trial(TrialRequest("open"), HilSetup(("127.0.0.1", taken.getsockname()[1]), ("127.0.0.1", 0)))


@pytest.mark.parametrize(("arguments", "said"), [
    (["no-such-scene"], "no-such-scene"), (["open", "--listen", "udp://127.0.0.1:1"], "--listen"),
    (["open", "--listen", "tcp://127.0.0.1:7000", "--mavlink", "tcp://127.0.0.1:7000"], "give two ports"),
    (["open", "--fault", "setpoint_delay_ms=50"], "inside the stack"), (["open", "--wait-s", "nan"], "--wait-s"),
    (["open", "--companion-limits", "poles"], "unknown metric"),
    (["open", "--autopilot", "px4"], "unknown autopilot")])
def test_bad_usage_ends_with_2(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["hil", *arguments, "--out", str(tmp_path), "--json"])
    captured = capsys.readouterr()
    assert ended.value.code == 2 and said in captured.err and json.loads(captured.out)["verdict"] == "ERROR"
    assert not list(tmp_path.glob("*-hil-*"))


def test_ctrl_c_while_waiting_leaves_a_run_that_can_be_read(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "bench.cli", "hil", "open", "--listen", "tcp://127.0.0.1:0", "--mavlink",
               "tcp://127.0.0.1:0", "--json", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
                          env={**os.environ, "PYTHONPATH": str(ROOT)}) as process:
        assert process.stderr is not None
        said = ""
        while "run    python -m saranga run --echoes tcp://127.0.0.1:" not in said:
            line = process.stderr.readline()
            assert line, said
            said += line
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=120)
    assert process.returncode == 130
    summary = json.loads(out)
    assert summary["interrupted"] and summary["verdict"] != "PASS"
    journal = read_journal(Path(summary["run"]) / "journal.jsonl")
    assert journal.of("interrupted") and journal.end is not None
    assert summary["companion"]["flights"][0]["setpoints"] == 0
