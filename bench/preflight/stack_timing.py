"""The stack on this computer, without flying: how long its steps take, and whether its weights are the right ones."""

import datetime
import hashlib
import json
import platform
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.preflight.evidence import StackSide, percentile
from saranga.companion import TICK_S
from saranga.denoise import load_denoiser
from saranga.denoise.model_file import weights_sha256
from saranga.echo import EchoCycle, EchoFrame, load_sonar
from saranga.errors import BenchError
from saranga.fixtures import fixture_path
from saranga.navigate import load_policy
from saranga.stack import Stack

STEPS = 120
CYCLES_A_STEP = (2, 3)
"""39 echo cycles a second and 16 ticks: two or three cycles each."""
NOISE_COUNTS = 300.0
EASY_SHARE = 0.4
MODEL = "saranga"


def time_stack(denoiser: str, policy: str, sonar: str, speed_m_s: float, folder: Path, steps: int = STEPS,
               model: str = MODEL, tries: int = 1) -> StackSide:
    """Run the stack on seeded noise for `steps` ticks, as fast as it goes; one that cannot run is told in `failed`.

    Args:
        tries: how often it is timed anew while other programs hold it up; the best counts. 1 on the computer that
            flies: what is slow there now will be slow in flight.
    """
    expected, found, runs_on, failed = _weights(denoiser, model)
    step_ms: list[float] = []
    if not failed:
        try:
            step_ms = _best(lambda: _steps(denoiser, policy, sonar, speed_m_s, steps), tries)
        except BenchError as error:
            failed = str(error)
    return StackSide(denoiser, policy, step_ms, TICK_S * 1e3, expected, found, runs_on, _cpu(),
                     shutil.disk_usage(_existing(folder)).free, datetime.datetime.now(datetime.UTC).year,
                     time.monotonic(), failed)


def _best(once: Callable[[], list[float]], tries: int) -> list[float]:
    best = once()
    for _ in range(tries - 1):
        if percentile(best, 0.99) <= EASY_SHARE * TICK_S * 1e3:
            break
        best = min(best, once(), key=lambda step_ms: percentile(step_ms, 0.99))
    return best


def _steps(denoiser: str, policy: str, sonar: str, speed_m_s: float, steps: int) -> list[float]:
    geometry = load_sonar(sonar)
    stack = Stack(load_denoiser(denoiser), load_policy(policy, desired_speed_m_s=speed_m_s), geometry)
    stack.warm_up()
    rng = np.random.default_rng(1)
    trigger, out = 0, []
    for tick in range(steps):
        cycles = []
        for _ in range(CYCLES_A_STEP[tick % 2]):
            noise = rng.normal(0.0, NOISE_COUNTS, (geometry.samples, 2)).astype(np.int16)
            t_us = trigger * geometry.cycle_us
            cycles.append(EchoCycle(trigger, t_us, {
                role: EchoFrame(role, k, trigger, trigger, t_us, geometry.fop_hz, geometry.odr, 0, noise)
                for k, role in enumerate(geometry.roles)}))
            trigger += 1
        began = time.perf_counter()
        stack.step(cycles, round(tick * TICK_S * 1e6))
        out.append((time.perf_counter() - began) * 1e3)
    return out


def _weights(denoiser: str, model: str) -> tuple[dict[str, str], dict[str, str], str | None, str]:
    """Expected and found SHA-256 by precision, the precision that is used, and why they cannot be told."""
    try:
        path = fixture_path("models", model, ".json")
        listed = json.loads(path.read_text(encoding="utf-8"))["files"]
        expected = {precision: str(entry["sha256"]) for precision, entry in listed.items()}
        files = {precision: path.parent / str(entry["file"]) for precision, entry in listed.items()}
    except (BenchError, OSError, ValueError, KeyError, TypeError) as error:
        return {}, {}, None, f"weights: {error}"
    found = {precision: _sha256(file) for precision, file in files.items()}
    if ":" in denoiser:  # somebody's own: it has no weights of ours
        return expected, found, None, ""
    try:
        used = weights_sha256(denoiser)
    except BenchError as error:
        return expected, found, None, str(error)
    return expected, found, next((p for p, sha in expected.items() if sha == used), None), ""


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def _existing(folder: Path) -> Path:
    folder = folder.resolve()
    return next(p for p in (folder, *folder.parents) if p.exists())


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
