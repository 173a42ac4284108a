"""Thresholds at which every denoiser raises the same number of false edges, so that hit rates can be compared."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saranga.evaluation.detections import Truth, ranges

FALSE_A_FRAME = 0.01
BEFORE_M, BEHIND_M = 0.05, 0.15
"""Edges from BEFORE_M before to BEHIND_M behind an obstacle are its echo and the tail of it."""
_STEPS = 30


def false_edges(rows: NDArray[np.float32], truth: Truth, threshold: float, offset_m: float) -> int:
    """Edges of (K, N) over the threshold that are not of an obstacle or its tail."""
    total = 0
    for row, obstacles in zip(rows, truth.range_m, strict=True):
        if row.max() <= threshold:
            continue
        gap = ranges(row, threshold, offset_m)[:, None] - obstacles[~np.isnan(obstacles)][None, :]
        total += int((~((gap >= -BEFORE_M) & (gap <= BEHIND_M)).any(axis=1)).sum())
    return total


def equal_rate_threshold(parts: Sequence[tuple[NDArray[np.float32], Truth]], offset_m: float,
                         rate: float = FALSE_A_FRAME) -> float:
    """The lowest threshold with at most `rate` false edges a frame over all parts, each rows (K, N) with their truth.

    It knows no finer than one edge in the frames given: 1 / K a frame.
    """
    allowed = rate * sum(len(rows) for rows, _ in parts)
    low, high = 0.0, 1.0
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if sum(false_edges(rows, truth, middle, offset_m) for rows, truth in parts) <= allowed:
            high = middle
        else:
            low = middle
    return high
