"""Sums along range tracks: every track is found where it lies, and none is made up."""

import numpy as np
import pytest

from saranga.denoise import likelihood
from saranga.denoise.track_sums import (
    ACCEL_SIGMA,
    BLOCK,
    BLOCKS,
    SPEED_BINS,
    UNIT,
    best_tracks,
    pieces,
    scratch_arrays,
    track_at,
)

ROWS, COLUMNS = BLOCKS * BLOCK, 512


def summed(evidence: np.ndarray) -> np.ndarray:
    stored, sums = scratch_arrays(COLUMNS)
    pieces(evidence.astype(np.float32), stored, sums)
    return sums


def best_of(sums: np.ndarray) -> np.ndarray:
    best = np.empty((BLOCKS, SPEED_BINS, COLUMNS), dtype=np.int16)
    best_tracks(sums, best)
    return best * UNIT


def track(c0: float, v: float, a: float, width: float = 2.5) -> np.ndarray:
    """Evidence 1 on a track, falling off as an echo's power does."""
    age = np.arange(ROWS)[::-1, None]
    return np.exp(-0.5 * ((np.arange(COLUMNS) - (c0 + v * age + 0.5 * a * age**2)) / width) ** 2)


@pytest.mark.parametrize("c0", [150.0, 230.5])
@pytest.mark.parametrize("v", [-3.3, 0.0, 1.06, 7.71])
@pytest.mark.parametrize("a", [-0.08, 0.0, 0.13])
def test_a_track_is_found_whole_where_it_ends(c0: float, v: float, a: float) -> None:
    sums = summed(track(c0, v, a))
    best = best_of(sums)[3].max(axis=0)
    price = 0.5 * (a / ACCEL_SIGMA) ** 2
    assert abs(int(np.argmax(best)) - c0) <= 3.0
    assert ROWS * 0.86 - price - 0.3 < best.max() <= ROWS + 0.01
    found_v, found_a, used = track_at(sums, int(np.argmax(best)))
    assert used == BLOCKS
    # place, speed and acceleration make up for each other: the track must be the same, within the echo's width
    age = np.arange(ROWS)
    apart = np.argmax(best) - c0 + (found_v - v) * age + 0.5 * (found_a - a) * age**2
    assert np.abs(apart).mean() < 1.5
    assert np.abs(apart).max() < 5.0


def test_the_speed_bin_is_that_of_the_newest_row() -> None:
    best = best_of(summed(track(150.0, 5.3, 0.0)))
    for depth in range(1, BLOCKS):
        speed, _ = np.unravel_index(np.argmax(best[depth]), best[depth].shape)
        assert abs(-4.0 + 0.75 * (speed + 0.5) - 5.3) < 0.8


def test_fewer_blocks_see_only_the_newest_rows() -> None:
    evidence = track(200.0, 2.0, 0.0)
    evidence[:ROWS - BLOCK] = 0.0
    best = best_of(summed(evidence)).max(axis=(1, 2))
    assert np.all(best <= BLOCK + 0.01)
    assert best[0] > 0.93 * BLOCK
    assert best[3] > 0.9 * BLOCK


def test_no_track_has_more_than_its_rows_hold() -> None:
    rng = np.random.default_rng(1)
    evidence = np.round(rng.uniform(-1.0, 3.0, (ROWS, COLUMNS)) / UNIT) * UNIT
    best = best_of(summed(evidence))
    # rows newest first; a track may choose its column in each, so their maxima bound it
    bound = np.cumsum(np.maximum(evidence[::-1].max(axis=1), 0.0))
    for depth in range(BLOCKS):
        assert best[depth].max() <= bound[BLOCK * (depth + 1) - 1] + 1e-6


def test_beyond_the_range_there_is_no_evidence() -> None:
    best = best_of(summed(np.ones((ROWS, COLUMNS))))
    fastest = best[3, -1]
    # 20 columns a row: at column 200 the track leaves the range after 16 rows, at 0 after 26
    assert fastest[200] <= 2.5 * BLOCK
    assert fastest[0] >= 3.0 * BLOCK
    assert best[3, SPEED_BINS // 6, 100:400].min() == pytest.approx(ROWS, abs=0.1)


def test_the_strongest_evidence_everywhere_does_not_overflow() -> None:
    table = likelihood.log_likelihood_table(likelihood.DESIGN_AMPLITUDE)
    assert best_of(summed(np.full((ROWS, COLUMNS), table.max()))).max() == pytest.approx(ROWS * table.max(), rel=1e-3)
    lowest = best_of(summed(np.full((ROWS, COLUMNS), table.min())))
    assert lowest[3].min() >= ROWS * table.min() - 0.5 * ROWS * UNIT
    assert lowest[3].max() <= 0.0
