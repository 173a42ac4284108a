"""A quick look at a network in training: how often its strongest edge is right, on images it never learns from."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.echo import COLUMN_M
from saranga.input_kinds import inputs_of
from saranga.synthesis import Synthesiser, load_recipe

PSNR_DB = (10.0, 5.0, 0.0)
SEED = 777_777
TOLERANCE_M = 0.05
ONE_OBSTACLE: dict[str, Any] = {
    "obstacles.count_weights": [0, 1, 0, 0, 0], "obstacles.range_m": [0.3, 1.5], "obstacles.azimuth_deg": [-50, 50],
    "obstacles.partial_probability": 0, "rows.start_probability": 0,
}


@dataclass(frozen=True)
class CheckSet:
    """`inputs` (K, C, H, W) and the true ranges (K,) of one PSNR."""

    psnr_db: float
    inputs: NDArray[np.float32]
    range_m: NDArray[np.float64]


def check_sets(input_kind: str, count: int = 200) -> list[CheckSet]:
    """Single obstacles of the default synthesis recipe."""
    sets = []
    for psnr_db in PSNR_DB:
        recipe = load_recipe("default").with_values({**ONE_OBSTACLE, "noise.psnr_db": [psnr_db, psnr_db]})
        batch = Synthesiser(recipe, SEED, ("left",)).batch(0, count, iq=True)
        inputs = inputs_of(input_kind, batch.images[:, 0], batch.iq[:, 0] if batch.iq is not None else None)
        sets.append(CheckSet(psnr_db, inputs, batch.truth["path_m"][:, 0, 0] / 2.0))
    return sets


def strongest_edge_rate(edges: NDArray[np.float32], range_m: NDArray[np.float64]) -> float:
    """Share of rows (K, N) whose highest column is within 5 cm of the truth, but for a common offset."""
    error_m = edges.argmax(axis=1) * COLUMN_M - range_m
    near = np.abs(error_m) < 2.0 * TOLERANCE_M
    offset_m = float(np.median(error_m[near])) if near.any() else 0.0
    return float(np.mean(np.abs(error_m - offset_m) < TOLERANCE_M))
