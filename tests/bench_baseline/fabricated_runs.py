"""Runs whose flights never happened: journals with results as a trial would give them."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.journal import FILE_NAME, open_journal
from bench.store import Store
from sitl.trial_types import TrialRequest

WORLD = {"scene poles": "a", "shield foam": "b", "sonar pair": "c", "airframes": "d", "simulator sources": "e",
         "stack sources": "f"}
Change = Callable[[dict[str, Any], int], None]


def nothing(result: dict[str, Any], seed: int) -> None:
    """Leave the flight as it is."""


def result_of(seed: int, salt: str = "") -> dict[str, Any]:
    """A clean flight with figures that follow from the seed."""
    rng = np.random.default_rng([seed, *salt.encode()])
    clean = bool(rng.random() < 0.9)
    return {"seed": seed, "outcome": "clean" if clean else "obstacle_hit", "cause": "so", "success_strict": clean,
            "min_clearance_m": float(rng.uniform(0.1, 0.6)), "duration_s": float(rng.normal(10.4, 0.4)),
            "path_excess": float(rng.normal(1.02, 0.02)), "determinism_hash": hashlib.sha256(
                f"{seed}{salt}".encode()).hexdigest(), "autopilot": {"kind": "embedded", "version": "1"},
            "measures": {"first_seen_m": float(rng.normal(1.4, 0.2)), "dodge_from_m": float(rng.normal(1.2, 0.2)),
                         "echo_to_setpoint_ms": float(rng.normal(41.7, 0.05)), "end_speed_m_s": 0.0}}


def make_run(root: Path, seeds: range, change: Change = nothing, salt: str = "", world: dict[str, str] | None = None,
             kind: str = "fly", row: str | None = None, **request: Any) -> Path:
    """A run folder with one flight a seed."""
    run = Store(root).create(kind, "poles")
    header = {"inputs": WORLD if world is None else world} if world != {} else {}
    with open_journal(run.folder / FILE_NAME, run_kind=kind, run=str(run.folder), **header) as journal:
        for seed in seeds:
            result = result_of(seed, salt)
            change(result, seed)
            record = {"row": row} if row else {}
            journal.append("trial", seed=seed, request=TrialRequest("poles", seed=seed, **request).to_dict(),
                           result=result, **record)
    return run.folder
