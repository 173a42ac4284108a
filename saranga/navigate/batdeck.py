"""BatDeck: one forward sensor, brake with distance, turn until the way is clear (the paper's flight rival).

Behaviour of the group's public firmware (facts in docs/batdeck.md), re-implemented: each range bin is low-passed
(0.8 old, 0.2 new), the first bin over 1.5 x the mean noise learnt in hover plus 1500 counts is the distance d;
v_x = d / 4 beyond 0.3 m, rising at most 0.05 m/s a command and never above 1 m/s, else 0; no turn beyond 0.8 m, linear
to full at 0.4 m; the side flips with probability 1/2 once 10 s have passed and d > 0.4 m.

Not stated there and chosen here: "full" is `full_yaw_rad_s` = 1.5 rad/s (about 86 deg/s; the firmware's 5.5 has no
known unit); nothing over the threshold reads as d = `nothing_m`, the end of the record (1.66 m, so 0.41 m/s), as more
than that cannot be known to be free; the filter runs once an echo cycle; the noise is the mean of the last
`calibration_cycles` (1 s) before `reset`, which marks the start of the course, so of the hover after take-off; where
there were fewer, it hovers until it has them; bins nearer than `blind_m` hold ring-down and do not count.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from saranga.echo import COLUMN_M, FULL_SCALE, RANGE_COLUMNS, EchoImage
from saranga.localise import Obstacle
from saranga.navigate.base import VelocityCommand

NAME = "batdeck"
SONAR = "batdeck"


@dataclass(frozen=True)
class BatDeckParameters:
    """Attributes: lengths in m, times in s, noise in counts; names as in the module's docstring."""

    desired_speed_m_s: float = 1.0
    old_weight: float = 0.8
    noise_factor: float = 1.5
    noise_margin_counts: float = 1500.0
    blind_m: float = 0.15
    stop_m: float = 0.3
    speed_per_m: float = 0.25
    rise_m_s: float = 0.05
    clear_m: float = 0.8
    full_m: float = 0.4
    full_yaw_rad_s: float = 1.5
    flip_s: float = 10.0
    nothing_m: float = RANGE_COLUMNS * COLUMN_M
    calibration_cycles: int = 40
    seed: int = 1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isfinite(value) or value < 0:
                raise ValueError(f"{field.name} is {value}; give a finite number that is not negative")
        if self.old_weight >= 1.0:
            raise ValueError(f"old_weight is {self.old_weight}; give less than 1")
        if self.clear_m <= self.full_m:
            raise ValueError(f"clear_m is {self.clear_m}, not above full_m {self.full_m}")
        if self.calibration_cycles < 1:
            raise ValueError(f"calibration_cycles is {self.calibration_cycles}; give 1 or more")


class BatDeck:
    """An `EchoPolicy`: it reads echo rows, not obstacles."""

    name = NAME
    sonar = SONAR

    def __init__(self, parameters: BatDeckParameters) -> None:
        self.parameters = parameters
        self._first_column = round(parameters.blind_m / COLUMN_M)
        self._window: deque[NDArray[np.float64]] = deque(maxlen=parameters.calibration_cycles)
        self.reset()

    def reset(self) -> None:
        """A course starts: speed, filter, side and clock start anew, the noise is that of the last window.

        A window that is not full is dropped and filled from the echoes to come.
        """
        self._noise: NDArray[np.float64] | None = None
        if len(self._window) == self._window.maxlen:
            self._learn()
        else:
            self._window.clear()
        self._rng = np.random.default_rng(self.parameters.seed)
        self._trigger: int | None = None
        self._filtered: NDArray[np.float64] | None = None
        self._speed_m_s = 0.0
        self._side = 1.0
        self._turned_us: int | None = None
        self.distance_m = self.parameters.nothing_m

    @property
    def threshold_counts(self) -> NDArray[np.float64] | None:
        """(N,) amplitude above which a bin is an echo; None until the noise is known."""
        if self._noise is None:
            return None
        return self.parameters.noise_factor * self._noise + self.parameters.noise_margin_counts

    def decide(self, obstacles: Sequence[Obstacle], t_us: int) -> VelocityCommand:
        """Hover: BatDeck knows no obstacles, a stack gives it echoes by `decide_echoes`."""
        return VelocityCommand(0.0, 0.0, 0.0)

    def decide_echoes(self, images: Mapping[str, EchoImage], t_us: int) -> VelocityCommand:
        """Velocity by the forward sensor, the first of `images`.

        Args:
            images: by role; rows new since the last call are taken in, in order.
            t_us: now.
        """
        for row in self._new_rows(next(iter(images.values()))):
            self._take(row)
        threshold = self.threshold_counts
        if threshold is None or self._filtered is None:
            return VelocityCommand(0.0, 0.0, 0.0)
        above = self._filtered > threshold
        above[:self._first_column] = False
        self.distance_m = float(np.argmax(above)) * COLUMN_M if above.any() else self.parameters.nothing_m
        return self._command(t_us)

    def _new_rows(self, image: EchoImage) -> NDArray[np.float64]:
        """(k, N) counts, oldest first; lost cycles (all zero) are left out."""
        if image.trigger is None:
            return np.zeros((0, RANGE_COLUMNS))
        new = image.rows if self._trigger is None else (image.trigger - self._trigger) & 0xFFFFFFFF
        new = image.rows if new >= 0x80000000 else min(new, image.rows)
        self._trigger = image.trigger
        rows = image.envelope[len(image.envelope) - new:].astype(np.float64) * FULL_SCALE
        return rows[rows.any(axis=1)]

    def _take(self, row: NDArray[np.float64]) -> None:
        self._window.append(row)
        if self._noise is None and len(self._window) == self._window.maxlen:
            self._learn()
        old = self.parameters.old_weight
        self._filtered = row if self._filtered is None else old * self._filtered + (1.0 - old) * row

    def _learn(self) -> None:
        self._noise = np.mean(np.array(self._window), axis=0)

    def _command(self, t_us: int) -> VelocityCommand:
        p, d = self.parameters, self.distance_m
        if self._turned_us is None:
            self._turned_us = t_us
        if t_us - self._turned_us > p.flip_s * 1e6 and d > p.full_m:
            self._turned_us = t_us
            if self._rng.random() < 0.5:
                self._side = -self._side
        wanted = min(d * p.speed_per_m, 1.0, p.desired_speed_m_s) if d > p.stop_m else 0.0
        self._speed_m_s = min(wanted, self._speed_m_s + p.rise_m_s)
        turn = min(max((p.clear_m - d) / (p.clear_m - p.full_m), 0.0), 1.0)
        return VelocityCommand(self._speed_m_s, 0.0, 0.0, self._side * turn * p.full_yaw_rad_s)


def build(desired_speed_m_s: float = 1.0, seed: int = 1, full_yaw_rad_s: float = 1.5, calibration_cycles: int = 40,
          nothing_m: float = RANGE_COLUMNS * COLUMN_M) -> BatDeck:
    """BatDeck at no more than `desired_speed_m_s` (and never above 1 m/s); `seed` draws the turning side.

    Raises:
        ValueError: a parameter that is not finite or negative.
    """
    return BatDeck(BatDeckParameters(desired_speed_m_s=desired_speed_m_s, seed=seed, full_yaw_rad_s=full_yaw_rad_s,
                                     calibration_cycles=calibration_cycles, nothing_m=nothing_m))
