"""Flights with a companion in the loop, in this process, the companion in its own."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from bench.hil.flight import HilSetup, run_hil_trial
from sitl.trial_types import TrialRequest, TrialResult

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LOOPBACK = "127.0.0.1"
EXTERNAL = "companion:external"
SCENE = """
[scene]
name = "empty"
description = "nothing in the way, and short: what counts is the companion's timing"

[arena]
x_m = [0.0, {length_m}]
y_m = [-2.25, 2.25]
height_m = 3.65
netted = true

[course]
start_x_m = 0.8
start_y_m = 0.0
height_m = 1.0
goal_x_m = {goal_m}
speed_m_s = 1.0
timeout_s = 60.0
"""


def empty_scene(folder: Path, goal_m: float = 5.5) -> str:
    path = folder / "empty.toml"
    path.write_text(SCENE.format(length_m=goal_m + 1.5, goal_m=goal_m))
    return str(path)


def fly(folder: Path, command: tuple[str, ...], autopilot: str = "embedded", wait_s: float = 120.0,
        goal_m: float = 5.5, **what: Any) -> tuple[TrialResult, dict[str, Any]]:
    """The result, and the companion's figures; skips where this machine cannot keep wall time."""
    workdir = folder / "work"
    workdir.mkdir()
    request = TrialRequest(empty_scene(folder, goal_m), autopilot=autopilot, stack=EXTERNAL, denoiser=EXTERNAL,
                           workdir=workdir, **what)
    result = run_hil_trial(request, HilSetup((LOOPBACK, 0), (LOOPBACK, 0), command, wait_s))
    if "too busy" in result.cause:
        pytest.skip(result.cause)
    return result, result.link_counters["companion"]


def saranga_run(log: Path, *options: str) -> tuple[str, ...]:
    return (sys.executable, "-m", "saranga", "run", "--echoes", "{echoes}", "--vehicle", "{vehicle}",
            "--denoiser", "gaussian", "--log", str(log), *options)


def plant_delay(monkeypatch: pytest.MonkeyPatch, delay_ms: float) -> None:
    """For `--stack delayed_stack:Delayed` in the companion's process."""
    monkeypatch.setenv("HIL_DELAY_MS", f"{delay_ms:g}")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), str(ROOT), os.environ.get("PYTHONPATH", "")]))


def own_steps_ms(log: Path) -> dict[int, float]:
    """By `time_boot_ms`: how long the companion itself says that a tick took, of ticks with a setpoint."""
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    return {row["t_us"] // 1000: sum(row["timing_ms"].values()) for row in rows if row["sent"]}


def wire_rows(result: TrialResult) -> list[tuple[int, float]]:
    """(stamp, response) of each setpoint of the course."""
    lines = Path(result.files["wire"]).read_text().splitlines()[1:]
    return [(int(stamp), float(response)) for _, stamp, _, response in (line.split(",") for line in lines)]
