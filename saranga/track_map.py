"""The network's input: how well the echoes of the last cycles fit straight and bent range tracks that end here.

An echo at 0 dB is lost in every single row; over 32 rows it stands out, but only along its own range track. A network
of this size would need millions of images to learn to sum along tracks, so the sums are made for it: log-likelihoods
(`denoise.likelihood`), summed along quadratic tracks (`denoise.track_sums`), best track for each closing speed and
column of the newest row. An obstacle that comes nearer at 0.5 m/s has its peak at (0.5 m/s, its range now).
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
from saranga.denoise.track_sums import BLOCKS, SPEED_BINS, UNIT, best_tracks, pieces, scratch_arrays
from saranga.echo import RANGE_COLUMNS

DEPTHS, HALVES, RANGE_BINS = BLOCKS, 2, 128
SHAPE = (DEPTHS * HALVES, SPEED_BINS, RANGE_BINS)
"""Newest 8, 16, 24 or 32 rows, lower and upper half of a range bin; closing speed, -0.5 to 2.5 m/s; range, 4 columns
(13 mm)."""
_COLUMNS_A_HALF = 2


class TrackMap:
    """Makes the input of one image or many; an object is of one thread.

    Args:
        bandwidth_hz: of the receiver.
        ring_down_m: nothing nearer is looked at: the transmitter still rings.
    """

    def __init__(self, bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M) -> None:
        self._sigma = pulse(bandwidth_hz).sigma_columns
        self._blank = blank_columns(ring_down_m)
        self._table = likelihood.log_likelihood_table(likelihood.DESIGN_AMPLITUDE)
        best = np.empty((DEPTHS, SPEED_BINS, RANGE_COLUMNS), dtype=np.int16)
        self._memory = (*scratch_arrays(RANGE_COLUMNS), best)

    def fill(self, iq: NDArray[np.complex64], rows: int, out: NDArray[np.float32]) -> bool:
        """Write the input for one image.

        Args:
            iq: complex64 (M, N), newest row last; imaginary part 0 everywhere when only amplitudes are known.
            rows: how many rows, counted from the newest, are of the history.
            out: float32 of `SHAPE`; all zero where nothing was measured.

        Returns:
            Whether anything was measured.
        """
        return bool(_fill(iq, rows, False, self._table, self._sigma, self._blank, out, self._memory))

    def fill_many(self, iq: NDArray[np.complex64], amplitude_only: NDArray[np.bool_], out: NDArray[np.float32]) -> None:
        """`fill` for (K, M, N), those with `amplitude_only` (K,) as if their phase were unknown, into (K, *SHAPE)."""
        _fill_many(iq, amplitude_only, self._table, self._sigma, self._blank, out, self._memory)


@njit(cache=True)
def _compressed(best, out):  # type: ignore[no-untyped-def]
    """`best_tracks` by half range bins, as float32 of `SHAPE`.

    The root keeps differences of strong echoes and the scale of noise within eight bits.
    """
    pairs = np.empty(RANGE_COLUMNS // _COLUMNS_A_HALF, dtype=np.float32)
    for b in range(DEPTHS):
        for s in range(SPEED_BINS):
            row = best[b, s]
            for i in range(pairs.size):
                x = np.float32(max(row[2 * i], row[2 * i + 1])) * np.float32(UNIT)
                pairs[i] = np.float32(0.25) * x / np.sqrt(abs(x) + np.float32(4.0))
            for half in range(HALVES):
                to = out[HALVES * b + half, s]
                for j in range(RANGE_BINS):
                    to[j] = pairs[HALVES * j + half]


@njit(cache=True)
def _evidence(iq, usable, with_phase, table, sigma, blank):  # type: ignore[no-untyped-def]
    power = likelihood.power_over_noise(iq, usable, with_phase, sigma, blank)
    return likelihood.log_likelihood(power, usable, table, blank)


@njit(cache=True, nogil=True)
def _fill(iq, rows, hide_phase, table, sigma, blank, out, memory):  # type: ignore[no-untyped-def]
    usable = likelihood.usable_rows(iq, rows)
    if not usable.any():
        out[:] = 0.0
        return False
    with_phase = not hide_phase and likelihood.has_phase(iq, usable)
    stored, sums, best = memory
    pieces(_evidence(iq, usable, with_phase, table, sigma, blank), stored, sums)
    best_tracks(sums, best)
    _compressed(best, out)
    return True


@njit(cache=True, nogil=True)
def _fill_many(iq, amplitude_only, table, sigma, blank, out, memory):  # type: ignore[no-untyped-def]
    for k in range(iq.shape[0]):
        _fill(iq[k], iq.shape[1], amplitude_only[k], table, sigma, blank, out[k], memory)
