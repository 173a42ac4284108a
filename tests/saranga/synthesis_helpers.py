"""Recipes with everything that is random but what a test looks at taken out."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.synthesis import Batch, Synthesiser, load_recipe

COLUMN_M = 1.66 / 512
C_M_S = 331.3 * np.sqrt(1.0 + 20.0 / 273.15)
FOP_HZ = 53_000.0
SIGMA_S = np.sqrt(np.log(2.0)) / (np.pi * 3980.0)
PEAK_COLUMNS = 2.5 * SIGMA_S * C_M_S / (2 * COLUMN_M)
SIGMA_COLUMNS = SIGMA_S * C_M_S / (2 * COLUMN_M)
POLE = [{"name": "pole", "taps": [[0.0, 0.0, 0.0]]}]

PLAIN: dict[str, Any] = {
    "obstacles.count_weights": [0, 1, 0, 0, 0], "obstacles.fading_db": [0, 0], "obstacles.partial_probability": 0,
    "obstacles.elevation_deg": [0, 0], "obstacles.range_m": [0.3, 1.5],
    "motion.jitter_m": [0, 0], "motion.doppler": False, "noise.psnr_db": [60, 60], "noise.speckle_probability": 0,
    "noise.drift_db": [0, 0], "noise.level_counts": [100, 100], "rows.lost_probability": 0, "rows.start_probability": 0,
    "ring_down.probability": 0, "image.saturation": False, "air.directivity": False, "air.absorption_db_m": [1.5, 1.5],
    "echo.bandwidth_hz": [3980, 3980], "echo.bands": 1, "echo.responses": POLE, "label.least_snr_db": -200,
}


def only(kind: str) -> dict[str, float]:
    return {f"kinds.{k}": float(k == kind) for k in ("plane", "cylinder", "edge", "point", "ideal")}


def path(kind: str) -> dict[str, float]:
    return {f"paths.{k}": float(k == kind) for k in ("hover", "straight", "arc", "cosine")}


def synthesiser(values: dict[str, Any] | None = None, seed: int = 1, roles: tuple[str, ...] | None = None,
                plain: bool = True, recipe: str = "default") -> Synthesiser:
    return Synthesiser(load_recipe(recipe).with_values((PLAIN if plain else {}) | (values or {})), seed, roles)


def draw(values: dict[str, Any] | None = None, count: int = 200, seed: int = 1,
         roles: tuple[str, ...] | None = None, plain: bool = True, recipe: str = "default") -> Batch:
    return synthesiser(values, seed, roles, plain, recipe).batch(0, count, iq=True)


@lru_cache(maxsize=1)
def default_batch() -> Batch:
    """500 scenes of the recipe as it ships."""
    return draw({}, 500, plain=False)


def pulse_at(columns: Any) -> Any:
    """The model pulse so many columns after its leading edge."""
    return np.exp(-0.5 * ((columns - PEAK_COLUMNS) / SIGMA_COLUMNS) ** 2)


def fit_row(row: NDArray[np.complex64], delay_columns: float) -> complex:
    """Complex amplitude of the model pulse at `delay_columns` that fits `row` best."""
    shape = pulse_at(np.arange(512) - delay_columns)
    return complex(np.vdot(shape, row) / np.vdot(shape, shape))
