"""One trial of a campaign, in any worker: everything it leaves comes back as plain data and bytes.

So it is the same on one machine and on a cluster without a shared file system.
"""

import contextlib
import io
import os
import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sitl.trial_types import FlightLog, TrialRequest, TrialResult

TRACK_EVERY = 4
"""Ticks of 62.5 ms between points of the track: 4 Hz."""
DATAFLASH_MOST_BYTES = 32 * 2**20
SCRATCH = "saranga-bench-trial"
SCRATCH_OLD_S = 3600.0


@dataclass(frozen=True)
class Task:
    """One flight of one row. `scene_text`: the scene itself, where a worker elsewhere would not have its file."""

    row: str
    request: TrialRequest
    scene_text: str | None = None

    @property
    def key(self) -> tuple[str, int]:
        """Row and seed: unique in a campaign."""
        return self.row, self.request.seed


@dataclass
class Flown:
    """What a worker sends back; `files` are of failing trials only."""

    result: dict[str, Any]
    scene: dict[str, Any]
    track: list[list[float]]
    traversability: float | None
    files: dict[str, bytes]
    worker: str
    memory_mb: float


def fly_task(task: Task) -> Flown:
    """Fly one trial in this process.

    Raises:
        BenchError: the request itself is wrong; what goes wrong in flight is an outcome.
    """
    from sitl.trial import run_trial

    forget_scratch(None)
    with tempfile.TemporaryDirectory(prefix=f"{SCRATCH}-{os.getpid()}-") as folder:
        request = _with_scene(task, Path(folder))
        result = run_trial(replace(request, workdir=Path(folder), keep_log=True))
        scene, course = _course(request)
        log = result.log
        files = {} if result.success_strict else _evidence(request, result, Path(folder))
    result.files, result.scene = {}, task.request.scene
    return Flown(result.to_dict(), scene, _track(log) if log is not None else [], course, files, worker_name(),
                 _memory_mb())


def _with_scene(task: Task, folder: Path) -> TrialRequest:
    if task.scene_text is None:
        return task.request
    path = folder / "course.toml"
    path.write_text(task.scene_text, encoding="utf-8")
    return replace(task.request, scene=str(path))


def forget_scratch(pid: int | None) -> None:
    """Remove what a worker that was killed left behind: of process `pid`, or old and of any process that is gone."""
    for folder in Path(tempfile.gettempdir()).glob(f"{SCRATCH}-{'*' if pid is None else pid}-*"):
        owner = folder.name.removeprefix(SCRATCH).split("-")[1]
        with contextlib.suppress(OSError):
            if pid is None and (Path("/proc", owner).exists()
                                or time.time() - folder.stat().st_mtime < SCRATCH_OLD_S):
                continue
            shutil.rmtree(folder)


def _course(request: TrialRequest) -> tuple[dict[str, Any], float | None]:
    from sitl.scene import build_scene, load_scene, scene_traversability

    scene = build_scene(load_scene(request.scene), request.seed)
    return scene.to_dict(), round(scene_traversability(scene).mean, 3) if scene.obstacles else None


def _track(log: FlightLog) -> list[list[float]]:
    """[t_s, x, y, z] at 4 Hz and where it ended."""
    at = np.unique(np.append(np.arange(0, len(log.t_us), TRACK_EVERY), len(log.t_us) - 1))
    return [[round(float(log.t_us[k]) / 1e6, 3), *(round(float(v), 3) for v in log.pos_m[k])] for k in at]


def _evidence(request: TrialRequest, result: TrialResult, folder: Path) -> dict[str, bytes]:
    """Echo images, where every echo came from, and the autopilot's own log."""
    from sitl.echo_provenance import provenance_of

    files: dict[str, bytes] = {}
    if result.log is not None:
        path = result.log.save(folder / "log.npz")
        files["log.npz"] = path.read_bytes()
        buffer = io.BytesIO()
        provenance_of(result.log, request).save(buffer)
        files["echoes.npz"] = buffer.getvalue()
    for found in sorted(folder.rglob("*.[Bb][Ii][Nn]"))[:1]:
        if found.stat().st_size <= DATAFLASH_MOST_BYTES:
            files["dataflash.bin"] = found.read_bytes()
    return files


def worker_name() -> str:
    """Machine and process."""
    return f"{os.uname().nodename}-{os.getpid()}"


def _memory_mb() -> float:
    """Resident memory of this worker and its children, such as the autopilot."""
    import psutil

    me = psutil.Process()
    total = me.memory_info().rss
    for child in me.children(recursive=True):
        try:
            total += child.memory_info().rss
        except psutil.Error:
            continue
    return round(total / 2**20, 1)
