"""The pulse that every echo is made of: baseband, as the receiver's band leaves it.

p(t) = exp(-(t - t_peak)^2 / (2 s^2)). Its amplitude spectrum is exp(-2 pi^2 f^2 s^2); s puts -3 dB at +-B/2, B being
the sensor's measured bandwidth (3.98 kHz, paper "Doppler"). t_peak = 2.5 s, so that p(0) = 0.044: an echo that
arrives after tau begins at about tau, as a real one does.
"""

import math

import numpy as np
from numpy.typing import NDArray

PEAK_DELAY_SIGMAS = 2.5
"""Peak of the envelope behind its beginning, in units of s."""


def pulse_sigma_s(bandwidth_hz: float) -> float:
    """s of the envelope, seconds: sqrt(ln 2) / (pi B), 66.6 us at 3.98 kHz."""
    return math.sqrt(math.log(2.0)) / (math.pi * bandwidth_hz)


def pulse_peak_delay_s(bandwidth_hz: float) -> float:
    """Time from the beginning of the pulse to its peak, seconds; 166 us (28.6 mm of range) at 3.98 kHz."""
    return PEAK_DELAY_SIGMAS * pulse_sigma_s(bandwidth_hz)


def pulse(t_s: NDArray[np.float64], bandwidth_hz: float) -> NDArray[np.float64]:
    """Envelope at `t_s` after its beginning; peak 1, same shape as `t_s`."""
    x = (np.asarray(t_s, dtype=np.float64) - pulse_peak_delay_s(bandwidth_hz)) / pulse_sigma_s(bandwidth_hz)
    return np.exp(-0.5 * x * x)
