"""Gaussian 5x5 blur and Sobel along range: the classical rival of the paper ("Comparison", Fig. 8), made constant
false alarm.

Only the newest row of the result is needed, so blur and Sobel are one separable filter over the last rows: weights
down the rows, then along range. The response is divided by the robust spread of the row's own response, so that the
threshold sets a rate of false alarms whatever the noise level; rising edges that are the highest within a pulse
width are kept, one a reflector, at sub-column position.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.denoise.base import Denoiser
from saranga.denoise.peaks import put_peak
from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M, blank_columns, pulse
from saranga.denoise.sobel_edges import rising_edges
from saranga.echo import EchoImage

NAME = "gaussian"

_BLUR_SIGMA = 1.1
"""What OpenCV takes for a 5x5 kernel: 0.3 ((5 - 1) / 2 - 1) + 0.8."""
_HALF_SCORE = 4.07
"""Spreads of the response at which the edge strength is 0.5; calibrated for 0.02 false edges a frame in noise."""


def _blur_kernel() -> NDArray[np.float64]:
    kernel = np.exp(-(np.arange(-2, 3) ** 2) / (2 * _BLUR_SIGMA**2))
    return kernel / kernel.sum()


def _row_weights() -> NDArray[np.float32]:
    """Weights of the last four rows, oldest first, of blur then Sobel's (1 2 1) with the newest row repeated below."""
    b = _blur_kernel()
    newest = np.array([0.0, b[0], b[1], b[2:].sum()])
    one_before = np.array([b[0], b[1], b[2], b[3:].sum()])
    return (0.75 * newest + 0.25 * one_before).astype(np.float32)


def _range_weights() -> NDArray[np.float32]:
    return np.convolve(_blur_kernel(), [1.0, 0.0, -1.0])[::-1].astype(np.float32)


class GaussianSobel:
    """Callable of the name; see the module."""

    name = NAME
    threshold = 0.5

    def __init__(self, bandwidth_hz: float, ring_down_m: float) -> None:
        shape = pulse(bandwidth_hz)
        self.edge_offset_m = shape.peak_m - shape.sigma_m  # the steepest rise of a Gaussian is one s before its peak
        self._blank = blank_columns(ring_down_m)
        self._apart = max(2, round(2.0 * shape.sigma_columns))
        self._row_weights = _row_weights()
        self._range_weights = _range_weights()

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Edge strengths (N,) of the newest row."""
        envelope = image.envelope
        out = np.zeros(envelope.shape[1], dtype=np.float32)
        for column, z in _rises(envelope, image.rows, self._row_weights, self._range_weights, self._blank, self._apart):
            put_peak(out, column, z / (z + _HALF_SCORE))
        return out


@njit(cache=True)
def _rises(envelope, rows, row_weights, range_weights, blank, apart):  # type: ignore[no-untyped-def]
    """(k, 2): column and height, in robust spreads, of the rising edges of the newest row."""
    m, n = envelope.shape
    nothing = np.empty((0, 2))
    mean = np.zeros(n, dtype=np.float32)
    total = np.float32(0.0)
    depth = row_weights.size
    for k in range(min(depth, rows)):
        row = envelope[m - 1 - k]
        level = np.float32(0.0)
        for c in range(n):
            level += row[c]
        if not (level > 0.0 and level < np.inf):
            continue
        weight = row_weights[depth - 1 - k]
        total += weight
        for c in range(n):
            mean[c] += weight * row[c]
    if total <= 0.0:
        return nothing
    slope = np.zeros(n, dtype=np.float32)
    reach = range_weights.size // 2
    highest = np.float32(0.0)
    for c in range(max(blank, reach), n - reach):
        s = np.float32(0.0)
        for j in range(range_weights.size):
            s += range_weights[j] * mean[c + j - reach]
        slope[c] = s / total
        highest = max(highest, abs(slope[c]))
    first = max(blank, reach)
    if highest <= 0.0 or n - reach - first < 16:
        return nothing
    spread = np.median(np.abs(slope[first:n - reach])) / np.float32(0.6745)
    spread = max(spread, np.float32(1e-2) * highest)
    return rising_edges(slope, spread, first, n - reach, apart)


def build(bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """Gaussian + Sobel for a receiver of this bandwidth, blind up to `ring_down_m`.

    Raises:
        ValueError: an option out of its bounds.
    """
    return GaussianSobel(bandwidth_hz, ring_down_m)
