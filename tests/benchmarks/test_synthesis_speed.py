"""How fast training pairs are drawn on one core: at least 20 000 a second."""

from typing import Any

import numpy as np
import pytest

from saranga.synthesis import Synthesiser, load_recipe

SCENES = 128
LEAST_PAIRS_S = 20_000


def noise_file(folder: Any) -> Any:
    """Two minutes of cycles, as the paper had: 4688 rows of 256 IQ samples."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((4688, 258, 2))
    iq = np.rint(2000 * (x[:, :-2] + x[:, 1:-1] + x[:, 2:])).astype(np.int16)
    np.savez(folder / "noise.npz", iq=iq, fop_hz=53_000.0, odr=6)
    return folder / "noise.npz"


@pytest.mark.parametrize(("recipe", "recorded", "roles"), [
    ("default", True, ("left",)), ("default", False, ("left", "right")), ("paper", True, ("left",))])
def test_pairs(benchmark: Any, tmp_path: Any, recipe: str, recorded: bool, roles: tuple[str, ...]) -> None:
    made = Synthesiser(load_recipe(recipe), 1, roles, [noise_file(tmp_path)] if recorded else [])
    batch = made.batch(0, SCENES // len(roles))
    turn = iter(range(10**9))
    benchmark(lambda: made.fill(SCENES * next(turn), batch.images, batch.labels))
    assert np.isfinite(batch.images).all() and batch.labels.any()
    if benchmark.stats is not None:
        rate = SCENES / benchmark.stats.stats.min
        benchmark.extra_info |= {"pairs a second": round(rate), "median": round(SCENES / benchmark.stats.stats.median)}
        assert rate >= LEAST_PAIRS_S
