"""Whole flights against the clock: simulated seconds a wall second, and where the wall seconds go.

The same course (`poles`, seed 1) on each autopilot with each classical denoiser, on one process as `saranga-bench
fly` runs it. Kernels are compiled by a first, unmeasured flight. The times are reported, never asserted.
"""

from collections.abc import Iterator
from typing import Any

import pytest

from bench.spare import stack_threads
from sitl.trial import run_trial
from sitl.trial_types import TrialRequest, TrialResult

ROUNDS = 2
PARTS = ("autopilot", "physics", "echoes", "judge", "ground", "wire", "image", "denoise", "localise", "navigate")
KINDS = ["embedded", pytest.param("arducopter", marks=pytest.mark.real_arducopter)]


@pytest.fixture(scope="module")
def fastest(tables: list[str]) -> Iterator[dict[str, TrialResult]]:
    """Fastest flight of each kind; tabled when all have flown."""
    rows: dict[str, TrialResult] = {}
    yield rows
    tables.append("\n".join(table_lines(rows)))


@pytest.mark.benchmark(group="flight")
@pytest.mark.parametrize("denoiser", ["gaussian", "tbd", "saranga"])
@pytest.mark.parametrize("autopilot", KINDS)
def test_realtime_factor(benchmark: Any, fastest: dict[str, TrialResult], autopilot: str, denoiser: str) -> None:
    request = TrialRequest("poles", seed=1, autopilot=autopilot, denoiser=denoiser, stack_threads=stack_threads())
    flown: list[TrialResult] = []
    benchmark.pedantic(lambda: flown.append(run_trial(request)), rounds=ROUNDS, warmup_rounds=1)
    assert len({result.determinism_hash for result in flown}) == 1, "the rounds are not the same flight"
    best = max(flown[-ROUNDS:], key=lambda result: result.realtime_factor)
    assert best.outcome not in ("infrastructure", "estimator_failure"), best.cause
    assert best.autopilot["kind"] == autopilot
    assert sum(best.timing.values()) <= best.wall_s
    benchmark.extra_info |= {
        "real-time factor": round(best.realtime_factor, 1),
        "simulated s": best.sim_s,
        "outcome": best.outcome,
    } | {f"{part} s": round(seconds, 3) for part, seconds in best.timing.items()}
    fastest[f"{autopilot} + {denoiser}"] = best


def table_lines(rows: dict[str, TrialResult]) -> list[str]:
    """Per flight: real-time factor, seconds, and milliseconds of wall time by part for each simulated second."""
    parts = [part for part in PARTS if any(part in result.timing for result in rows.values())]
    parts += sorted({part for result in rows.values() for part in result.timing} - set(parts))
    lines = [
        "Whole flights, poles seed 1; the parts in ms of wall time a simulated second:",
        f"{'flight':<22}{'factor':>8}{'sim s':>7}{'start s':>9}" + "".join(f"{part:>10}" for part in parts),
    ]
    for name, result in rows.items():
        start_s = result.wall_s - sum(result.timing.values())
        spent = "".join(f"{result.timing.get(part, 0.0) / result.sim_s * 1e3:10.1f}" for part in parts)
        lines.append(f"{name:<22}{result.realtime_factor:>7.1f}x{result.sim_s:>7.1f}{start_s:>9.2f}{spent}")
    return lines
