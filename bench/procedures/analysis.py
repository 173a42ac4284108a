"""What a sweep says: curves and fits, insertion losses, comparisons, hover point, drift, repeatability."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.procedures.blocks import Estimate, bootstrap_blocks, mean_of_blocks
from bench.procedures.fits import (
    FITS,
    Points,
    fit_power_law,
    interpolated_db,
    joined,
    prediction_error_db,
    residual_db,
)
from bench.procedures.heights import HeightAnswer, optimum_height
from bench.procedures.hover import READINGS_KGF, hover_level, newton
from bench.procedures.insertion_loss import Blocks, Difference, Loss, difference, insertion_loss
from bench.procedures.plan import Condition
from bench.procedures.points import Point, blocks_of


@dataclass(frozen=True)
class Analysis:
    """Results for one sensor.

    Attributes:
        curves: condition to its blocks of usable points.
        losses: condition to insertion loss; None where it could not be had, see `loss_notes`.
        loss_notes: why, or a bound.
        differences: every pair of shielded conditions (of all conditions where there is no reference).
        drift_db: block to what the reference's repeat at the end of the block reads over its first measurement.
    """

    sensor: str
    reference: str | None
    target_kgf: float
    curves: dict[str, dict[int, Points]]
    losses: dict[str, Loss | None]
    loss_notes: dict[str, str]
    differences: list[Difference]
    height: HeightAnswer | None
    drift_db: dict[int, float]


def analyse(points: Sequence[Point], conditions: Sequence[Condition], sensor: str, target_kgf: float) -> Analysis:
    """All results of the points of one sensor; `target_kgf` is the thrust that losses are quoted at."""
    reference = next((c.name for c in conditions if c.reference), None)
    curves = {c.name: blocks_of(points, c.name, sensor) for c in conditions}
    losses: dict[str, Loss | None] = {}
    notes: dict[str, str] = {}
    others = [c.name for c in conditions if not c.reference]
    if reference is not None:
        for name in others:
            losses[name] = insertion_loss(name, curves[reference], curves[name], newton(target_kgf))
            if losses[name] is None:
                notes[name] = _why_no_loss(points, reference, name, sensor)
    differences = []
    for k, one in enumerate(others):
        for other in others[k + 1:]:
            found = difference(one, other, curves[one], curves[other])
            if found is not None:
                differences.append(found)
    heights = {c.height_m: curves[c.name] for c in conditions if c.height_m is not None}
    several = len(heights) >= 2 and len(heights) == sum(c.height_m is not None for c in conditions)
    height = optimum_height({h: b for h, b in heights.items() if h is not None}) if several else None
    return Analysis(sensor, reference, target_kgf, curves, losses, notes, differences, height,
                    drift_of(points, reference, sensor, curves))


def drift_of(points: Sequence[Point], reference: str | None, sensor: str,
             curves: Mapping[str, Blocks]) -> dict[int, float]:
    """Block to the drift of the reference over it, dB at equal thrust."""
    found = {}
    for p in points:
        if p.phase != "drift" or p.sensor != sensor or not p.usable or p.condition != reference:
            continue
        first = curves[reference].get(p.block)
        if first is None or p.rms <= 0.0:
            continue
        at = float(interpolated_db(first, np.array([p.thrust_n]))[0])
        if math.isfinite(at):
            found[p.block] = 20.0 * math.log10(p.rms) - at
    return found


def fits_of(blocks: Blocks) -> dict[str, Any]:
    """The paper's quadratic and the power law: coefficients, residual, error of predicting a block from the others."""
    every = [p for p in blocks.values() if len(p)]
    points = joined(every)
    found: dict[str, Any] = {}
    for kind, make in FITS.items():
        try:
            fit = make(points)
        except ValueError as error:
            found[kind] = {"why": str(error)}
            continue
        found[kind] = {"coefficients": list(fit.coefficients), "residual_db": _finite(residual_db(fit, points)),
                       "prediction_error_db": _finite(prediction_error_db(kind, every))}
    if "coefficients" in found["power_law"]:
        exponent = bootstrap_blocks(every, lambda b: fit_power_law(joined(b)).coefficients[1])
        found["power_law"]["exponent"] = {"value": exponent.value, "interval": exponent.interval}
    errors = {k: f["prediction_error_db"] for k, f in found.items() if f.get("prediction_error_db") is not None}
    found["better"] = min(errors, key=lambda k: errors[k]) if errors else None
    return found


def band_of(kind: str, blocks: Blocks, thrust_n: Sequence[float]) -> list[Estimate]:
    """The fitted curve at thrusts with its interval: each block is fitted by itself, and averaged in dB.

    Empty where some block cannot be fitted.
    """
    every = [p for p in blocks.values() if len(p)]
    try:
        fits = [FITS[kind](p) for p in every]
    except ValueError:
        return []
    out = []
    for thrust in thrust_n:
        values = [float(f(thrust)) for f in fits]
        if not values or min(values) <= 0.0:
            return []
        out.append(mean_of_blocks([20.0 * math.log10(v) for v in values]))
    return out


def hover_of(curves: Mapping[str, Blocks]) -> dict[str, Any]:
    """Noise at hover by both readings of the paper's axis, condition by condition."""
    return {reading: {"thrust_kgf": kgf, "noise_rms": {
        name: {"value": level.rms, "interval": level.interval, "why": level.why}
        for name, level in ((name, hover_level(blocks, kgf)) for name, blocks in curves.items())}}
        for reading, kgf in READINGS_KGF.items()}


def repeatability_db(analysis: Analysis) -> dict[str, float | None]:
    """Standard deviation from mounting to mounting: of the loss where there is one, else of the level."""
    found: dict[str, float | None] = {}
    for name, blocks in analysis.curves.items():
        loss = analysis.losses.get(name)
        if loss is not None:
            found[name] = loss.overall.deviation
            continue
        per_block = _block_levels(blocks)
        found[name] = mean_of_blocks(per_block).deviation if len(per_block) > 1 else None
    return found


def headline(loss: Loss) -> tuple[Estimate, str]:
    """The loss that is quoted: at the thrust asked for where two blocks or more reach it, else over what is common."""
    if loss.at_target is not None and loss.at_target.blocks >= min(2, loss.overall.blocks):
        return loss.at_target, "at the thrust asked for"
    low, high = loss.thrust_n[0], loss.thrust_n[-1]
    return loss.overall, f"mean over {low:.2f} to {high:.2f} N, as the sweep does not reach the thrust asked for"


def _block_levels(blocks: Blocks) -> list[float]:
    good = [p for p in blocks.values() if len(p) >= 2]
    if not good:
        return []
    low, high = max(p.thrust_n[0] for p in good), min(p.thrust_n[-1] for p in good)
    if high <= low:
        return []
    grid = np.geomspace(low, high, 12)
    return [float(np.mean(interpolated_db(p, grid))) for p in good]


def _why_no_loss(points: Sequence[Point], reference: str, name: str, sensor: str) -> str:
    mine = [p for p in points if p.condition == name and p.sensor == sensor and p.phase != "drift"]
    if not mine:
        return "no step of it was finished"
    faint = sum(p.treatment == "upper_bound" for p in mine)
    loud = sum(p.treatment == "saturated" for p in points if p.condition == reference and p.sensor == sensor)
    if faint > len(mine) / 2:
        faint_too = blocks_of(points, name, sensor, usable=False)
        bound = insertion_loss(name, blocks_of(points, reference, sensor), faint_too)
        least = f"; it is at least {bound.overall.value:.1f} dB" if bound is not None else ""
        return f"{faint} of {len(mine)} points are less than 6 dB over the background, so the loss has no value{least}"
    if loud:
        return f"the sensor saturates without the shield ({loud} points): lower the throttle or the gain"
    return "it shares no block and range of thrust with the reference"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
