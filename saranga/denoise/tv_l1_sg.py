"""Total variation, then Savitzky-Golay (window 11, order 7) along range, then Sobel: a rival of the paper
("Comparison", Fig. 8; A. Savitzky, M. J. Golay, Anal. Chem. 36, 1627-1639, 1964).

See `tv_l1` for what the paper means by TV-L1.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from saranga.denoise.base import Denoiser
from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M
from saranga.denoise.tv_l1 import TotalVariationSobel, check_data_term

NAME = "tv-l1-sg"

WINDOW = 11
ORDER = 7
_HALF_SLOPE = {"l2": 0.45, "l1": 0.68}
"""Slope, in noise RMS, at which the edge strength is 0.5; calibrated for 0.02 false edges a frame in noise."""


def smoother() -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """`scipy.signal.savgol_filter(rows, 11, 7, axis=1, mode="nearest")`, with its coefficients computed only once."""
    # here, not above: half a second that no other denoiser should wait for
    from scipy.ndimage import correlate1d
    from scipy.signal import savgol_coeffs

    coefficients = savgol_coeffs(WINDOW, ORDER, use="dot")
    return lambda rows: correlate1d(rows, coefficients, axis=1, mode="nearest")


def build(
    bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M, data_term: str = "l2"
) -> Denoiser:
    """Total variation (lambda 1) + Savitzky-Golay + Sobel for a receiver of this bandwidth, blind up to `ring_down_m`.

    Raises:
        ValueError: an option out of its bounds.
    """
    check_data_term(data_term)
    return TotalVariationSobel(NAME, bandwidth_hz, ring_down_m, data_term, _HALF_SLOPE[data_term], smoother())
