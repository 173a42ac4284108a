"""What a worker sends home of one real flight, and what it leaves behind: nothing."""

import io
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from bench.campaign.flying import SCRATCH_OLD_S, Task, fly_task, forget_scratch
from bench.campaign.scene_file import scene_text
from saranga.errors import UsageError
from sitl.scene import build_scene, load_scene
from sitl.trial_types import FlightLog, TrialRequest

FAILS = TrialRequest("poles", seed=1, stack="none", denoiser="gaussian")


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_a_failing_flight_sends_its_evidence_home(scratch: Path, tmp_path: Path) -> None:
    flown = fly_task(Task("row", FAILS))
    assert flown.result["outcome"] == "obstacle_hit" and flown.result["scene"] == "poles"
    assert json.loads(json.dumps(flown.result)) == flown.result and "log" not in flown.result
    (tmp_path / "log.npz").write_bytes(flown.files["log.npz"])
    log = FlightLog.load(tmp_path / "log.npz")
    assert len(log.t_us) > 50 and log.envelope_left.shape[1] > 0, "no echo images in the log"
    with np.load(io.BytesIO(flown.files["echoes.npz"]), allow_pickle=False) as echoes:
        assert echoes.files and all(len(echoes[name]) for name in echoes.files if echoes[name].ndim)
    assert [len(point) for point in flown.track] == [4] * len(flown.track)
    assert flown.track[-1][1:] == [round(float(v), 3) for v in log.pos_m[-1]]
    assert flown.track[-1][0] == round(float(log.t_us[-1]) / 1e6, 3)
    assert flown.scene["obstacles"] and flown.traversability is not None and 10.0 < flown.traversability < 30.0
    assert flown.memory_mb > 50 and str(os.getpid()) in flown.worker
    assert not list(scratch.iterdir()), "a flight left something behind"


def test_a_course_sent_as_text_flies_as_the_one_it_was_drawn_from(scratch: Path) -> None:
    spec = load_scene("poles")
    text = scene_text(build_scene(spec, 1), spec, "kept", "a kept course")
    named = TrialRequest("nowhere/kept.toml", seed=1, stack="none", denoiser="gaussian")
    kept = fly_task(Task("row", named, text))
    assert kept.result["scene"] == "nowhere/kept.toml"
    assert kept.result["determinism_hash"] == fly_task(Task("row", FAILS)).result["determinism_hash"]


def test_a_wrong_request_is_an_error_and_leaves_nothing(scratch: Path) -> None:
    with pytest.raises(UsageError, match="holes"):
        fly_task(Task("row", TrialRequest("holes")))
    assert not list(scratch.iterdir())


def test_what_dead_workers_left_is_swept_and_nothing_else(scratch: Path) -> None:
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    old = time.time() - SCRATCH_OLD_S - 60.0
    for name, age in ((f"saranga-bench-trial-{done.pid}-old", old), (f"saranga-bench-trial-{done.pid}-young", None),
                      (f"saranga-bench-trial-{os.getpid()}-mine", old), (f"another-{done.pid}-old", old)):
        (scratch / name).mkdir()
        if age is not None:
            os.utime(scratch / name, (age, age))
    forget_scratch(None)
    assert sorted(f.name.rpartition("-")[2] for f in scratch.iterdir()) == ["mine", "old", "young"]
    assert not (scratch / f"saranga-bench-trial-{done.pid}-old").exists()
    forget_scratch(done.pid)
    assert sorted(f.name.rpartition("-")[2] for f in scratch.iterdir()) == ["mine", "old"]


AFTER_THE_CAMPAIGN = """
import sys
sys.path[:0] = [{folder!r}]
import fake_campaign, psutil
from bench.campaign.flying import Task
from bench.campaign.workers import LocalWorkers
from sitl.trial_types import TrialRequest
if __name__ == "__main__":
    workers = LocalWorkers(2, fake_campaign.fly_clean)
    tasks = [Task("row", TrialRequest("poles", seed=seed)) for seed in range(4)]
    for _ in range(2):
        assert len(list(workers.run(tasks, lambda: False))) == 4
    during = psutil.Process().children(recursive=True)
    assert sum("spawn_main" in " ".join(p.cmdline()) for p in during) == 2, "the same processes fly again"
    workers.close()
    print(len(during), [p.cmdline() for p in psutil.Process().children(recursive=True)])
"""


def test_workers_leave_no_process_and_no_helper_of_multiprocessing(tmp_path: Path) -> None:
    script = tmp_path / "after.py"
    script.write_text(AFTER_THE_CAMPAIGN.format(folder=str(Path(__file__).parent)))
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["3", "[]"], "two workers and the helper while flying, nobody afterwards"
