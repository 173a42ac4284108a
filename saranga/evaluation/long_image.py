"""Echo images longer than the network's record: the same grid of 3.24 mm, further out, in windows of 512 columns."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser
from saranga.echo import FULL_SCALE, HISTORY_ROWS, EchoFrame
from saranga.errors import UsageError
from saranga.evaluation.answering import ArrayImage, timed_row
from saranga.evaluation.recorded import RecordedFrames
from saranga.resample import (
    COLUMN_M,
    RANGE_COLUMNS,
    ResamplingPlan,
    iq_rate_hz,
    plan_at,
    resample_into,
)

LONGEST_M = 30.0

STRIDE = RANGE_COLUMNS // 2
"""Columns from window to window, at most: every column lies in the middle half of one, but for the very ends."""


@lru_cache(maxsize=16)
def long_plan(range_per_sample_m: float, samples: int, columns: int) -> ResamplingPlan:
    """Weights as `saranga.resample.resampling_plan`, for any number of columns.

    Args:
        range_per_sample_m: c / (2 IQ rate).
        samples: IQ pairs a record.
        columns: of COLUMN_M.
    """
    return plan_at(COLUMN_M / range_per_sample_m * np.arange(columns), samples)


def range_per_sample(frame: EchoFrame, c_m_s: float) -> float:
    """Metres of range from sample to sample."""
    return c_m_s / (2.0 * iq_rate_hz(frame.fop_hz, frame.odr))


@dataclass(frozen=True, eq=False)
class LongImage:
    """`iq` complex64 (M, columns), oldest row first; `rows` as of `EchoImage`; `trigger` of the newest row."""

    iq: NDArray[np.complex64]
    rows: int
    trigger: int


def columns_of(recorded: RecordedFrames, c_m_s: float, range_per_sample_m: float | None = None) -> int:
    """Columns to the end of the longest record, RANGE_COLUMNS at least.

    Raises:
        UsageError: a record longer than LONGEST_M.
    """
    record_m = max((len(f.iq) - 1) * (range_per_sample_m or range_per_sample(f, c_m_s)) for f in recorded.frames)
    if record_m > LONGEST_M:
        raise UsageError(f"{recorded.path}: records would reach {record_m:.1f} m (limit {LONGEST_M:g} m): check "
                         "--columns-m, the range from sample to sample")
    return max(RANGE_COLUMNS, int(record_m / COLUMN_M) + 1)


def images(recorded: RecordedFrames, c_m_s: float, range_per_sample_m: float | None = None) -> Iterator[LongImage]:
    """The image after each frame that is a measurement; the arrays change with the next one.

    Lost triggers become rows of zeros, as in `EchoImage`. Frames that are left out (repeated, before take-off) give no
    row and no image: a repeated frame is no new evidence, and counting it twice would make noise look steady.
    """
    columns = columns_of(recorded, c_m_s, range_per_sample_m)
    history = np.zeros((HISTORY_ROWS, columns), dtype=np.complex64)
    rows, last = 0, None
    for frame in recorded.frames:
        step = 1 if last is None else (frame.trigger - last) & 0xFFFFFFFF
        last = frame.trigger
        if step >= 0x80000000:  # the rig has restarted: a new image
            history[:], rows, step = 0, 0, 1
        missing = min(step - 1, HISTORY_ROWS) if rows else 0
        new = missing + (frame.trigger not in recorded.left_out)
        if new:
            history[:-new or None] = history[new:].copy() if new < HISTORY_ROWS else 0
            history[-new:] = 0
            rows = min(rows + new, HISTORY_ROWS)
        if frame.trigger in recorded.left_out:
            continue
        step_m = range_per_sample_m or range_per_sample(frame, c_m_s)
        plan = long_plan(step_m, len(frame.iq), columns)
        resample_into(frame.iq, plan, 1.0 / FULL_SCALE, history[-1])
        yield LongImage(history, rows, frame.trigger)


def window_starts(columns: int) -> list[int]:
    """First columns of the windows that cover `columns`, evenly spread, at most STRIDE apart."""
    beyond = columns - RANGE_COLUMNS
    count = ceil(beyond / STRIDE) + 1
    return [round(k * beyond / max(count - 1, 1)) for k in range(count)]


def stitched_row(first: Denoiser, further: Denoiser, image: LongImage) -> tuple[NDArray[np.float32], float]:
    """Edge row over all columns, and the seconds of all its windows together.

    Args:
        first: for the window at the transmitter, with its ring-down left out.
        further: for the windows beyond, which have none.

    Each column is taken from the window where it is farthest from the ends.
    """
    columns = image.iq.shape[1]
    starts = window_starts(columns)
    row = np.zeros(columns, dtype=np.float32)
    seconds = 0.0
    for k, start in enumerate(starts):
        iq = np.ascontiguousarray(image.iq[:, start:start + RANGE_COLUMNS])
        part, spent = timed_row(first if k == 0 else further, ArrayImage(iq, np.abs(iq), image.rows))
        low = 0 if k == 0 else _middle(starts[k - 1], start)
        high = columns if k == len(starts) - 1 else _middle(start, starts[k + 1])
        row[low:high] = part[low - start:high - start]
        seconds += spent
    return row, seconds


def _middle(start: int, following: int) -> int:
    """First column that is nearer to the middle of the window at `following`."""
    return (start + following + RANGE_COLUMNS) // 2
