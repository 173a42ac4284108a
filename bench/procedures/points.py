"""From a sweep's journal to points: noise against thrust, background taken off, with what makes a point unusable."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.journal import FILE_NAME, Records, read_journal
from bench.procedures.background import without_background
from bench.procedures.fits import Points
from bench.procedures.plan import NoisePlan, plan_from_tables
from saranga.errors import UsageError

SPINNING = ("reference", "shielded", "drift")
RUN_BLOCKS = 1000
"""Blocks of the n-th run are numbered from 1000 n, so that several runs can be read as one."""


@dataclass(frozen=True)
class Point:
    """One sensor at one step; rms over 20 000, background taken off.

    `treatment` is that of the background: clear, subtracted, upper_bound; or saturated, where clipping took more than
    1 dB and the truth is at least `rms`.
    """

    run: int
    step: int
    block: int
    condition: str
    shield: str
    phase: str
    sensor: str
    throttle: float
    thrust_n: float
    rms: float
    raw_rms: float
    margin_db: float
    treatment: str
    clipped_share: float
    settled: bool
    mounting: int

    @property
    def usable(self) -> bool:
        """Whether it may enter a curve."""
        return self.treatment in ("clear", "subtracted")


@dataclass(frozen=True)
class SweepRecord:
    """One run as its journal tells it."""

    folder: Path
    plan: NoisePlan
    records: Records
    origin: str
    number: int

    @property
    def steps(self) -> list[dict[str, Any]]:
        """Finished steps; the last record of a step counts."""
        by_number = {int(r["step"]): r for r in self.records.of("step")}
        return [by_number[k] for k in sorted(by_number)]


def read_sweep(folder: Path, number: int = 0) -> SweepRecord:
    """Read a sweep's journal.

    Raises:
        UsageError: no sweep there, or one of another kind.
    """
    records = read_journal(folder / FILE_NAME)
    header = records.header
    if header.get("run_kind") != "sweep":
        raise UsageError(f"{folder}: is a run of kind {header.get('run_kind')!r}, not a noise sweep; "
                         "`saranga-bench runs` lists what there is")
    plan = plan_from_tables(header["plan"], f"{folder}: plan in the journal")
    if not isinstance(plan, NoisePlan):
        raise UsageError(f"{folder}: its plan is of procedure {plan.procedure!r}, not noise")
    devices = records.of("devices")
    origins = {str(d["origin"]) for d in devices} | {str(s["origin"]) for s in records.of("step")}
    return SweepRecord(folder, plan, records, worst_origin(origins), number)


def worst_origin(origins: Iterable[str]) -> str:
    """A number is never better than the worst of what it rests on."""
    order = ("measured", "recorded", "emulated", "simulated")
    known = [o for o in origins if o in order]
    return max(known, key=order.index) if known else "unknown"


def points_of(sweep: SweepRecord) -> list[Point]:
    """Every sensor at every finished step with the motor on, in the order measured."""
    backgrounds: dict[tuple[int, int, str], list[float]] = {}
    for step in sweep.steps:
        if step["phase"] == "background":
            for sensor, noise in step["noise"].items():
                for key in ((step["block"], step["mounting"], sensor), (step["block"], -1, sensor)):
                    backgrounds.setdefault(key, []).append(float(noise["rms"]) ** 2)
    points = []
    for step in sweep.steps:
        if step["phase"] not in SPINNING or step.get("thrust_n") is None:
            continue
        for sensor, noise in step["noise"].items():
            powers = (backgrounds.get((step["block"], step["mounting"], sensor))
                      or backgrounds.get((step["block"], -1, sensor)) or [])
            level = without_background(float(noise["rms"]), (sum(powers) / len(powers)) ** 0.5 if powers else 0.0)
            treatment = "saturated" if noise["lower_bound"] else level.treatment if powers else "no_background"
            points.append(Point(
                sweep.number, int(step["step"]), int(step["block"]) + RUN_BLOCKS * sweep.number, str(step["condition"]),
                str(step["shield"]), str(step["phase"]), sensor, float(step["throttle"]), float(step["thrust_n"]),
                level.rms, float(noise["raw_rms"]), level.margin_db, treatment, float(noise["clipped_share"]),
                bool(step["settled"]), int(step["mounting"])))
    return points


def blocks_of(points: Sequence[Point], condition: str, sensor: str, usable: bool = True) -> dict[int, Points]:
    """Block to curve points of one condition; drift repeats do not enter, nor (unless asked for) unusable points."""
    found: dict[int, list[tuple[float, float]]] = {}
    for p in points:
        if p.condition == condition and p.sensor == sensor and p.phase != "drift" and (p.usable or not usable):
            found.setdefault(p.block, []).append((p.thrust_n, p.rms))
    return {block: Points.of(pairs) for block, pairs in sorted(found.items())}
