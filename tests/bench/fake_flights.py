"""Flights that cost nothing: `run_trial` by script, and the command line over it as a process of its own.

As a program: `python fake_flights.py SCRIPT saranga-bench-arguments...`, SCRIPT being "outcome,outcome,...", one
a trial, with "hang" for a flight that only ends when asked, "deaf" for one that ignores being asked, "kill" for
SIGKILL.
"""

import hashlib
import os
import signal
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from saranga.errors import DeviceError, UsageError
from sitl.trial_types import FlightLog, TrialProgress, TrialRequest, TrialResult

SCENE = """
[scene]
name = "corridor"
description = "for tests of the harness"
"""


def make_log(ticks: int = 3) -> FlightLog:
    """A short log with something in every column."""
    pixels = np.arange(ticks * 8, dtype=np.uint8).reshape(ticks, 8)
    return FlightLog(
        t_us=np.arange(ticks, dtype=np.int64) * 62_500,
        pos_m=np.linspace(0, 1, ticks * 3).reshape(ticks, 3),
        vel_m_s=np.ones((ticks, 3)),
        quat=np.tile([1.0, 0, 0, 0], (ticks, 1)),
        thrust_n=np.full((ticks, 4), 1.1),
        phase=["course"] * ticks,
        command=np.zeros((ticks, 4)),
        envelope_left=pixels,
        envelope_right=pixels + 1,
        edges_left=pixels + 2,
        edges_right=pixels + 3,
        obstacles=[[] for _ in range(ticks)],
        scene={"name": "corridor"},
        events=[(0, "armed"), (125_000, "landed")],
    )


def make_result(request: TrialRequest, outcome: str = "clean", log: FlightLog | None = None) -> TrialResult:
    """A result as the trial would give it for that outcome."""
    digest = hashlib.sha256(f"{request.scene} {request.seed} {outcome}".encode()).hexdigest()
    return TrialResult(
        scene=request.scene,
        seed=request.seed,
        outcome=outcome,
        cause="" if outcome == "clean" else f"because of {outcome}",
        part=None,
        success_strict=outcome == "clean",
        success_lenient=outcome in ("clean", "net_hit"),
        min_clearance_m=0.4,
        duration_s=11.0,
        sim_s=40.0,
        wall_s=2.0,
        realtime_factor=20.0,
        determinism_hash=digest,
        landed=outcome == "clean",
        autopilot={"kind": request.autopilot, "version": "0.1"},
        denoiser=request.denoiser,
        stack=request.stack,
        shield=request.shield,
        log=log,
    )


class ScriptedFlights:
    """A `run_trial` that ends its flights as told, one word each; `requests` are those it was asked for."""

    def __init__(self, script: str) -> None:
        self._words: Iterator[str] = iter(script.split(","))
        self.requests: list[TrialRequest] = []

    def __call__(
        self,
        request: TrialRequest,
        progress: Callable[[TrialProgress], None] | None = None,
        cancel: Callable[[], bool] | None = None,
    ) -> TrialResult:
        self.requests.append(request)
        word = next(self._words)
        if progress is not None:
            for phase in ("start", "takeoff", "course"):
                progress(TrialProgress(1.0, phase, 1.0, 10.0, 20.0))
        if word in ("hang", "deaf"):
            print("flying", file=sys.stderr, flush=True)
            give_up = time.monotonic() + 30
            while time.monotonic() < give_up:
                if word == "hang" and cancel is not None and cancel():
                    return make_result(request, "interrupted")
                time.sleep(0.01)
        if word == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if word == "usage":
            raise UsageError("unknown denoiser 'x': known are tbd")
        if word == "device":
            raise DeviceError("ArduCopter SITL binary not found: run `saranga-bench sitl install`")
        if word == "crash":
            raise ZeroDivisionError("a bug")
        print("a library that prints to stdout")
        return make_result(request, word, make_log() if request.keep_log else None)


def install(script: str) -> ScriptedFlights:
    """Put scripted flights in place of the simulator, in this process, for good."""
    import bench.fly

    drawing = types.ModuleType("bench.rerun_log")  # the real one is tested elsewhere, and costs seconds to import
    drawing.record_flight = _draw  # type: ignore[attr-defined]
    sys.modules["bench.rerun_log"] = drawing
    flights = ScriptedFlights(script)
    bench.fly.find_runner = lambda live: flights  # type: ignore[assignment]
    return flights


def _draw(log: FlightLog, result: TrialResult, path: Path) -> Path:
    path.write_text(f"{len(log.t_us)} ticks")
    return path


def command(script: str, *arguments: str) -> list[str]:
    """The command line that flies the script in a process of its own."""
    return [sys.executable, str(Path(__file__)), script, *arguments]


if __name__ == "__main__":
    install(sys.argv[1])
    from bench.cli import main

    main(sys.argv[2:])
