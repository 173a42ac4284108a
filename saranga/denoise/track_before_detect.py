"""Track-before-detect: no decision on any single echo, only on 32 rows of faint ones that lie on one range track.

Log-likelihood per cell (`likelihood`), highest sum along a quadratic track ending in the newest row (`tracks`); the
strongest is refined to sub-column position, erased, and the search repeated. The threshold sets the rate of false
alarms because every row is measured against its own noise floor. A track must also be visible in the newest rows,
or the history of an obstacle just passed would still raise edges.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.denoise import likelihood, tracks
from saranga.denoise.base import Denoiser
from saranga.denoise.peaks import put_peak
from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M, blank_columns, pulse
from saranga.echo import EchoImage

NAME = "tbd"

_DESIGN_AMPLITUDE = 1.2
"""Echo amplitude in noise RMS that the evidence is weighed for: faint, with a long history."""
_SUPPORT = 3
"""Rows of the newest block that must speak for a track."""
_SIDELOBE_REACH = likelihood.REACH + 12.0
_SIDELOBE = 0.05
"""Share of a strong echo's power, and columns about it, within which the filter's sidelobes are no other echo."""
_HALF_SCORE = 12.5
"""Log-likelihood at which the edge strength is 0.5; calibrated for 0.02 false edges a frame in noise."""


class TrackBeforeDetect:
    """Callable of the name; see the module."""

    name = NAME
    threshold = 0.5

    def __init__(self, bandwidth_hz: float, ring_down_m: float, obstacles: int) -> None:
        shape = pulse(bandwidth_hz)
        self.edge_offset_m = shape.peak_m
        self._sigma = shape.sigma_columns
        self._blank = blank_columns(ring_down_m)
        self._obstacles = obstacles
        self._table = likelihood.log_likelihood_table(_DESIGN_AMPLITUDE)

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Edge strengths (N,) of the newest row."""
        return _edges(image.iq, image.rows, self._sigma, self._blank, self._table, self._obstacles, _HALF_SCORE)


@njit(cache=True)
def _edges(iq, rows, sigma, blank, table, obstacles, half_score):  # type: ignore[no-untyped-def]
    n = iq.shape[1]
    out = np.zeros(n, dtype=np.float32)
    usable = likelihood.usable_rows(iq, rows)
    if not usable.any():
        return out
    taps = likelihood.whitened_taps(iq, usable, sigma, blank)
    power = likelihood.filtered_power(iq, usable, taps, blank)
    fine = likelihood.log_likelihood(power, usable, table, blank)
    coarse = fine[:, ::tracks.STEP].copy()
    for _ in range(obstacles):
        piece = tracks.pieces(coarse)
        best = tracks.search(piece)
        cell = np.argmax(best)
        score = best[cell]
        if score < 0.5 * half_score:
            break
        v, a, used = tracks.track_at(piece, cell)
        depth = used * tracks.BLOCK
        c0, v, a = tracks.climb(fine, float(cell * tracks.STEP), v, a, depth)
        c0, v, a = tracks.polish(_amplitude_field(power, c0, v, a, depth), c0, v, a, depth)
        supported = c0 >= blank and tracks.support(fine, c0, v, a) >= _SUPPORT
        for evidence, step in ((coarse, tracks.STEP), (fine, 1)):
            tracks.erase(evidence, step, power, c0, v, a, 2.5 * sigma, _SIDELOBE_REACH, _SIDELOBE)
        if supported:
            put_peak(out, c0, score / (score + half_score))
    return out


@njit(cache=True)
def _amplitude_field(power, c0, v, a, rows):  # type: ignore[no-untyped-def]
    """(M, N) log-likelihood of an echo as strong as the track's, uncapped: 2 sqrt(1 + A^2 q), which is ln I0's shape."""
    m, n = power.shape
    total = 0.0
    for k in range(rows):
        c = int(np.floor(c0 + v * k + 0.5 * a * k * k + 0.5))
        if 0 <= c < n:
            total += power[m - 1 - k, c]
    strength = np.float32(max(total / rows - 1.0, 0.25))
    return np.float32(2.0) * np.sqrt(np.float32(1.0) + strength * power)


def build(
    bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M, obstacles: int = 6
) -> Denoiser:
    """Track-before-detect for a receiver of this bandwidth, blind up to `ring_down_m`, for so many obstacles at most.

    Raises:
        ValueError: an option out of its bounds.
    """
    if not 1 <= obstacles <= 32:
        raise ValueError(f"obstacles is {obstacles}; give 1..32")
    return TrackBeforeDetect(bandwidth_hz, ring_down_m, obstacles)
