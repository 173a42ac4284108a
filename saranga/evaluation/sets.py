"""The common sets: synthetic pairs that are the same for every denoiser, seed and PSNR.

PSNR is 20 log10(peak of the strongest echo in the newest cycle / RMS |IQ| of the noise). Over the RMS of one
quadrature, or of a real-valued record, the same image has 3.01 dB more; the RMS of the amplitudes |IQ| is the RMS |IQ|
itself. The paper says "RMS of the received signal amplitudes" (Fig. 6C) and not which amplitude, nor over how many
cycles its peak is taken: with the peak of the whole image instead of the newest cycle a fading or passing obstacle has
some dB more (`truth["psnr_image_db"]`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from saranga.synthesis import Batch, Recipe, Synthesiser, load_recipe

KINDS = ("constant", "single", "multiple")
"""Sets that are drawn at every PSNR: `fixtures/evaluation/KIND.toml`."""
PSNRS_DB = (15.0, 10.0, 5.0, 0.0, -4.9, -5.0, -10.0)
"""-4.9 dB is the paper's anchor: a 60 mm pole at 1 m in the noise of hovering ("Physical noise reduction")."""
QUADRATURE_DB = 20.0 * float(np.log10(np.sqrt(2.0)))
"""PSNR over the RMS of one quadrature less PSNR over the RMS |IQ|."""
SEED = 20_260
BATCH_SCENES = 32


@dataclass(frozen=True, eq=False)
class PairSet:
    """`count` scenes of one recipe. `psnr_db` is None where the recipe draws it; `roles[0]` is the sensor scored."""

    kind: str
    description: str
    psnr_db: float | None
    recipe: Recipe
    seed: int
    count: int
    roles: tuple[str, ...]

    @property
    def frames(self) -> int:
        """Images in it, of all sensors."""
        return self.count * len(self.roles)

    def batches(self, scenes: int = BATCH_SCENES) -> Iterator[Batch]:
        """The scenes in order, at most `scenes` at once, with complex images."""
        synthesiser = Synthesiser(self.recipe, self.seed, self.roles)
        for first in range(0, self.count, scenes):
            yield synthesiser.batch(first, min(scenes, self.count - first), iq=True)


def pair_set(kind: str, count: int, psnr_db: float | None = None, seed: int = SEED) -> PairSet:
    """A set of `fixtures/evaluation` by name ("constant", "single", "multiple", "mix", "noise", "clutter") or path.

    Sets of one kind and seed differ between PSNRs in nothing but the PSNR.

    Raises:
        UsageError: an unknown name, a malformed file, a PSNR outside -30..60 dB or a count below 1.
    """
    if count < 1:
        raise UsageError(f"{count} images: at least 1 is needed")
    if psnr_db is not None and not -30.0 <= psnr_db <= 60.0:
        raise UsageError(f"PSNR {psnr_db:g} dB is outside -30..60 dB")
    path = fixture_path("evaluation", kind)
    tables = load_toml(path)
    about, values = tables.get("set"), tables.get("values", {})
    if not isinstance(about, dict) or not isinstance(values, dict) or not {"description", "roles"} <= about.keys():
        raise UsageError(f"{path}: [set] with description and roles, and [values], are needed; see "
                         "fixtures/evaluation/single.toml")
    recipe = load_recipe(about.get("recipe", "default")).with_values(
        values if psnr_db is None else values | {"noise.psnr_db": [psnr_db, psnr_db]})
    return PairSet(kind, str(about["description"]), psnr_db, recipe, seed, count, tuple(about["roles"]))


def common_sets(images: int = 200, psnrs_db: Sequence[float] = PSNRS_DB, kinds: Sequence[str] = KINDS,
                seed: int = SEED) -> list[PairSet]:
    """Every kind at every PSNR, `images` scenes each.

    Raises:
        UsageError: see `pair_set`.
    """
    return [pair_set(kind, images, psnr_db, seed) for kind in kinds for psnr_db in psnrs_db]
