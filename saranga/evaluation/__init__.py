"""Denoisers compared on one common set of images (paper, "Comparison", Fig. 8, mended) and on recordings.

    for pairs in common_sets(images=200):
        print(pairs.kind, pairs.psnr_db, score(load_denoiser("tbd"), pairs).hit_rate)

What the measures mean is in `measures`, how PSNR is counted in `sets`. Plain arrays throughout: whoever runs a network
in batches gives its edge rows to `score_rows`.
"""

from saranga.evaluation.answering import Answers, Nothing, answers
from saranga.evaluation.calibration import equal_rate_threshold
from saranga.evaluation.measures import SetScore, score, score_rows
from saranga.evaluation.sets import KINDS, PSNRS_DB, PairSet, common_sets, pair_set

__all__ = ["KINDS", "PSNRS_DB", "Answers", "Nothing", "PairSet", "SetScore", "answers", "common_sets",
           "equal_rate_threshold", "pair_set", "score", "score_rows"]
