"""Dask as workers, with flights that need no simulator: every task once, dead workers and lost autopilots survived."""

import os
from pathlib import Path

import fake_campaign
import psutil
import pytest

from bench.campaign.flying import Task
from bench.campaign.workers import DaskWorkers
from saranga.errors import DeviceError
from sitl.trial_types import TrialRequest

pytest.importorskip("distributed", reason="needs the extra: pip install 'saranga-bench[cluster]'")
pytestmark = pytest.mark.timeout(900)  # seconds on an idle machine, minutes on a busy one


def test_a_local_cluster_flies_every_task_and_leaves_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_CAMPAIGN", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setattr("bench.campaign.workers.fly_task", fake_campaign.die_once)
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    tasks = [Task("row", TrialRequest("poles", seed=seed)) for seed in range(6)]
    workers = DaskWorkers("local", 2)
    try:
        assert workers.count == 2
        done = list(workers.run(tasks, lambda: False))
        assert sorted(d.task.request.seed for d in done) == list(range(6))
        assert all(d.flown is not None for d in done), [d.error for d in done]
        hashes = {d.task.request.seed: d.flown.result["determinism_hash"] for d in done if d.flown}
        assert hashes == {seed: f"row{seed}" for seed in range(6)}
        assert (tmp_path / "died-2").exists(), "no worker died"
        assert list(workers.run(tasks, lambda: True)) == [], "cancelled at once"
    finally:
        workers.close()
    left = [p for p in psutil.Process().children(recursive=True)
            if p.pid not in before and p.status() != psutil.STATUS_ZOMBIE]
    assert not left, [p.cmdline() for p in left]


def test_no_scheduler_is_one_clear_error() -> None:
    with pytest.raises(DeviceError, match=r"no scheduler answers.*dask scheduler"):
        DaskWorkers("tcp://127.0.0.1:9", 1, patience_s=1.0)
