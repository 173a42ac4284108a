"""Disparity of an echo between two sensors from their complex samples: a fraction of a column in place of whole edges.

Two sensors hear the same echo with the same motion and the same unknown phase in every cycle; the product of one with
the conjugate of the other has neither. Both images are whitened along range (`saranga.denoise.likelihood`). Along the
echo's track c(k) in the left image, k rows ago, and a disparity l(k) = l0 + l1 k,

    S = sum over k of  L_k(c(k)) conj(R_k(c(k) - l(k))) exp(2j pi fop l(k) / c)

is as large as the echoes allow; the slope l1 takes up the sideways motion of the vehicle. |S| is highest at the true
l0 (the delay of the envelope), and there S is real and positive, which gives l0 far more finely but only up to whole
wavelengths (the delay of the carrier). |S| over the root of both powers, the coherence, is 1 without noise. Other
echoes turn against each other from row to row, so it also tells which edge belongs to which.

The envelope needs nothing to be known about the sensors. The carrier needs the fixed phase between them
(`SonarGeometry.calibration`, measured by `calibrate`): a wrong one moves the disparity by half a wavelength at most,
3.2 mm or 1.9 degrees at b = 0.10 m straight ahead. At 1 m and 10 dB the median azimuth error straight ahead is 0.14
degrees with the carrier, 0.5 with the envelope, 1.2 with a carrier of unknown phase (tests/benchmarks/test_azimuth.py).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saranga.coherence import most_coherent
from saranga.denoise.pulse import RING_DOWN_M, blank_columns
from saranga.echo import EchoImage
from saranga.errors import UsageError
from saranga.pulse import pulse_peak_delay_s, pulse_sigma_s
from saranga.resample import COLUMN_M
from saranga.sonar_geometry import SensorCalibration, SonarGeometry

Method = Literal["phase", "envelope"]

TRUSTED_COLUMNS = 0.6
"""The carrier decides where the envelope's standard error is under this (a column is a wavelength): right in 6 of 10
cases at the limit."""
_ERROR_SIGMAS = 0.165
"""That error over sqrt(1 / coherence^2 - 1), in widths of the pulse; measured on synthetic pairs at 10 and 5 dB."""


@dataclass(frozen=True, eq=False)
class Matches:
    """What `match` found out about each left edge, in the order given; all arrays (k,).

    Attributes:
        partner: index of the other sensor's edge, -1: none.
        disparity_m: path at the left less path at the other sensor; NaN: no partner.
        coherence: 0..1 of the echo in both images; 0: the images say nothing (dead sensor, recording of amplitudes
            alone), the edges gave the disparity.
        on_carrier: whether the carrier gave it, rather than the envelope.
    """

    partner: NDArray[np.int64]
    disparity_m: NDArray[np.float64]
    coherence: NDArray[np.float64]
    on_carrier: NDArray[np.bool_]


def match(
    left: EchoImage,
    other: EchoImage,
    paths_left: ArrayLike,
    paths_other: ArrayLike,
    limit_m: float,
    geometry: SonarGeometry,
    c_m_s: float,
    *,
    method: Method = "envelope",
    calibration: SensorCalibration | None = None,
) -> Matches:
    """Partner and disparity of each left edge, the most coherent pair first; one to one.

    Args:
        left, other: images of the same triggers, from one speed of sound.
        paths_left, paths_other: metres, of the edges in the newest rows, less their offset.
        limit_m: largest disparity that may be a pair.
        geometry: gives fop_hz and bandwidth_hz.
        c_m_s: speed of sound of the images.
        method: `envelope`, or `phase` (carrier and envelope).
        calibration: of the other sensor against the left one; None: they are alike.

    Raises:
        UsageError: another method.
    """
    if method not in ("phase", "envelope"):
        raise UsageError(f"unknown disparity method {method!r}: known are phase, envelope")
    known = calibration or SensorCalibration()
    lag, total, partner, coherence = _lags(left, other, paths_left, paths_other, limit_m, known.delay_m, geometry,
                                           c_m_s)
    turns = geometry.fop_hz / c_m_s * 2.0 * COLUMN_M
    late = known.delay_m / (2.0 * COLUMN_M)
    disparity = lag + late
    error = np.full(lag.size, np.inf)
    heard = coherence > 0.0
    sigma = pulse_sigma_s(geometry.bandwidth_hz) * c_m_s / (2.0 * COLUMN_M)
    error[heard] = _ERROR_SIGMAS * sigma * np.sqrt(np.maximum(1.0 / coherence[heard] ** 2 - 1.0, 0.0))
    on_carrier = (error < TRUSTED_COLUMNS) & (method == "phase")
    angle = np.angle(total * np.exp(1j * (known.phase_rad + 2.0 * np.pi * turns * late)))
    disparity[on_carrier] -= angle[on_carrier] / (2.0 * np.pi * turns)
    return Matches(partner, 2.0 * COLUMN_M * disparity, coherence, on_carrier)


def calibrate(
    pairs: list[tuple[EchoImage, EchoImage, float, float]],
    disparity_m: float,
    geometry: SonarGeometry,
    c_m_s: float,
) -> SensorCalibration:
    """How the other sensor differs from the left one, from echoes of one obstacle whose true disparity is known.

    Put a pole or ball straight ahead of the middle between both sensors (`disparity_m` 0). 1 mm of disparity off, 0.6
    degrees at b = 0.10 m, makes 1 mm of delay and 56 degrees of phase. The mean over the images is taken.

    Args:
        pairs: left image, other image, path of the obstacle's edge in each.
        disparity_m: true path at the left less true path at the other sensor.

    Raises:
        UsageError: no pair, or less than half of them coherent to 0.8 (too noisy, or not the same echo).
    """
    found = []
    for left, other, path_left, path_other in pairs:
        lag, total, _, coherence = _lags(left, other, path_left, path_other, np.inf, 0.0, geometry, c_m_s)
        if coherence[0] >= 0.8:
            found.append((lag[0], total[0]))
    if 2 * len(found) < max(len(pairs), 1):
        raise UsageError(f"calibration: {len(found)} of {len(pairs)} pairs of images are coherent to 0.8, at least "
                         "half must be: bring the obstacle nearer or make it quieter")
    lags, totals = (np.array(values) for values in zip(*found, strict=True))
    wavelength = c_m_s / geometry.fop_hz
    apart = 2.0 * COLUMN_M * lags - disparity_m
    phase = np.exp(-1j * np.angle(totals)) * np.exp(2j * np.pi * apart / wavelength)
    return SensorCalibration(delay_m=-float(np.mean(apart)), phase_rad=float(np.angle(np.mean(phase))))


def _lags(
    left: EchoImage, other: EchoImage, paths_left: ArrayLike, paths_other: ArrayLike, limit_m: float, late_m: float,
    geometry: SonarGeometry, c_m_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.int64], NDArray[np.float64]]:
    """Lag in columns as the images have it (the other sensor's delay is in it), S, partner and coherence, each (k,)."""
    sigma = pulse_sigma_s(geometry.bandwidth_hz) * c_m_s / (2.0 * COLUMN_M)
    peak = pulse_peak_delay_s(geometry.bandwidth_hz) * c_m_s / (2.0 * COLUMN_M)
    here = np.asarray(paths_left, dtype=np.float64).reshape(-1) / (2.0 * COLUMN_M) + peak
    there = np.asarray(paths_other, dtype=np.float64).reshape(-1) / (2.0 * COLUMN_M) + peak
    turns = geometry.fop_hz / c_m_s * 2.0 * COLUMN_M
    rows = min(left.rows, other.rows)
    return most_coherent(left.iq, other.iq, rows, here, there, limit_m / (2.0 * COLUMN_M), late_m / (2.0 * COLUMN_M),
                         sigma, turns, blank_columns(RING_DOWN_M))
