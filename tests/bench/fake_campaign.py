"""Workers' functions that need no simulator; importable by spawned processes."""

import os
import signal
from pathlib import Path
from typing import Any

from bench.campaign.flying import Flown, Task


def result(task: Task, outcome: str = "clean") -> dict[str, Any]:
    clean = outcome == "clean"
    return {"scene": task.request.scene, "seed": task.request.seed, "outcome": outcome, "cause": f"<{outcome}> & so",
            "label": "clean" if clean else "late", "label_reason": "seen at 0.3 m", "success_strict": clean,
            "success_lenient": outcome in ("clean", "net_hit"), "min_clearance_m": 0.2, "duration_s": 10.0,
            "path_length_m": 9.0, "path_excess": 1.05, "realtime_factor": 8.0, "wall_s": 2.0, "sim_s": 16.0,
            "determinism_hash": f"{task.row}{task.request.seed}", "autopilot": {"kind": "embedded", "version": "1"}}


def flown(task: Task, outcome: str = "clean") -> Flown:
    files = {} if outcome == "clean" else {"log.npz": b"not a log"}
    return Flown(result(task, outcome), {}, [[0.0, 1.0, 0.0, -1.0]], 15.0, files, f"worker-{os.getpid()}", 100.0)


def fly_clean(task: Task) -> Flown:
    return flown(task)


def fly_third_fails(task: Task) -> Flown:
    return flown(task, "obstacle_hit" if task.request.seed % 3 == 0 else "clean")


def die_once(task: Task) -> Flown:
    """Seed 2 kills its worker the first time."""
    mark = Path(os.environ["FAKE_CAMPAIGN"]) / f"died-{task.request.seed}"
    if task.request.seed == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return flown(task)


def die_always(task: Task) -> Flown:
    if task.request.seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return flown(task)


def raise_at_two(task: Task) -> Flown:
    if task.request.seed == 2:
        raise ValueError("a broken trial")
    return flown(task)
