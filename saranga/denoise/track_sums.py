"""Sums of evidence along quadratic range tracks that end in the newest row, for all of them at once.

A track is the column of an echo as a function of age k in rows (0 newest): c(k) = c0 + v k + a k^2 / 2, v > 0 closing.
Its score over the newest 1, 2, 3 or 4 blocks of rows is the sum of log-likelihoods along it, less the price of
acceleration a^2 / (2 ACCEL_SIGMA^2).

Straight pieces within blocks are summed once per (block, slope, column) and shared by all tracks through them: 6
million additions instead of 28. They are of 16-bit integers, in units of UNIT, of which a vector register holds twice
as many as of floats. How fine the grid is decides what is found at 0 dB: with every second column, speeds of 0.25 and
accelerations of 0.1 columns a row it is 6 of 100 obstacles less.
"""

import numpy as np
from numba import njit

UNIT = 1.0 / 16.0
"""Of a log-likelihood: 32 rows of the highest one (likelihood, power cap) come to 22 400 of 32 767 units."""
BLOCKS = 4
BLOCK = 8
"""Rows of a straight piece: at 1.5 m/s2 it bends by 1.2 columns."""
SLOPE_STEP = 0.25
SPEED_STEP = 0.125
SPEEDS = 192
SPEED_MIN = -4.0 + 0.5 * SPEED_STEP
"""Columns a row; with SPEEDS and SPEED_STEP -0.5 .. 2.5 m/s at 25.6 ms a row."""
SPEED_BINS = 32
_SPEEDS_A_BIN = SPEEDS // SPEED_BINS
ACCEL_STEP = 0.075
ACCEL_MAX = 0.3
"""Columns a row^2: 1.5 m/s2."""
ACCEL_SIGMA = 0.15
_ACCELS = 2 * round(ACCEL_MAX / ACCEL_STEP) + 1
_REACH_ROWS = 28.0
"""Age of the middle of the fourth block, rounded up."""
_SLOPE_MIN = SPEED_MIN - ACCEL_MAX * _REACH_ROWS
_SLOPES = int((SPEEDS * SPEED_STEP + 2.0 * _REACH_ROWS * ACCEL_MAX) / SLOPE_STEP) + 1
_NEVER = np.int16(-30000)


@njit(cache=True)
def scratch_arrays(columns):  # type: ignore[no-untyped-def]
    """Memory for `pieces`: int16 (M + 1, 2, N) for evidence and (BLOCKS * slopes + 1, 2, N) for sums.

    Row r is at [r + 1, 0]; [:, 1] and [0] stay zero and are read where a track leaves the range.
    """
    return (np.zeros((BLOCKS * BLOCK + 1, 2, columns), dtype=np.int16),
            np.zeros((BLOCKS * _SLOPES + 1, 2, columns), dtype=np.int16))


@njit(cache=True)
def nearest(x):  # type: ignore[no-untyped-def]
    """Integer nearest to x."""
    return int(np.floor(x + 0.5))


@njit(cache=True)
def _window(flat, row, n, shift):  # type: ignore[no-untyped-def]
    """(n,) of row `row` from column `shift` on; zero before its first and after its last column."""
    start = (2 * row + 2) * n + min(max(shift, -n), n)
    return flat[start:start + n]


@njit(cache=True)
def _sum_rows(to, flat, n, block, slope):  # type: ignore[no-untyped-def]
    a = _window(flat, BLOCK * block, n, nearest(-3.5 * slope))
    b = _window(flat, BLOCK * block + 1, n, nearest(-2.5 * slope))
    c = _window(flat, BLOCK * block + 2, n, nearest(-1.5 * slope))
    d = _window(flat, BLOCK * block + 3, n, nearest(-0.5 * slope))
    e = _window(flat, BLOCK * block + 4, n, nearest(0.5 * slope))
    f = _window(flat, BLOCK * block + 5, n, nearest(1.5 * slope))
    g = _window(flat, BLOCK * block + 6, n, nearest(2.5 * slope))
    h = _window(flat, BLOCK * block + 7, n, nearest(3.5 * slope))
    for i in range(n):
        to[i] = a[i] + b[i] + c[i] + d[i] + e[i] + f[i] + g[i] + h[i]


@njit(cache=True)
def pieces(evidence, stored, sums):  # type: ignore[no-untyped-def]
    """Sums along straight pieces, by column at the middle of the block; block 0 newest.

    Args:
        evidence: float32 (M, N), M = BLOCKS * BLOCK.
        stored, sums: of `scratch_arrays(N)`; `sums` holds the result.
    """
    m, n = evidence.shape
    for k in range(m):
        row = stored[k + 1, 0]
        newest_first = evidence[m - 1 - k]
        for c in range(n):
            row[c] = np.int16(np.floor(newest_first[c] * np.float32(1.0 / UNIT) + np.float32(0.5)))
    flat = stored.reshape(-1)
    for b in range(BLOCKS):
        # the tracks that reach this block with this slope: |slope - v| <= ACCEL_MAX * age of the middle
        slack = ACCEL_MAX * (b * BLOCK + 0.5 * (BLOCK - 1)) + SLOPE_STEP
        for s in range(_SLOPES):
            slope = _SLOPE_MIN + s * SLOPE_STEP
            if SPEED_MIN - slack <= slope <= SPEED_MIN + SPEEDS * SPEED_STEP + slack:
                _sum_rows(sums[b * _SLOPES + s + 1, 0], flat, n, b, slope)


@njit(cache=True)
def _chain(sums, n, v, a, block):  # type: ignore[no-untyped-def]
    """(n,) sums over the block along tracks of speed v and acceleration a, by column at the newest row."""
    age = block * BLOCK + 0.5 * (BLOCK - 1)
    # the mean of a k^2 / 2 over the block's rows lies (BLOCK^2 - 1) / 24 a above its value at the middle
    shift = nearest(v * age + 0.5 * a * (age * age + (BLOCK * BLOCK - 1) / 12.0))
    return _window(sums, block * _SLOPES + nearest((v + a * age - _SLOPE_MIN) / SLOPE_STEP), n, shift)


@njit(cache=True)
def _price(a):  # type: ignore[no-untyped-def]
    return np.int16(nearest(0.5 * (a / ACCEL_SIGMA) ** 2 / UNIT))


@njit(cache=True)
def _raise_by_one(best, p, price):  # type: ignore[no-untyped-def]
    for c in range(best.size):
        best[c] = max(best[c], np.int16(p[c] - price))


@njit(cache=True)
def _raise_by_two(best, p, q, price):  # type: ignore[no-untyped-def]
    for c in range(best.size):
        best[c] = max(best[c], np.int16(p[c] + q[c] - price))


@njit(cache=True)
def _raise_by_three(best, p, q, r, price):  # type: ignore[no-untyped-def]
    for c in range(best.size):
        best[c] = max(best[c], np.int16(p[c] + q[c] + r[c] - price))


@njit(cache=True)
def _raise_by_four(best, p, q, r, s, price):  # type: ignore[no-untyped-def]
    for c in range(best.size):
        best[c] = max(best[c], np.int16(p[c] + q[c] + r[c] + s[c] - price))


@njit(cache=True)
def best_tracks(sums, best):  # type: ignore[no-untyped-def]
    """Highest score of the tracks of every (blocks used, closing speed, column) bin.

    Shorter tracks are asked for on a coarser grid: every other speed, over two blocks every other acceleration, over
    one none.

    Args:
        sums: from `pieces`.
        best: int16 (BLOCKS, SPEED_BINS, N), in UNIT; overwritten.
    """
    n = best.shape[2]
    flat = sums.reshape(-1)
    best[:] = _NEVER
    for iv in range(SPEEDS):
        v = SPEED_MIN + iv * SPEED_STEP
        bin_ = iv // _SPEEDS_A_BIN
        for ia in range(_ACCELS):
            a = (ia - _ACCELS // 2) * ACCEL_STEP
            price = _price(a)
            p, q = _chain(flat, n, v, a, 0), _chain(flat, n, v, a, 1)
            r, s = _chain(flat, n, v, a, 2), _chain(flat, n, v, a, 3)
            _raise_by_four(best[3, bin_], p, q, r, s, price)
            if iv % 2 == 0:
                _raise_by_three(best[2, bin_], p, q, r, price)
                if ia % 2 == 0:
                    _raise_by_two(best[1, bin_], p, q, price)
                if a == 0.0:
                    _raise_by_one(best[0, bin_], p, price)


@njit(cache=True)
def track_at(sums, column):  # type: ignore[no-untyped-def]
    """(v, a, blocks used) of the highest track that ends at `column`."""
    n = sums.shape[2]
    flat = sums.reshape(-1)
    best = np.int64(_NEVER)
    found_v = 0.0
    found_a = 0.0
    used = 1
    for iv in range(SPEEDS):
        v = SPEED_MIN + iv * SPEED_STEP
        for ia in range(_ACCELS):
            a = (ia - _ACCELS // 2) * ACCEL_STEP
            total = -np.int64(_price(a))
            for b in range(BLOCKS):
                total += _chain(flat, n, v, a, b)[column]
                if total > best:
                    best = total
                    found_v, found_a, used = v, a, b + 1
    return found_v, found_a, used
