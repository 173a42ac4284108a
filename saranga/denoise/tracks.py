"""Maximum over quadratic range tracks, in two steps: straight pieces within blocks of rows, then chains of pieces.

A track is the column of an echo as a function of age k in rows (0 newest): c(k) = c0 + v k + a k^2 / 2, v > 0 closing.
Its score is the sum of log-likelihoods along it, over the newest 1, 2, 3 or all 4 blocks, whichever is highest (an
obstacle that appeared late has no history), less a^2 / (2 ACCEL_SIGMA^2).

The highest track is refined to hundredths of a column, its evidence erased, and the search repeated.

Pieces are summed once per (block, slope, column) and shared by all tracks through them: 0.4 M additions instead of
5.6 M.
"""

import numpy as np
from numba import njit

STEP = 2
"""Columns between the cells of the search."""
BLOCK = 8
"""Rows of a straight piece: at 1.5 m/s2 it bends by 1.2 columns."""
SLOPE_STEP = 0.5
SPEED_STEP = 0.25
ACCEL_STEP = 0.1
SPEED_MIN, SPEED_MAX = -4.0, 19.75
"""Columns a row: -0.5 .. 2.5 m/s at 25.6 ms a row."""
ACCEL_MAX = 0.3
"""Columns a row^2: 1.5 m/s2."""
ACCEL_SIGMA = 0.15
FADED = 0.3
"""A track whose power in the newest block is under this share of its mean is of an obstacle that has gone."""
ERASE_SIGMAS = 2.5
"""Half width of an echo, in widths of the pulse."""
SIDELOBE_REACH = 24.0
SIDELOBE = 0.05
"""Share of a strong echo's power, and columns about it, within which the filter's sidelobes are no other echo."""
_SLOPE_MIN = SPEED_MIN - ACCEL_MAX * 30.0
_SLOPES = int((SPEED_MAX + 30.0 * ACCEL_MAX - _SLOPE_MIN) / SLOPE_STEP) + 1
_SPEEDS = round((SPEED_MAX - SPEED_MIN) / SPEED_STEP) + 1
_ACCELS = 2 * round(ACCEL_MAX / ACCEL_STEP) + 1


@njit(cache=True)
def _round(x):  # type: ignore[no-untyped-def]
    return int(np.floor(x + 0.5))


@njit(cache=True)
def add_shifted(total, row, shift):  # type: ignore[no-untyped-def]
    """total[c] += row[c + shift] where that exists."""
    n = total.size
    first = max(0, -shift)
    last = min(n, n - shift)
    if last <= first:
        return
    to = total[first:last]
    of = row[first + shift:last + shift]
    for i in range(to.size):
        to[i] += of[i]


@njit(cache=True)
def pieces(evidence):  # type: ignore[no-untyped-def]
    """(M / BLOCK, slopes, cells): sums along straight pieces, by column at the middle of the block; block 0 newest."""
    m, n = evidence.shape
    blocks = m // BLOCK
    out = np.zeros((blocks, _SLOPES, n), dtype=np.float32)
    for b in range(blocks):
        # the tracks that reach this block with this slope: |slope - v| <= ACCEL_MAX * age of the middle
        slack = ACCEL_MAX * (b * BLOCK + 0.5 * (BLOCK - 1)) + SLOPE_STEP
        for s in range(_SLOPES):
            slope = _SLOPE_MIN + s * SLOPE_STEP
            if slope < SPEED_MIN - slack or slope > SPEED_MAX + slack:
                continue
            for i in range(BLOCK):
                shift = _round(slope * (i - 0.5 * (BLOCK - 1)) / STEP)
                add_shifted(out[b, s], evidence[m - 1 - b * BLOCK - i], shift)
    return out


@njit(cache=True)
def search(piece):  # type: ignore[no-untyped-def]
    """(cells,) highest track score that ends at each cell of the newest row."""
    blocks, _, n = piece.shape
    best = np.full(n, np.float32(-1e9))
    total = np.zeros(n, dtype=np.float32)
    for ia in range(_ACCELS):
        a = (ia - _ACCELS // 2) * ACCEL_STEP
        penalty = np.float32(0.5 * (a / ACCEL_SIGMA) ** 2)
        for iv in range(_SPEEDS):
            v = SPEED_MIN + iv * SPEED_STEP
            total[:] = -penalty
            for b in range(blocks):
                shift, s = _link(v, a, b)
                add_shifted(total, piece[b, s], shift)
                for c in range(n):
                    best[c] = total[c] if total[c] > best[c] else best[c]
    return best


@njit(cache=True)
def _link(v, a, b):  # type: ignore[no-untyped-def]
    """Cell shift from the newest row to the middle of block b, and the slope there."""
    age = b * BLOCK + 0.5 * (BLOCK - 1)
    # the mean of a k^2 / 2 over the block's rows lies (BLOCK^2 - 1) / 24 a above its value at the middle
    shift = _round((v * age + 0.5 * a * (age * age + (BLOCK * BLOCK - 1) / 12.0)) / STEP)
    return shift, _round((v + a * age - _SLOPE_MIN) / SLOPE_STEP)


@njit(cache=True)
def track_at(piece, cell):  # type: ignore[no-untyped-def]
    """(v, a, blocks used) of the highest track that ends at `cell`."""
    blocks, _, n = piece.shape
    best = -1e9
    found_v = 0.0
    found_a = 0.0
    used = 1
    for ia in range(_ACCELS):
        a = (ia - _ACCELS // 2) * ACCEL_STEP
        for iv in range(_SPEEDS):
            v = SPEED_MIN + iv * SPEED_STEP
            total = -0.5 * (a / ACCEL_SIGMA) ** 2
            for b in range(blocks):
                shift, s = _link(v, a, b)
                if 0 <= cell + shift < n:
                    total += piece[b, s, cell + shift]
                if total > best:
                    best = total
                    found_v, found_a, used = v, a, b + 1
    return found_v, found_a, used


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
        c = _round(c0 + v * k + 0.5 * a * k * k)
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
def erase(evidence, step, power, c0, v, a, near):  # type: ignore[no-untyped-def]
    """Take the evidence of a found track away, so that nothing else is built from it.

    All of it within `near` columns; within SIDELOBE_REACH what is under SIDELOBE times the row's power on the track.
    `evidence` has a cell every `step` columns.
    """
    m, n = evidence.shape
    for k in range(m):
        middle = c0 + v * k + 0.5 * a * k * k
        row = m - 1 - k
        if not -SIDELOBE_REACH < middle < n * step + SIDELOBE_REACH:
            continue
        limit = np.float32(0.0)
        for c in range(max(0, int(middle) - 2), min(power.shape[1], int(middle) + 4)):
            limit = max(limit, np.float32(SIDELOBE) * power[row, c])
        first = max(0, int(np.floor((middle - SIDELOBE_REACH) / step)))
        last = min(n - 1, int(np.ceil((middle + SIDELOBE_REACH) / step)))
        for c in range(first, last + 1):
            if abs(c * step - middle) <= near or power[row, c * step] < limit:
                evidence[row, c] = min(evidence[row, c], np.float32(0.0))


@njit(cache=True)
def _amplitude_field(power, c0, v, a, rows):  # type: ignore[no-untyped-def]
    """(M, N) log-likelihood of an echo as strong as the track's, uncapped: ln I0 has the shape 2 sqrt(1 + A^2 q)."""
    m, n = power.shape
    total = 0.0
    for k in range(rows):
        c = _round(c0 + v * k + 0.5 * a * k * k)
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
    coarse = evidence[:, ::STEP].copy()
    near = ERASE_SIGMAS * sigma
    found = np.empty((most, 2))
    count = 0
    for _ in range(most):
        piece = pieces(coarse)
        best = search(piece)
        cell = np.argmax(best)
        if best[cell] < lowest:
            break
        v, a, used = track_at(piece, cell)
        rows = used * BLOCK
        c0, v, a = climb(evidence, float(cell * STEP), v, a, rows)
        c0, v, a = polish(_amplitude_field(power, c0, v, a, rows), c0, v, a, rows)
        if is_sound(evidence, power, c0, v, a, rows, 0.5 * lowest) and not _taken(found, count, c0, near):
            found[count, 0] = c0
            found[count, 1] = best[cell]
            count += 1
        erase(coarse, STEP, power, c0, v, a, near)
        erase(evidence, 1, power, c0, v, a, near)
    return found[:count]
