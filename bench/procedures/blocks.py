"""Intervals from blocks: a block, mounted and run anew, is the unit that repeats; frames within one are not.

With three blocks a percentile bootstrap is far too narrow (it covers about two thirds of what it claims). So the
bootstrap by block only gives the standard error of a statistic, which is widened by sqrt(B / (B - 1)) and multiplied
by Student's quantile at B - 1 degrees of freedom. For a mean this is exactly Student's interval.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000
EXACT_BLOCKS = 4
"""Up to here all B^B resamples are taken (256), so that the result does not hang on a seed."""
Block = TypeVar("Block")


@dataclass(frozen=True)
class Estimate:
    """A value and its interval; no interval (None) from a single block."""

    value: float
    low: float | None
    high: float | None
    blocks: int
    deviation: float | None = None
    """Standard deviation from block to block."""

    @property
    def interval(self) -> list[float] | None:
        """[low, high], None without."""
        return None if self.low is None or self.high is None else [self.low, self.high]

    @property
    def half_width(self) -> float:
        """Infinite without an interval."""
        return math.inf if self.low is None or self.high is None else 0.5 * (self.high - self.low)

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval lies on one side of zero; False without an interval."""
        return self.low is not None and self.high is not None and (self.low > 0.0 or self.high < 0.0)


def student_quantile(blocks: int, confidence: float = CONFIDENCE) -> float:
    """Two-sided quantile at `blocks` - 1 degrees of freedom; infinite for a single block."""
    if blocks < 2:
        return math.inf
    from scipy.special import stdtrit

    return float(stdtrit(blocks - 1, 0.5 + confidence / 2.0))


def mean_of_blocks(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """Mean over blocks with Student's interval.

    Raises:
        ValueError: no value, or one that is not finite.
    """
    data = np.asarray(values, dtype=np.float64)
    if data.size == 0 or not np.isfinite(data).all():
        raise ValueError(f"block values {list(values)}: at least one, all finite")
    value = float(data.mean())
    if data.size == 1:
        return Estimate(value, None, None, 1)
    deviation = float(data.std(ddof=1))
    half = student_quantile(data.size, confidence) * deviation / math.sqrt(data.size)
    return Estimate(value, value - half, value + half, int(data.size), deviation)


def bootstrap_blocks(blocks: Sequence[Block], statistic: Callable[[Sequence[Block]], float], seed: int = 0,
                     confidence: float = CONFIDENCE) -> Estimate:
    """Any statistic of the blocks, with an interval by resampling whole blocks.

    A resample on which the statistic fails or is not finite is left out; fewer than half left: no interval.

    Raises:
        ValueError: no block.
    """
    if not blocks:
        raise ValueError("no block to take a statistic of")
    value = statistic(blocks)
    count = len(blocks)
    if count == 1:
        return Estimate(value, None, None, 1)
    if count <= EXACT_BLOCKS:
        picks = list(itertools.product(range(count), repeat=count))
    else:
        drawn = np.random.default_rng(seed).integers(0, count, size=(RESAMPLES, count))
        picks = [tuple(row) for row in drawn.tolist()]
    found = []
    for pick in picks:
        try:
            found.append(statistic([blocks[k] for k in pick]))
        except (ValueError, np.linalg.LinAlgError):
            continue
    finite = np.asarray(found, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if finite.size < 0.5 * len(picks):
        return Estimate(value, None, None, count)
    error = float(finite.std()) * math.sqrt(count / (count - 1))
    half = student_quantile(count, confidence) * error
    return Estimate(value, value - half, value + half, count, error * math.sqrt(count))


def blocks_needed(deviation: float, difference: float, confidence: float = CONFIDENCE, most: int = 500) -> int | None:
    """Blocks until Student's half width is below `difference` if the spread stays; None beyond `most`."""
    if not (math.isfinite(deviation) and difference > 0.0):
        return None
    for count in range(2, most + 1):
        if student_quantile(count, confidence) * deviation / math.sqrt(count) < difference:
            return count
    return None
