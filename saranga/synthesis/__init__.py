"""Training pairs: echo images with known leading edges (paper eqs 2-9, with the errata), on complex baseband.

    recipe = load_recipe("default")
    batch = Synthesiser(recipe, seed=1, roles=("left",)).batch(first=0, count=64)

Sensors of one scene hear the same obstacles from their own places. Range column k is `k * COLUMN_M` of half the path;
an echo of delay tau has the phase exp(-2j pi fop tau) and its leading edge at tau.
"""

from saranga.synthesis.noise_bank import NoiseBank, modelled_bank, recorded_bank
from saranga.synthesis.paths import KINDS, PATHS
from saranga.synthesis.recipe import Recipe, load_recipe, parse_recipe
from saranga.synthesis.synthesiser import Batch, Synthesiser, truth_dtype

__all__ = ["KINDS", "PATHS", "Batch", "NoiseBank", "Recipe", "Synthesiser", "load_recipe", "modelled_bank",
           "parse_recipe", "recorded_bank", "truth_dtype"]
