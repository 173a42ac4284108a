"""The control process of the kill matrix: a real noise sweep, six steps long, on an emulated device.

`python -m bench.supervisor.control_process STAND_URL RIG_URL|- FOLDER`: begins the sweep in FOLDER, or goes on with it.
"""

import sys
from pathlib import Path
from typing import Any

from bench.interrupt import interruptible
from bench.procedures.bench import Heard
from bench.procedures.hardware_bench import HardwareBench
from bench.procedures.plan import NoisePlan, plan_from_tables
from bench.procedures.schedule import Step, schedule
from bench.procedures.sweep_session import SweepRequest, exit_code_of, run_sweep
from bench.store import Store
from bench.supervisor.plan import Confirmation
from saranga.errors import BenchError

THROTTLE = 0.4
TABLES: dict[str, Any] = {
    "name": "kill matrix", "procedure": "noise", "blocks": 3, "drift_check": False, "mount_s": 0.0,
    "levels": {"throttles": [THROTTLE]}, "rig": {"frames": 20, "rate_hz": 40.0, "samples": 64},
    "settle": {"least_s": 0.2, "most_s": 1.0, "window_s": 0.2, "per_second": 1.0},
    "limits": {"throttle": 0.6, "thrust_n": 20.0, "current_a": 60.0, "slew_per_s": 1.0},
    "conditions": [{"name": "bare"}]}


def tiny_plan() -> NoisePlan:
    """Blocks of motor off, motor on; as many as the verdict asks for, so that it passes when nothing disturbs it."""
    plan = plan_from_tables(TABLES, "kill matrix")
    assert isinstance(plan, NoisePlan)
    return plan


def run_folder(folder: Path) -> Path | None:
    """Of the sweep in `folder`, None before there is one."""
    return next(iter(sorted(folder.glob("*-sweep-*"))), None)


class SayFinished:
    """A line on stdout for each step whose record is on disk."""

    def begin(self, step: Step, left_s: float) -> None: ...

    def heard(self, step: Step, heard: Heard, now_s: float) -> None: ...

    def finish(self, step: Step, record: dict[str, Any]) -> None:
        print(f"step {step.step}", flush=True)


def control(stand_url: str, rig_url: str | None, folder: Path) -> int:
    """Sweep, or the rest of one. Returns the exit code of the sweep command.

    Raises:
        BenchError: as `run_sweep` does.
    """
    plan = tiny_plan()
    with interruptible() as interrupts:
        def make_bench(run: Path, recording: Path) -> HardwareBench:
            return HardwareBench(plan, rig_url or "", stand_url, stand_url, Confirmation.flag(), recording, run,
                                 interrupts.asked, hands=lambda text: None)

        summary, _ = run_sweep(SweepRequest(plan, make_bench, {}, run_folder(folder)), Store(folder), SayFinished(),
                               interrupts)
    print(f"verdict {summary['verdict']} {'; '.join(summary.get('errors', []))}", flush=True)
    return exit_code_of(summary)


def main() -> int:
    """Exit code as of every command of the bench."""
    stand_url, rig_url, folder = sys.argv[1:]
    try:
        return control(stand_url, None if rig_url == "-" else rig_url, Path(folder))
    except BenchError as error:
        print(f"error: {error}", flush=True)
        return error.exit_code


STEPS = len(schedule(tiny_plan()))

if __name__ == "__main__":
    sys.exit(main())
