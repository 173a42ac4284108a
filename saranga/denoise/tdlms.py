"""Two-dimensional least mean squares filter, 9x9, and Sobel along range: a rival of the paper ("Comparison", Fig. 8).

M. M. Hadhoud, D. W. Thomas, The two-dimensional adaptive LMS (TDLMS) algorithm, IEEE Trans. Circuits Syst. 35,
485-494 (1988), as an adaptive line enhancer: each sample of the envelope is predicted from the 9x9 samples before it,
and the prediction, from which what cannot be foretold is gone, is the output. The image is scanned row by row from
the oldest to the newest; a row's reference is delayed by one sample of range, so the window holds columns n - 9 to
n - 1 of the row itself and of the eight before it.

The step is divided by the power in the window (normalised LMS), because with the fixed step of the original one
strong echo makes the weights diverge.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.denoise.base import Denoiser
from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M, blank_columns, pulse
from saranga.denoise.sobel_edges import edge_row, newest_slope, rows_over_noise
from saranga.echo import EchoImage

NAME = "tdlms"

WINDOW = 9
STEP = 0.003
"""Of 0.001 to 0.1 the one that finds most obstacles at 10 and 5 dB."""
_LAG_S = 0.47
"""How far the prediction trails the steepest rise, in s of the pulse."""
_HALF_SCORE = 3.95
"""Spreads of the response at which the edge strength is 0.5; calibrated for 0.02 false edges a frame in noise."""


class TdlmsSobel:
    """Callable of the name; see the module."""

    name = NAME
    threshold = 0.5

    def __init__(self, bandwidth_hz: float, ring_down_m: float, step: float) -> None:
        shape = pulse(bandwidth_hz)
        self.edge_offset_m = shape.peak_m - (1.0 - _LAG_S) * shape.sigma_m
        self._blank = blank_columns(ring_down_m)
        self._apart = max(2, round(2.0 * shape.sigma_columns))
        self._step = np.float32(step)

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Edge strengths (N,) of the newest row."""
        measured = rows_over_noise(image.envelope, image.rows, self._blank)
        if not len(measured):
            return np.zeros(image.envelope.shape[1], dtype=np.float32)
        measured -= np.median(measured, axis=1, keepdims=True)
        slope = newest_slope(predict(measured, self._step))
        spread = max(float(np.median(np.abs(slope))) / 0.6745, 1e-2 * float(np.abs(slope).max()), 1e-6)
        return edge_row(slope, spread, _HALF_SCORE, self._blank, self._apart)


@njit(cache=True)
def predict(image, step):  # type: ignore[no-untyped-def]
    """(K, N) what the filter makes of `image` (K, N) float32; 0 is assumed outside it, and the weights start at 0."""
    k, n = image.shape
    padded = np.zeros((k + WINDOW - 1, n + WINDOW), dtype=np.float32)
    padded[WINDOW - 1:, WINDOW:] = image
    weights = np.zeros((WINDOW, WINDOW), dtype=np.float32)
    out = np.empty((k, n), dtype=np.float32)
    for i in range(k):
        for j in range(n):
            predicted = np.float32(0.0)
            power = np.float32(1.0)
            for a in range(WINDOW):
                for b in range(WINDOW):
                    x = padded[i + a, j + b]
                    predicted += weights[a, b] * x
                    power += x * x
            out[i, j] = predicted
            gain = step * (image[i, j] - predicted) / power
            for a in range(WINDOW):
                for b in range(WINDOW):
                    weights[a, b] += gain * padded[i + a, j + b]
    return out


def build(
    bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M, step: float = STEP
) -> Denoiser:
    """TDLMS + Sobel for a receiver of this bandwidth, blind up to `ring_down_m`, adapting by `step`.

    Raises:
        ValueError: an option out of its bounds; a step of 2 or more diverges.
    """
    if not 0.0 < step < 2.0:
        raise ValueError(f"step is {step}; give more than 0 and less than 2")
    return TdlmsSobel(bandwidth_hz, ring_down_m, step)
