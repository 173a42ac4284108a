"""What the network sees: an echo image in units of its own noise, compressed to a few units of range."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

FIRST_COLUMN = 24
"""Nearer columns hold the transmitter's ringing and say nothing about the noise."""
MEDIAN_OF_RMS = 0.8326
"""Median of a Rayleigh envelope over its RMS: sqrt(ln 2)."""


def normalised(envelope: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Write log1p(envelope / s) into `out`; s is the noise RMS, from the median over rows of the rows' medians.

    Args:
        envelope: (M, N) float32. A row that is all zero or not finite is no measurement.
        out: (M, N) float32; such rows become 0, and all of it when there is no other row.
    """
    _normalised(envelope, out, FIRST_COLUMN, MEDIAN_OF_RMS)


@njit(nogil=True, cache=True)
def _normalised(envelope, out, first, median_of_rms):  # type: ignore[no-untyped-def]
    m, n = envelope.shape
    medians = np.empty(m)
    usable = np.zeros(m, dtype=np.bool_)
    count = 0
    for r in range(m):
        total = np.float32(0.0)
        for c in range(n):
            total += envelope[r, c]
        if not (total > 0.0 and total < np.inf):
            continue
        usable[r] = True
        median = np.median(envelope[r, first:n:4])
        if median > 0.0:
            medians[count] = median
            count += 1
    if count == 0:
        out[:] = 0.0
        return
    gain = np.float32(median_of_rms / np.median(medians[:count]))
    for r in range(m):
        if usable[r]:
            for c in range(n):
                out[r, c] = np.log1p(envelope[r, c] * gain)
        else:
            out[r] = 0.0
