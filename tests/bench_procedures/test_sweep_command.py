"""The command line: dry run, hash, refusals; and the real chain on emulated hardware, interrupted and resumed."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.journal import read_journal
from saranga.errors import UsageError

PLAN = """
name = "tiny"
blocks = 1
drift_check = false
mount_s = 1.0
[levels]
throttles = [0.3, 0.5]
[rig]
frames = 10
rate_hz = 40.0
[settle]
least_s = 0.3
window_s = 0.3
most_s = 20.0
[limits]
throttle = 0.6
thrust_n = 5.0
slew_per_s = 2.0
[[conditions]]
name = "none"
reference = true
[[conditions]]
name = "foam"
shield = "foam"
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(PLAN)
    return path


def invoke(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    return done.stdout


def refusal(*arguments: str) -> str:
    with pytest.raises(UsageError) as caught:
        CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    return str(caught.value)


def test_a_dry_run_shows_everything_and_starts_nothing(plan: Path, tmp_path: Path) -> None:
    text = invoke("sweep", str(plan), "--dry-run", "--stand", "emulated:", "--out", str(tmp_path / "runs"))
    for part in ("time ", "peak         throttle 0.5", "energy       about", "limits       throttle 0.6", "plan hash"):
        assert part in text
    found = json.loads(invoke("sweep", str(plan), "--dry-run", "--json", "--out", str(tmp_path / "runs")))
    assert found["verdict"] is None
    assert found["plan_hash"] in text
    assert len(found["steps"]) == 6
    assert not (tmp_path / "runs").exists()


def test_a_run_must_match_its_dry_run(plan: Path, tmp_path: Path) -> None:
    seen = json.loads(invoke("sweep", str(plan), "--dry-run", "--json"))["plan_hash"]
    plan.write_text(PLAN.replace("0.5]", "0.55]"))
    assert f"--plan-hash {seen}" in refusal("sweep", str(plan), "--stand", "emulated:", "--plan-hash", seen)
    real = ("sweep", str(plan), "--rig", "tcp://127.0.0.1:9", "--stand", "teensy+tcp://127.0.0.1:9")
    assert "needs --plan-hash" in refusal(*real)


def test_options_that_do_not_go_together_are_refused(plan: Path) -> None:
    assert "no plan" in refusal("sweep")
    assert "no stand" in refusal("sweep", str(plan))
    assert "one emulated device" in refusal("sweep", str(plan), "--rig", "tcp://127.0.0.1:9", "--stand", "emulated:")
    assert "leave tcp" in refusal("sweep", str(plan), "--simulated-time", "--rig", "tcp://127.0.0.1:9")
    assert "procedure 'beam'" in refusal("sweep", "beam-pattern", "--stand", "emulated:")
    assert "no run" in refusal("shields", "last", "--out", "/nonexistent-runs")
    assert "no rig" in refusal("beam")


@pytest.mark.slow  # wall time: on an overloaded machine the supervisor rightly takes the throttle away
@pytest.mark.timeout(600)
def test_the_real_chain_on_emulated_hardware_survives_ctrl_c_and_resumes(plan: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    devices = ["--rig", "emulated:", "--stand", "emulated:", "--out", str(runs)]
    command = [sys.executable, "-m", "bench.cli", "sweep", *devices]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    sweep = subprocess.Popen([*command, str(plan)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                             env=environment)
    try:
        assert sweep.stderr is not None
        for line in sweep.stderr:
            if line.lstrip().startswith("2/6"):
                sweep.send_signal(signal.SIGINT)
                break
        out, err = sweep.communicate(timeout=300)
    finally:
        if sweep.poll() is None:
            sweep.kill()
    assert sweep.returncode == 130, err
    folder = next(runs.glob("*-sweep-*"))
    records = read_journal(folder / "journal.jsonl")
    done = len(records.of("step"))
    assert 2 <= done < 6
    assert records.of("stopped")[-1]["report"]["confirmed"] is True
    assert "--resume" in out
    resumed = subprocess.run([*command, "--resume", str(folder), "--json"], capture_output=True, text=True, timeout=500,
                             env=environment)
    result = json.loads(resumed.stdout)
    assert result["state"] == "finished", resumed.stderr
    assert result["metrics"]["steps"] == 6
    assert result["origin"] == "emulated"
    assert result["verdict"] != "PASS"  # one block
    assert (folder / "echoes-2.mcap").is_file()
    assert (folder / "report.html").is_file()
    truth = [json.loads(line) for line in (folder / "emulated-truth.jsonl").read_text().splitlines()]
    given = next(one for one in truth if one["event"] == "given")["noise"]["insertion_loss_db"]["foam"]
    assert result["insertion_loss_db"]["foam"]["value"] == pytest.approx(given, abs=1.5)
