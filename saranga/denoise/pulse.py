"""The pulse an echo is made of, and what part of the record is never an echo.

An echo of true range r begins at delay tau = 2 r / c. Its envelope is p(t - tau) with
p(t) = exp(-(t - t_peak)^2 / (2 s^2)), s = 0.1325 / (B / 2) and t_peak = 2.5 s: the amplitude spectrum is -3 dB at
+-B/2, and the rise begins about at tau. For B = 3.98 kHz, s is 67 us and the peak lies 28.6 mm of range behind tau.
"""

from dataclasses import dataclass

from saranga.resample import COLUMN_M

BANDWIDTH_HZ = 3980.0
"""Measured bandwidth of the sensor (paper, "Doppler")."""
RING_DOWN_M = 0.135
"""Range in which the transmitter still rings: about 20 samples at fop/2."""
_SPEED_M_S = 343.2
_PEAK_AT_S = 2.5


@dataclass(frozen=True)
class Pulse:
    """Width and delay of the pulse in columns of the range grid, at 20 C (1.5 % a 10 K, under 0.5 mm)."""

    sigma_columns: float
    peak_columns: float

    @property
    def peak_m(self) -> float:
        """Range by which the peak lies behind the true range."""
        return self.peak_columns * COLUMN_M

    @property
    def sigma_m(self) -> float:
        """Width s as range."""
        return self.sigma_columns * COLUMN_M


def pulse(bandwidth_hz: float = BANDWIDTH_HZ) -> Pulse:
    """Pulse of a receiver of this bandwidth.

    Raises:
        ValueError: a bandwidth that is not within 500..20000 Hz.
    """
    if not 500.0 <= bandwidth_hz <= 20_000.0:
        raise ValueError(f"bandwidth_hz is {bandwidth_hz}; give 500..20000 Hz")
    sigma_s = 0.1325 / (bandwidth_hz / 2.0)
    sigma_columns = sigma_s * _SPEED_M_S / (2.0 * COLUMN_M)
    return Pulse(sigma_columns, _PEAK_AT_S * sigma_columns)


def blank_columns(ring_down_m: float) -> int:
    """Columns at the start of a record that are the transmitter's ringing.

    Raises:
        ValueError: outside 0..1 m.
    """
    if not 0.0 <= ring_down_m <= 1.0:
        raise ValueError(f"ring_down_m is {ring_down_m}; give 0..1 m")
    return int(ring_down_m / COLUMN_M) + 1
