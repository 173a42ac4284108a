"""The network's input: how well the echoes of the last cycles fit straight and bent range tracks that end here.

An echo at 0 dB is lost in every single row; over 32 rows it stands out, but only along its own range track. A network
of this size would need millions of images to learn to sum along tracks, so the sums are made for it: log-likelihoods
(`denoise.likelihood`), summed along quadratic tracks (`denoise.tracks`), best track for each closing speed and column
of the newest row. An obstacle that comes nearer at 0.5 m/s has its peak at (0.5 m/s, its range now).
What is left to the network is what a rule does badly: telling obstacles from ringing, sidelobes and the traces of
obstacles that have gone, and how likely an edge is.

Recordings without phase (amplitudes) are taken row by row against their own median instead of through the matched
filter.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.denoise import likelihood
from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M, blank_columns, pulse
from saranga.denoise.tracks import (
    _ACCELS,
    _SPEEDS,
    ACCEL_SIGMA,
    ACCEL_STEP,
    SPEED_MIN,
    SPEED_STEP,
    _link,
    pieces,
)
from saranga.denoise.tracks import STEP as CELL

DEPTHS, HALVES, SPEED_BINS, RANGE_BINS = 4, 2, 32, 128
SHAPE = (DEPTHS * HALVES, SPEED_BINS, RANGE_BINS)
"""Newest 8, 16, 24 or 32 rows, lower and upper half of a range bin; closing speed, -0.5 to 2.5 m/s; range, 4 columns
(13 mm)."""
_SPEEDS_A_BIN = _SPEEDS // SPEED_BINS
_CELLS = HALVES * RANGE_BINS
_LOWEST = np.float32(-1e9)


class TrackMap:
    """Makes the input of one image or many.

    Args:
        bandwidth_hz: of the receiver.
        ring_down_m: nothing nearer is looked at: the transmitter still rings.
    """

    def __init__(self, bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M) -> None:
        self._sigma = pulse(bandwidth_hz).sigma_columns
        self._blank = blank_columns(ring_down_m)
        self._table = likelihood.log_likelihood_table(likelihood.DESIGN_AMPLITUDE)

    def fill(self, iq: NDArray[np.complex64], rows: int, out: NDArray[np.float32]) -> bool:
        """Write the input for one image.

        Args:
            iq: complex64 (M, N), newest row last; imaginary part 0 everywhere when only amplitudes are known.
            rows: how many rows, counted from the newest, are of the history.
            out: float32 of `SHAPE`; all zero where nothing was measured.

        Returns:
            Whether anything was measured.
        """
        return bool(_fill(iq, rows, self._table, self._sigma, self._blank, out))

    def fill_many(self, iq: NDArray[np.complex64], amplitude_only: NDArray[np.bool_], out: NDArray[np.float32]) -> None:
        """`fill` for (K, M, N), those with `amplitude_only` (K,) as if their phase were unknown, into (K, *SHAPE)."""
        _fill_many(iq, amplitude_only, self._table, self._sigma, self._blank, out)


@njit(cache=True)
def _raise_to(best, total):  # type: ignore[no-untyped-def]
    for c in range(best.size):
        best[c] = total[c] if total[c] > best[c] else best[c]


@njit(cache=True)
def _add_and_raise(best, total, piece):  # type: ignore[no-untyped-def]
    for c in range(best.size):
        t = total[c] + piece[c]
        total[c] = t
        best[c] = t if t > best[c] else best[c]


@njit(cache=True)
def _best_tracks(coarse, out):  # type: ignore[no-untyped-def]
    """Fill `out` with the best score of the tracks of every (rows used, speed, range) bin, compressed."""
    piece = pieces(coarse)
    best = np.empty((DEPTHS, _CELLS), dtype=np.float32)
    total = np.empty(_CELLS, dtype=np.float32)
    out[:] = _LOWEST
    for iv in range(_SPEEDS_A_BIN * SPEED_BINS):
        v = SPEED_MIN + iv * SPEED_STEP
        best[:] = _LOWEST
        for ia in range(_ACCELS):
            a = (ia - _ACCELS // 2) * ACCEL_STEP
            total[:] = -0.5 * (a / ACCEL_SIGMA) ** 2
            for b in range(DEPTHS):
                shift, s = _link(v, a, b)
                first, last = min(max(0, -shift), _CELLS), max(min(_CELLS, _CELLS - shift), 0)
                row = best[b]
                if last <= first:
                    _raise_to(row, total)
                    continue
                _raise_to(row[:first], total[:first])
                _add_and_raise(row[first:last], total[first:last], piece[b, s, first + shift:last + shift])
                _raise_to(row[last:], total[last:])
        for b in range(DEPTHS):
            for half in range(HALVES):
                to = out[HALVES * b + half, iv // _SPEEDS_A_BIN]
                for j in range(RANGE_BINS):
                    to[j] = max(to[j], best[b, HALVES * j + half])
    # a root keeps differences of strong echoes and the scale of noise within eight bits
    for b in range(DEPTHS * HALVES):
        for s in range(SPEED_BINS):
            for j in range(RANGE_BINS):
                x = out[b, s, j]
                out[b, s, j] = np.float32(0.25) * x / np.sqrt(abs(x) + np.float32(4.0))


@njit(cache=True)
def _evidence(iq, usable, with_phase, table, sigma, blank):  # type: ignore[no-untyped-def]
    power = likelihood.power_over_noise(iq, usable, with_phase, sigma, blank)
    return likelihood.log_likelihood(power, usable, table, blank)


@njit(cache=True, nogil=True)
def _fill(iq, rows, table, sigma, blank, out):  # type: ignore[no-untyped-def]
    usable = likelihood.usable_rows(iq, rows)
    if not usable.any():
        out[:] = 0.0
        return False
    evidence = _evidence(iq, usable, likelihood.has_phase(iq, usable), table, sigma, blank)
    _best_tracks(evidence[:, ::CELL].copy(), out)
    return True


@njit(cache=True, nogil=True)
def _fill_many(iq, amplitude_only, table, sigma, blank, out):  # type: ignore[no-untyped-def]
    for k in range(iq.shape[0]):
        usable = likelihood.usable_rows(iq[k], iq.shape[1])
        if not usable.any():
            out[k] = 0.0
            continue
        evidence = _evidence(iq[k], usable, not amplitude_only[k], table, sigma, blank)
        _best_tracks(evidence[:, ::CELL].copy(), out[k])
