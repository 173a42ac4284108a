"""What the rivals of the paper ("Comparison", Fig. 8) share: rows in units of their own noise before the filter, and
Sobel along range, peak picking and the edge row after it."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.denoise.peaks import put_peak

_FLOOR = np.float32(1e-2)
"""The noise is taken for at least this share of a row's highest value (-40 dB)."""
_MEDIAN_OVER_RMS = np.float32(np.sqrt(np.log(2.0)))
"""Of a Rayleigh distributed envelope."""


@njit(cache=True)
def rows_over_noise(envelope, rows, blank):  # type: ignore[no-untyped-def]
    """(K, N - blank) float32: the measured rows, oldest first, each over its own noise RMS.

    Rows before the history, of a lost cycle (all zero) or with NaN or infinity in them are left out; the noise RMS is
    taken from the median, which a few echoes hardly move.
    """
    m, n = envelope.shape
    out = np.empty((m, n - blank), dtype=np.float32)
    count = 0
    for k in range(max(m - rows, 0), m):
        level = np.float32(0.0)
        highest = np.float32(0.0)
        for c in range(n):
            level += envelope[k, c]
            if c >= blank:
                highest = max(highest, envelope[k, c])
        if not (level < np.inf and highest > 0.0):
            continue
        noise = max(np.float32(np.median(envelope[k, blank:])) / _MEDIAN_OVER_RMS, _FLOOR * highest)
        for c in range(blank, n):
            out[count, c - blank] = envelope[k, c] / noise
        count += 1
    return out[:count]


@njit(cache=True)
def newest_slope(image):  # type: ignore[no-untyped-def]
    """(N,) Sobel along range in the newest row of `image` (K, N), the row repeated below; 0 in the end columns.

    Over 4, so that a step of 1 has a slope of 1.
    """
    k, n = image.shape
    newest = image[k - 1]
    before = image[max(k - 2, 0)]
    slope = np.zeros(n, dtype=np.float32)
    for c in range(1, n - 1):
        slope[c] = (np.float32(0.75) * (newest[c + 1] - newest[c - 1])
                    + np.float32(0.25) * (before[c + 1] - before[c - 1]))
    return slope


@njit(cache=True)
def rising_edges(slope, spread, first, stop, apart):  # type: ignore[no-untyped-def]
    """(K, 2): sub-column position and height, in `spread`, of the rises over it within columns `first` to `stop`.

    Of rises within `apart` columns of each other the steepest is kept, of equals the nearest.
    """
    found = np.empty((max(stop - first, 0), 2))
    count = 0
    for c in range(first + 1, stop - 1):
        here = slope[c]
        if here <= spread:
            continue
        top = True
        for j in range(max(first, c - apart), min(stop, c + apart + 1)):
            if slope[j] > here or (slope[j] == here and j < c):
                top = False
                break
        if not top:
            continue
        bend = slope[c - 1] - np.float32(2.0) * here + slope[c + 1]
        shift = np.float32(0.0)
        if bend < 0.0:
            shift = np.float32(0.5) * (slope[c - 1] - slope[c + 1]) / bend
        found[count, 0] = c + min(max(shift, np.float32(-0.5)), np.float32(0.5))
        found[count, 1] = here / spread
        count += 1
    return found[:count]


def edge_row(
    slope: NDArray[np.float32], spread: float, half_score: float, blank: int, apart: int
) -> NDArray[np.float32]:
    """Edge strengths (blank + N,) from the slope (N,) that begins at column `blank`.

    A rise of `half_score` spreads has strength 0.5.
    """
    row = np.zeros(blank + slope.size, dtype=np.float32)
    for column, height in rising_edges(slope, np.float32(spread), 1, slope.size - 1, apart):
        put_peak(row, blank + column, height / (height + half_score))
    return row
