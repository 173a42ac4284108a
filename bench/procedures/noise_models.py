"""From a sweep to the noise models that flights read: `noise-model-SHIELD.toml` beside the journal."""

import math
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from bench.procedures.analysis import Analysis
from bench.procedures.fits import interpolated_db
from bench.procedures.insertion_loss import Blocks, common_thrusts
from bench.procedures.plan import Condition
from sitl.acoustics.noise_model import NoiseModel, Origin, save_noise_model

Word = Literal["measured", "emulated", "recorded", "simulated"]


def model_of(analysis: Analysis, condition: Condition, origin: str, source: str,
             hub_distance_m: float) -> NoiseModel | None:
    """The model of one condition: mean over blocks in dB at common thrusts; None where there are no two thrusts."""
    if origin not in get_args(Origin):
        return None
    blocks = analysis.curves[condition.name]
    text = f"{condition.shield} on the bench, sensor {analysis.sensor}" + (
        f"; {condition.material}" if condition.material else "")
    loss = analysis.losses.get(condition.name)
    distance = condition.hub_distance_m or hub_distance_m
    if loss is not None and analysis.reference is not None and len(loss.thrust_n) >= 2:
        grid = np.asarray(loss.thrust_n)
        both = {b: blocks[b] for b in loss.per_block}
        open_ = {b: analysis.curves[analysis.reference][b] for b in loss.per_block}
        low = [e.low for e in loss.at]
        high = [e.high for e in loss.at]
        known = all(v is not None for v in [*low, *high])
        return NoiseModel(
            name=condition.name, description=text, origin=cast(Origin, origin), source=source,
            thrust_n=loss.thrust_n, noise_rms=_mean_rms(both, grid), reference_rms=_mean_rms(open_, grid),
            insertion_loss_db=tuple(e.value for e in loss.at),
            interval_low_db=cast(tuple[float, ...], tuple(low)) if known else None,
            interval_high_db=cast(tuple[float, ...], tuple(high)) if known else None, hub_distance_m=distance)
    grid = common_thrusts([blocks])
    if grid.size < 2:
        return None
    return NoiseModel(name=condition.name, description=text, origin=cast(Origin, origin), source=source,
                      thrust_n=tuple(grid.tolist()), noise_rms=_mean_rms(blocks, grid), hub_distance_m=distance)


def write_models(folder: Path, analysis: Analysis, conditions: tuple[Condition, ...], origin: str, source: str,
                 hub_distance_m: float) -> dict[str, Path]:
    """Write every model that the sweep supports; condition to file."""
    written = {}
    for condition in conditions:
        model = model_of(analysis, condition, origin, source, hub_distance_m)
        if model is not None:
            written[condition.name] = save_noise_model(model, folder / f"noise-model-{condition.name}.toml")
    return written


def _mean_rms(blocks: Blocks, grid: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> tuple[float, ...]:
    level = np.mean([interpolated_db(p, grid) for p in blocks.values() if len(p) >= 2], axis=0)
    return tuple(10.0 ** (v / 20.0) for v in level.tolist() if math.isfinite(v))
