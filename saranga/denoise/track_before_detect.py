"""Track-before-detect: no decision on any single echo, only on 32 rows of faint ones that lie on one range track.

Log-likelihood per cell (`likelihood`), highest sum along a quadratic track ending in the newest row (`tracks`); the
strongest is refined to sub-column position, erased, and the search repeated. The threshold sets the rate of false
alarms because every row is measured against its own noise floor. A track must also be visible in the newest rows,
or the history of an obstacle just passed would still raise edges.
"""

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import likelihood, tracks
from saranga.denoise.base import Denoiser
from saranga.denoise.peaks import put_peak
from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M, blank_columns, pulse
from saranga.echo import HISTORY_ROWS, EchoImage
from saranga.errors import UsageError

NAME = "tbd"

_HALF_SCORE = 13.0
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
        self._table = likelihood.log_likelihood_table(likelihood.DESIGN_AMPLITUDE)

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Edge strengths (N,) of the newest row.

        Raises:
            UsageError: an image that has not HISTORY_ROWS rows.
        """
        iq = image.iq
        if iq.shape[0] != HISTORY_ROWS:
            raise UsageError(f"denoiser {self.name!r} takes images of {HISTORY_ROWS} rows, this one is {iq.shape}")
        out = np.zeros(iq.shape[1], dtype=np.float32)
        usable = likelihood.usable_rows(iq, image.rows)
        if not usable.any():
            return out
        power = likelihood.power_over_noise(iq, usable, likelihood.has_phase(iq, usable), self._sigma, self._blank)
        evidence = likelihood.log_likelihood(power, usable, self._table, self._blank)
        for column, score in tracks.find(evidence, power, self._sigma, self._obstacles, 0.5 * _HALF_SCORE):
            put_peak(out, column, score / (score + _HALF_SCORE))
        return out


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
