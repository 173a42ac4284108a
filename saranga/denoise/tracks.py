"""Track-before-detect's tracks one by one: the highest of `track_sums`, refined, erased, and again.

Refined to hundredths of a column on the evidence itself. A track counts if it stands without its loudest row and is
still there in the newest rows: an obstacle that appeared late has no history, one that has gone only that.
"""

import numpy as np
from numba import njit

from saranga.denoise.track_sums import (
    ACCEL_SIGMA,
    BLOCK,
    BLOCKS,
    SPEED_BINS,
    UNIT,
    best_tracks,
    nearest,
    pieces,
    scratch_arrays,
    track_at,
)

FADED = 0.3
"""A track whose power in the newest block is under this share of its mean is of an obstacle that has gone."""
ERASE_SIGMAS = 2.5
"""Half width of an echo, in widths of the pulse."""
SIDELOBE_REACH = 24.0
SIDELOBE = 0.05
"""Share of a strong echo's power, and columns about it, within which the filter's sidelobes are no other echo."""


@njit(cache=True)
def _cubic(row, c):  # type: ignore[no-untyped-def]
    """Value, slope and curvature of a row at column c (Catmull-Rom); flat beyond its ends."""
    i = int(np.floor(c))
    if i < 1 or i + 2 >= row.size:
        return 0.0, 0.0, 0.0
    t = c - i
    a, b, d, e = float(row[i - 1]), float(row[i]), float(row[i + 1]), float(row[i + 2])
    k1 = 0.5 * (d - a)
    k2 = a - 2.5 * b + 2.0 * d - 0.5 * e
    k3 = 1.5 * (b - d) + 0.5 * (e - a)
    return b + t * (k1 + t * (k2 + t * k3)), k1 + t * (2.0 * k2 + t * 3.0 * k3), 2.0 * k2 + 6.0 * k3 * t


@njit(cache=True)
def score(field, c0, v, a, rows):  # type: ignore[no-untyped-def]
    """Sum of a field (M, N) along a track over the newest rows, less the price of acceleration."""
    m = field.shape[0]
    total = -0.5 * (a / ACCEL_SIGMA) ** 2
    for k in range(rows):
        value, _, _ = _cubic(field[m - 1 - k], c0 + v * k + 0.5 * a * k * k)
        total += value
    return total


@njit(cache=True)
def climb(field, c0, v, a, rows):  # type: ignore[no-untyped-def]
    """Pattern search to within half a column: moves the ends and the middle of the track independently."""
    span = float(rows - 1)
    mid = 0.5 * span
    p = np.array([c0, c0 + v * mid + 0.5 * a * mid * mid, c0 + v * span + 0.5 * a * span * span])
    best = score(field, c0, v, a, rows)
    size = 2.0
    while size > 0.4:
        improved = False
        for axis in range(3):
            for direction in (-1.0, 1.0):
                q = p.copy()
                q[axis] += direction * size
                qa = 4.0 * (q[0] - 2.0 * q[1] + q[2]) / (span * span)
                qv = (q[2] - q[0]) / span - 0.5 * qa * span
                here = score(field, q[0], qv, qa, rows)
                if here > best:
                    best, p, v, a, improved = here, q, qv, qa, True
        if not improved:
            size *= 0.5
    return p[0], v, a


@njit(cache=True)
def polish(field, c0, v, a, rows):  # type: ignore[no-untyped-def]
    """Newton's method on the summed field: to hundredths of a column. Falls back on where it started."""
    m = field.shape[0]
    start = score(field, c0, v, a, rows)
    x = np.array([c0, v, a])
    for _ in range(6):
        gradient = np.array([0.0, 0.0, -x[2] / ACCEL_SIGMA**2])
        hessian = np.diag(np.array([1e-3, 1e-3, 1.0 / ACCEL_SIGMA**2]))
        for k in range(rows):
            phi = np.array([1.0, float(k), 0.5 * k * k])
            _, slope, bend = _cubic(field[m - 1 - k], x[0] + x[1] * k + 0.5 * x[2] * k * k)
            gradient += slope * phi
            if bend < 0.0:
                hessian -= bend * np.outer(phi, phi)
        step = np.linalg.solve(hessian, gradient)
        limit = abs(step[0])
        if limit > 1.0:
            step /= limit
        x += step
        if limit < 0.005:
            break
    if score(field, x[0], x[1], x[2], rows) < start:
        return c0, v, a
    return x[0], x[1], x[2]


@njit(cache=True)
def is_sound(evidence, power, c0, v, a, rows, lowest):  # type: ignore[no-untyped-def]
    """Whether a track stands without its loudest row, and is still there in the newest block."""
    m, n = evidence.shape
    total = loudest = 0.0
    newest_power = all_power = 0.0
    newest_rows = all_rows = 0
    for k in range(rows):
        c = nearest(c0 + v * k + 0.5 * a * k * k)
        if not 0 <= c < n or power[m - 1 - k, c] == 0.0:
            continue
        here = evidence[m - 1 - k, c]
        total += here
        loudest = max(loudest, here)
        all_power += power[m - 1 - k, c]
        all_rows += 1
        if k < BLOCK:
            newest_power += power[m - 1 - k, c]
            newest_rows += 1
    if newest_rows == 0 or total - loudest < lowest:
        return False
    return newest_power / newest_rows >= FADED * all_power / all_rows


@njit(cache=True)
def erase(evidence, power, c0, v, a, near):  # type: ignore[no-untyped-def]
    """Take the evidence of a found track away, so that nothing else is built from it.

    All of it within `near` columns; within SIDELOBE_REACH what is under SIDELOBE times the row's power on the track.
    """
    m, n = evidence.shape
    for k in range(m):
        middle = c0 + v * k + 0.5 * a * k * k
        row = m - 1 - k
        if not -SIDELOBE_REACH < middle < n + SIDELOBE_REACH:
            continue
        limit = np.float32(0.0)
        for c in range(max(0, int(middle) - 2), min(n, int(middle) + 4)):
            limit = max(limit, np.float32(SIDELOBE) * power[row, c])
        first = max(0, int(np.floor(middle - SIDELOBE_REACH)))
        last = min(n - 1, int(np.ceil(middle + SIDELOBE_REACH)))
        for c in range(first, last + 1):
            if abs(c - middle) <= near or power[row, c] < limit:
                evidence[row, c] = min(evidence[row, c], np.float32(0.0))


@njit(cache=True)
def _amplitude_field(power, c0, v, a, rows):  # type: ignore[no-untyped-def]
    """(M, N) log-likelihood of an echo as strong as the track's, uncapped: ln I0 has the shape 2 sqrt(1 + A^2 q)."""
    m, n = power.shape
    total = 0.0
    for k in range(rows):
        c = nearest(c0 + v * k + 0.5 * a * k * k)
        if 0 <= c < n:
            total += power[m - 1 - k, c]
    strength = np.float32(max(total / rows - 1.0, 0.25))
    return np.float32(2.0) * np.sqrt(np.float32(1.0) + strength * power)


@njit(cache=True)
def _taken(found, count, column, apart):  # type: ignore[no-untyped-def]
    taken = False
    for i in range(count):
        taken = taken or abs(found[i, 0] - column) < apart
    return taken


@njit(cache=True)
def _highest(best):  # type: ignore[no-untyped-def]
    at = np.argmax(best)
    return at % best.shape[2], best.reshape(-1)[at]


@njit(cache=True)
def find(evidence, power, sigma, most, lowest):  # type: ignore[no-untyped-def]
    """Tracks by falling score.

    Args:
        evidence: float32 (M, N) log-likelihood a cell; changed (the tracks found are erased from it).
        power: float32 (M, N) power over the noise floor.
        sigma: width of the pulse in columns.
        most, lowest: stop after so many tracks or under this score.

    Returns:
        (k, 2): column at the newest row, score.
    """
    n = evidence.shape[1]
    stored, sums = scratch_arrays(n)
    best = np.empty((BLOCKS, SPEED_BINS, n), dtype=np.int16)
    near = ERASE_SIGMAS * sigma
    found = np.empty((most, 2))
    count = 0
    for _ in range(most):
        pieces(evidence, stored, sums)
        best_tracks(sums, best)
        column, highest = _highest(best)
        if highest * UNIT < lowest:
            break
        v, a, used = track_at(sums, column)
        rows = used * BLOCK
        c0, v, a = climb(evidence, float(column), v, a, rows)
        c0, v, a = polish(_amplitude_field(power, c0, v, a, rows), c0, v, a, rows)
        if is_sound(evidence, power, c0, v, a, rows, 0.5 * lowest) and not _taken(found, count, c0, near):
            found[count, 0] = c0
            found[count, 1] = highest * UNIT
            count += 1
        erase(evidence, power, c0, v, a, near)
    return found[:count]
