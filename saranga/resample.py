"""From a sensor's own samples to the range grid: windowed-sinc interpolation with cached weights.

The echo band (4 kHz) is far narrower than the IQ rate of ODR 6 and 5 (26.5 and 13.3 kHz), fits that of ODR 4
(6.6 kHz), and does not fit those of ODR 3 and 2 (3.3 and 1.7 kHz), whose records are aliased in the sensor
itself.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.errors import UsageError

RANGE_COLUMNS = 512
"""N: columns of the range grid (paper, "Implementation")."""
COLUMN_M = 1.66 / RANGE_COLUMNS
"""Range per column: 1.66 m over 512 columns, 3.242 mm. The path of column k is `2 * k * COLUMN_M`."""
TAPS = 16
KAISER_BETA = 8.5
"""About -90 dB outside the transition band, which with 16 taps is 0.37 of the rate wide: 0.31 to 0.69 of it.

At ODR 4 the 4 kHz echo band (+-0.30 of the rate) just fits.
"""


@dataclass(frozen=True, eq=False, slots=True)
class ResamplingPlan:
    """Weights of one sensor setting; `start[k]` indexes the record padded by TAPS zeros at both ends."""

    samples: int
    start: NDArray[np.int32]
    weights: NDArray[np.float32]


def sound_speed_m_s(temperature_c: float) -> float:
    """Speed of sound in air, 331.3 sqrt(1 + T / 273.15) (acoustics.md)."""
    return float(331.3 * np.sqrt(1.0 + temperature_c / 273.15))


def iq_rate_hz(fop_hz: float, odr: int) -> float:
    """Complex samples a second at an ODR of 2 to 6: fop/32 to fop/2 (SonicLib 4.9.0)."""
    return fop_hz / 2.0 ** (7 - odr)


@lru_cache(maxsize=64)
def resampling_plan(fop_hz: float, odr: int, c_m_s: float, samples: int) -> ResamplingPlan:
    """Weights that take `samples` IQ pairs to the range grid at one speed of sound.

    Columns whose time lies beyond the last sample get no weight: they were not measured. Weights that reach
    past an end of the record are dropped and the rest scaled to sum to one.

    Raises:
        UsageError: fop, ODR or speed of sound that no sensor or air can have.
    """
    if not 20e3 <= fop_hz <= 200e3:
        raise UsageError(f"fop {fop_hz} Hz is outside 20000..200000 Hz: check the sensor's HELLO or the "
                         "sonar file")
    if odr not in (2, 3, 4, 5, 6):
        raise UsageError(f"ODR {odr} is not one of 2, 3, 4, 5, 6: check the sensor's configuration")
    if not 250.0 <= c_m_s <= 420.0:
        raise UsageError(f"speed of sound {c_m_s} m/s is outside 250..420 m/s: check the temperature")
    position = 2.0 * COLUMN_M * np.arange(RANGE_COLUMNS) / c_m_s * iq_rate_hz(fop_hz, odr)
    return plan_at(position, samples)


def plan_at(position: NDArray[np.floating[Any]], samples: int) -> ResamplingPlan:
    """Weights for columns at these places of the record, in samples, rising from 0."""
    first = np.floor(position).astype(np.int64) - (TAPS // 2 - 1)
    offset = position[:, None] - (first[:, None] + np.arange(TAPS)[None, :])
    inside = np.clip(1.0 - (offset / (TAPS / 2)) ** 2, 0.0, None)
    window = np.i0(KAISER_BETA * np.sqrt(inside)) / np.i0(KAISER_BETA)
    weights = np.sinc(offset) * window
    tap = first[:, None] + np.arange(TAPS)[None, :]
    # Sample 0 is zero or metadata in every recording (hardware.md), so it counts as not there.
    weights[(tap < 1) | (tap >= samples)] = 0.0
    unmeasured = (position < 1.0) | (position > samples - 1)
    weights[unmeasured] = 0.0
    total = weights.sum(axis=1, keepdims=True)
    np.divide(weights, total, out=weights, where=~unmeasured[:, None])
    start = np.where(unmeasured, 0, first + TAPS).astype(np.int32)
    return ResamplingPlan(samples, start, np.ascontiguousarray(weights, dtype=np.float32))


def resample_into(iq: NDArray[np.int16], plan: ResamplingPlan, gain: float,
                  row: NDArray[np.complex64]) -> None:
    """Write a record, (n, 2) int16 with Q first, times `gain`, onto `row` (RANGE_COLUMNS,) complex64."""
    _resample(iq, plan.start, plan.weights, np.float32(gain), row.view(np.float32))


@njit(cache=True)
def _resample(iq, start, weights, gain, row):  # type: ignore[no-untyped-def]
    n = iq.shape[0]
    i_part = np.zeros(n + 2 * TAPS, np.float32)
    q_part = np.zeros(n + 2 * TAPS, np.float32)
    for k in range(n):
        q_part[TAPS + k] = gain * np.float32(iq[k, 0])
        i_part[TAPS + k] = gain * np.float32(iq[k, 1])
    for k in range(start.shape[0]):
        s = start[k]
        a0 = a1 = a2 = a3 = np.float32(0.0)
        b0 = b1 = b2 = b3 = np.float32(0.0)
        # Four sums each, in a fixed order: quicker than one and still bit-repeatable.
        for t in range(0, TAPS, 4):
            w0, w1, w2, w3 = weights[k, t], weights[k, t + 1], weights[k, t + 2], weights[k, t + 3]
            a0 += w0 * i_part[s + t]
            a1 += w1 * i_part[s + t + 1]
            a2 += w2 * i_part[s + t + 2]
            a3 += w3 * i_part[s + t + 3]
            b0 += w0 * q_part[s + t]
            b1 += w1 * q_part[s + t + 1]
            b2 += w2 * q_part[s + t + 2]
            b3 += w3 * q_part[s + t + 3]
        row[2 * k] = (a0 + a1) + (a2 + a3)
        row[2 * k + 1] = (b0 + b1) + (b2 + b3)
