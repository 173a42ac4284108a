"""Echoes: one sensor's record, the records of one trigger, and the image of the last cycles.

A record holds complex baseband samples at the sensor's own rate. An echo with delay tau reads
`A * p(t - tau) * exp(-2j * pi * fop * tau)`, I real and Q imaginary (errata.md, "N = 512"; perception.md,
"Signal").
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saranga.resample import (
    COLUMN_M,
    RANGE_COLUMNS,
    ResamplingPlan,
    resample_into,
    resampling_plan,
    sound_speed_m_s,
)
from saranga.sonar_geometry import ROLES, SonarGeometry, load_sonar

FULL_SCALE = 20000.0
"""Counts that read as 1.0 in an image: the paper's measurement limit, "20000 AU"."""
HISTORY_ROWS = 32
"""M: cycles in an image, about 0.82 s at 25.6 ms (paper, "Implementation")."""

__all__ = ["COLUMN_M", "FULL_SCALE", "HISTORY_ROWS", "RANGE_COLUMNS", "ROLES", "EchoCycle", "EchoFrame",
           "EchoImage", "SonarGeometry", "load_sonar", "resample", "sound_speed_m_s"]


@dataclass(frozen=True, slots=True)
class EchoFrame:
    """What one sensor recorded after one trigger.

    Attributes:
        role: "left", "right" or "down".
        sensor: number of the sensor on the rig.
        sequence: the sensor's own frame counter (u32, wraps).
        trigger: number of the trigger, shared by the sensors of one cycle (u32, wraps).
        device_time_us: the rig's clock at the trigger, unwrapped.
        fop_hz: carrier; the IQ rate is `fop_hz / 2**(7 - odr)`.
        odr: output data rate setting, 2 to 6.
        mode: 0 transmit/receive (or receive while another transmits), 1 receive only (noise).
        iq: int16, shape (n, 2), **Q first** as the sensor gives it.
    """

    role: str
    sensor: int
    sequence: int
    trigger: int
    device_time_us: int
    fop_hz: float
    odr: int
    mode: int
    iq: NDArray[np.int16]

    @property
    def iq_rate_hz(self) -> float:
        """Complex samples a second."""
        return self.fop_hz / 2.0 ** (7 - self.odr)


@dataclass(frozen=True, slots=True)
class EchoCycle:
    """The frames of one trigger by role; a sensor that said nothing is absent."""

    trigger: int
    t_us: int
    frames: dict[str, EchoFrame]


def resample(frame: EchoFrame, c_m_s: float) -> NDArray[np.complex64]:
    """The record on the range grid, unit counts / FULL_SCALE.

    Args:
        frame: the record; sample n is at `t = n / iq_rate`, path `c * t`.
        c_m_s: speed of sound, which the sensor does not compensate (hardware.md).

    Returns:
        complex64, shape (RANGE_COLUMNS,); column k is at range `k * COLUMN_M`. Columns beyond the record
        are zero.
    """
    row = np.zeros(RANGE_COLUMNS, dtype=np.complex64)
    plan = resampling_plan(frame.fop_hz, frame.odr, c_m_s, len(frame.iq))
    resample_into(frame.iq, plan, 1.0 / FULL_SCALE, row)
    return row


class EchoImage:
    """The last cycles of one sensor on the range grid, oldest row first, newest last.

    Every row is written twice, M rows apart, so that the last M rows always lie contiguous and nothing is
    moved. `iq` and `envelope` are views: they hold until the next `push` or `push_missing`; copy what must
    last longer.
    """

    def __init__(self, rows: int = HISTORY_ROWS) -> None:
        self._m = rows
        self._iq = np.zeros((2 * rows, RANGE_COLUMNS), dtype=np.complex64)
        self._envelope = np.zeros((2 * rows, RANGE_COLUMNS), dtype=np.float32)
        self._head = 0
        self._stale = 0
        self._rows = 0
        self._trigger: int | None = None

    @property
    def rows(self) -> int:
        """How many rows, counted from the newest, are cycles since the start (lost ones included)."""
        return self._rows

    @property
    def trigger(self) -> int | None:
        """Trigger of the newest row, None while empty."""
        return self._trigger

    @property
    def iq(self) -> NDArray[np.complex64]:
        """complex64, shape (M, RANGE_COLUMNS), unit counts / FULL_SCALE."""
        return self._iq[self._head:self._head + self._m]

    @property
    def envelope(self) -> NDArray[np.float32]:
        """|iq|, float32, shape (M, RANGE_COLUMNS); only rows new since the last look are computed."""
        first = self._head + self._m - min(self._stale, self._m)
        for upper in range(first, self._head + self._m):
            np.abs(self._iq[upper], out=self._envelope[upper])
            twin = upper - self._m if upper >= self._m else upper + self._m
            self._envelope[twin] = self._envelope[upper]
        self._stale = 0
        return self._envelope[self._head:self._head + self._m]

    def push(self, frame: EchoFrame, c_m_s: float) -> None:
        """Append a record; cycles whose trigger was skipped become zero rows, so that a row stays a cycle.

        A late or repeated frame is written into its own row. A trigger more than M cycles back means that
        the rig has restarted: the image starts anew.
        """
        plan = resampling_plan(frame.fop_hz, frame.odr, c_m_s, len(frame.iq))
        if self._trigger is not None:
            step = (frame.trigger - self._trigger) & 0xFFFFFFFF
            age = (self._trigger - frame.trigger) & 0xFFFFFFFF
            if age < self._m:
                self._rewrite(frame, age, plan)
                return
            if step >= 0x80000000:
                self.clear()
            else:
                for _ in range(min(step - 1, self._m)):
                    self._advance()
        slot = self._advance()
        resample_into(frame.iq, plan, 1.0 / FULL_SCALE, self._iq[slot])
        self._iq[slot + self._m] = self._iq[slot]
        self._trigger = frame.trigger

    def push_missing(self, trigger: int) -> None:
        """Append zero rows up to `trigger`, whose record never came; an old trigger is ignored."""
        step = 1 if self._trigger is None else (trigger - self._trigger) & 0xFFFFFFFF
        if 0 < step < 0x80000000:
            for _ in range(min(step, self._m)):
                self._advance()
            self._trigger = trigger

    def clear(self) -> None:
        """Forget everything."""
        self._iq[:] = 0
        self._envelope[:] = 0
        self._head = self._stale = self._rows = 0
        self._trigger = None

    def _advance(self) -> int:
        """Open a new newest row, zeroed; returns its lower slot (the twin is M above)."""
        slot = self._head
        self._head = (self._head + 1) % self._m
        self._stale += 1
        self._rows = min(self._rows + 1, self._m)
        self._iq[slot] = 0
        self._iq[slot + self._m] = 0
        return slot

    def _rewrite(self, frame: EchoFrame, age: int, plan: ResamplingPlan) -> None:
        if age >= self._rows:
            return
        slot = (self._head - 1 - age) % self._m
        resample_into(frame.iq, plan, 1.0 / FULL_SCALE, self._iq[slot])
        self._iq[slot + self._m] = self._iq[slot]
        self._stale = max(self._stale, age + 1)
