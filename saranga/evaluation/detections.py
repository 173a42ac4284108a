"""Edges held against the truth, image by image."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.localise import edges
from saranga.resample import COLUMN_M

HIT_M = 0.05
"""An edge within this of an obstacle's range is a hit; one farther than this from every obstacle is a false alarm."""
MATCH_COLUMNS = 2.0
"""Of F1: the measure of the project's first networks (perception.md)."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Of one sensor: `range_m` (K, 4), NaN where there is no obstacle; `sought` (K, 4), the echo is strong enough to be
    asked for. An edge at an obstacle that is not sought is neither hit nor false."""

    range_m: NDArray[np.float64]
    sought: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Detections:
    """`error_m` (K, 4): of the edge nearest to each sought obstacle where it is a hit, else NaN; `false` (K,): false
    edges; `strongest` (K,): the strongest edge of the row, over the threshold or not, is at a sought obstacle."""

    error_m: NDArray[np.float64]
    false: NDArray[np.int64]
    strongest: NDArray[np.bool_]


def truth_of(truth: NDArray[Any], least_snr_db: float, sensor: int = 0) -> Truth:
    """From `Batch.truth`; obstacles whose echo is under `least_snr_db` in the newest cycle are not sought."""
    there = truth["kind"] >= 0
    range_m = np.where(there, truth["path_m"][:, sensor].astype(np.float64) / 2.0, np.nan)
    snr_db = truth["snr_db"][:, sensor]
    return Truth(range_m, there & (snr_db > -99.0) & (snr_db >= least_snr_db))


def ranges(row: NDArray[np.float32], threshold: float, offset_m: float) -> NDArray[np.float64]:
    """Ranges of the edges over the threshold, as the stack takes them."""
    return edges(row, threshold, offset_m=offset_m)[0] / 2.0


def strongest_range(row: NDArray[np.float32], offset_m: float) -> float:
    """Range of the strongest edge, NaN in an empty row."""
    peak = float(row.max())
    if peak <= 0.0:
        return float("nan")
    paths, strengths = edges(row, 0.5 * peak, offset_m=offset_m)
    return float(paths[int(np.argmax(strengths))]) / 2.0 if paths.size else float("nan")


def detect(rows: NDArray[np.float32], truth: Truth, threshold: float, offset_m: float) -> Detections:
    """Hits within HIT_M and false alarms of edge rows (K, N)."""
    error = np.full(truth.range_m.shape, np.nan)
    false = np.zeros(len(rows), dtype=np.int64)
    strongest = np.zeros(len(rows), dtype=np.bool_)
    for k, row in enumerate(rows):
        found = ranges(row, threshold, offset_m)
        gap = found[:, None] - truth.range_m[k][None, :]
        near = np.abs(np.where(np.isnan(gap), np.inf, gap))
        false[k] = int((near.min(axis=1) > HIT_M).sum()) if found.size else 0
        if found.size:
            best = np.argmin(near, axis=0)
            each = np.arange(gap.shape[1])
            hit = (near[best, each] <= HIT_M) & truth.sought[k]
            error[k, hit] = gap[best, each][hit]
        top = strongest_range(row, offset_m)
        strongest[k] = bool((np.abs(top - truth.range_m[k][truth.sought[k]]) <= HIT_M).any())
    return Detections(error, false, strongest)


def matched(rows: NDArray[np.float32], truth: Truth, threshold: float, offset_m: float,
            reach_m: float = MATCH_COLUMNS * COLUMN_M) -> NDArray[np.int64]:
    """(K, 3): true positives, false positives and false negatives, edges and obstacles paired one to one.

    The nearest pairs first; an edge within reach of an obstacle that is not sought does not count.
    """
    counts = np.zeros((len(rows), 3), dtype=np.int64)
    for k, row in enumerate(rows):
        found = ranges(row, threshold, offset_m)
        wanted = truth.range_m[k][truth.sought[k]]
        other = truth.range_m[k][~truth.sought[k] & ~np.isnan(truth.range_m[k])]
        gap = np.abs(found[:, None] - wanted[None, :])
        left = np.ones(found.size, dtype=np.bool_)
        pairs = 0
        while gap.size and gap.min() <= reach_m:
            i, j = np.unravel_index(int(np.argmin(gap)), gap.shape)
            gap[i, :] = gap[:, j] = np.inf
            left[i] = False
            pairs += 1
        unpaired = found[left]
        unsought = (np.abs(unpaired[:, None] - other[None, :]) <= reach_m).any(axis=1)
        counts[k] = pairs, unpaired.size - int(unsought.sum()), wanted.size - pairs
    return counts


def f1(counts: NDArray[np.int64]) -> float:
    """2 TP / (2 TP + FP + FN) of summed counts (K, 3); NaN where there was nothing to find and nothing was found."""
    tp, fp, fn = counts.sum(axis=0)
    return float(2 * tp / (2 * tp + fp + fn)) if tp + fp + fn else float("nan")
