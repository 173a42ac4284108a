"""The rig's clock against the host's: how fast it runs.

What arrives is late by a delay that is never negative, so the smallest (host - device) of each block of time is the
one with the least delay; the slope through these minima is the drift.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import theilslopes

BLOCK_S = 0.25
FEWEST_BLOCKS = 8
MOST_POINTS = 240


@dataclass(frozen=True)
class ClockDrift:
    """How fast the device's clock is, parts in a million, with a 95 % interval; `span_s` of host time it rests on."""

    ppm: float
    low_ppm: float
    high_ppm: float
    span_s: float


class DeviceClock:
    """Takes pairs of device time (unwrapped) and host time; `restart` where the device's clock began anew."""

    def __init__(self) -> None:
        self._minima: list[tuple[float, float]] = []
        self._block: int | None = None
        self._best: list[tuple[float, float]] = []

    def add(self, device_us: int, host_s: float) -> None:
        """One pair: what was triggered at `device_us` was here at `host_s` (monotonic)."""
        offset_s = host_s - device_us * 1e-6
        block = int(host_s // BLOCK_S)
        if block != self._block:
            self._block = block
            self._minima.append((host_s, offset_s))
        elif offset_s < self._minima[-1][1]:
            self._minima[-1] = (host_s, offset_s)

    def restart(self) -> None:
        """The clock began anew; the longest stretch so far is kept."""
        if len(self._minima) > len(self._best):
            self._best = self._minima
        self._minima, self._block = [], None

    def drift(self) -> ClockDrift | None:
        """None while there is too little to say (2 s)."""
        points = max(self._minima, self._best, key=len)
        if len(points) < FEWEST_BLOCKS:
            return None
        group = -(-len(points) // MOST_POINTS)
        kept = np.array([min(points[k:k + group], key=lambda p: p[1]) for k in range(0, len(points), group)])
        slope, _, low, high = theilslopes(kept[:, 1], kept[:, 0])
        return ClockDrift(float(-slope * 1e6), float(-high * 1e6), float(-low * 1e6), float(kept[-1, 0] - kept[0, 0]))
