"""Which echo in one image is which in the other, and the lag between them: the kernels of `saranga.disparity`."""

import numpy as np
from numba import njit

from saranga.denoise.likelihood import REACH, filter_row, has_phase, usable_rows, whitened_taps

ROWS = 16
"""Newest rows that count, 0.41 s: over longer histories the track is no parabola and the disparity no straight line."""
SPAN = 3.0
"""Columns by which an echo's place may differ from that of its edge, at the middle row."""
_SLOPE_STEP, _SLOPES = 1.0 / 32.0, 65
"""Of l1, columns a row: up to 1.0, which is 2.5 m/s sideways at 1 m and 1.3 m/s at 0.5 m (b = 0.10 m)."""
_SPEED_MIN, _SPEED_STEP, _SPEEDS = -4.0, 0.5, 49
_ACCEL_STEP, _ACCELS = 0.15, 5
"""Of the track, columns a row and a row^2: -0.5..2.5 m/s, +-1.5 m/s2, as `saranga.denoise.track_sums`."""
_MIDDLE = 0.5 * (ROWS - 1)
_SWEEPS = 3
_SLOPE_PRICE = 0.05
"""Share of |S|^2 that a slope of 1 must gain: between one or two rows, as many waves more or less fit as well."""


@njit(cache=True)
def most_coherent(left_iq, other_iq, rows, left, other, limit, late, sigma, turns, blank):  # type: ignore[no-untyped-def]
    """Pairs of edges, the most coherent first, one to one.

    Args:
        left_iq, other_iq: complex64 (M, N), newest row last; the newest ROWS count, of them the newest `rows`.
        left, other: columns of the echoes' peaks in the newest row.
        limit: largest |left - other + late|, in columns.
        sigma: width of the pulse in columns; turns: of the carrier a column; blank: columns of ring-down.

    Returns:
        Lag l0 (NaN: no partner), S, partner (-1: none) and coherence (0: no echo in both), each (n,).
    """
    n, m = left.size, other.size
    lag, total = np.full(n, np.nan), np.zeros(n, np.complex128)
    partner, coherence = np.full(n, -1), np.zeros(n)
    if n == 0 or m == 0:
        return lag, total, partner, coherence
    left_iq, other_iq = left_iq[-ROWS:], other_iq[-ROWS:]
    usable, also = usable_rows(left_iq, rows), usable_rows(other_iq, rows)
    here, there = np.zeros((ROWS, 0), np.complex64), np.zeros((ROWS, 0), np.complex64)
    if (usable & also).any() and has_phase(left_iq, usable) and has_phase(other_iq, also):
        # The same filter for both, or it would delay one of them; every second row is enough to know the noise.
        taps = whitened_taps(left_iq[::2], usable[::2], sigma, blank)
        here, there = _whitened(left_iq, usable, taps, blank), _whitened(other_iq, also, taps, blank)
    level = np.abs(here)
    speed, bend = np.zeros(n), np.zeros(n)
    slope, score = np.zeros((n, m)), np.full((n, m), -1.0)
    for i in range(n):
        speed[i], bend[i] = _track(level, left[i])
        for j in range(m):
            gap = left[i] - other[j]
            if abs(gap + late) <= limit:
                slope[i, j], value = _slope(here, there, left[i], speed[i], bend[i], gap, turns)
                # Where no pair is coherent (dead rows), the one with the least disparity goes first.
                score[i, j] = value + 1e-6 / (1.0 + abs(gap + late))
    for _ in range(min(n, m)):
        best = np.argmax(score)
        i, j = best // m, best % m
        if score[i, j] < 0.0:
            break
        score[i, :] = -1.0
        score[:, j] = -1.0
        partner[i] = j
        lag[i], re, im, coherence[i] = _refine(here, there, left[i], speed[i], bend[i], left[i] - other[j],
                                               slope[i, j], turns)
        total[i] = complex(re, im)
    return lag, total, partner, coherence


@njit(cache=True)
def _whitened(iq, usable, taps, blank):  # type: ignore[no-untyped-def]
    """(ROWS, N) complex64, **newest row first**; 0 in unusable rows; input up to `blank` is left out."""
    n = iq.shape[1]
    out = np.zeros((ROWS, n), np.complex64)
    re, im = np.zeros(n + 2 * REACH, np.float32), np.zeros(n + 2 * REACH, np.float32)
    sum_re, sum_im = np.empty(n, np.float32), np.empty(n, np.float32)
    newest = iq.shape[0] - 1
    for k in range(iq.shape[0]):
        if not usable[newest - k]:
            continue
        row = iq[newest - k]
        for c in range(blank, n):
            re[c + REACH] = row[c].real
            im[c + REACH] = row[c].imag
        filter_row(re, taps, sum_re)
        filter_row(im, taps, sum_im)
        for c in range(n):
            out[k, c] = complex(sum_re[c], sum_im[c])
    return out


@njit(cache=True)
def _track(level, c0):  # type: ignore[no-untyped-def]
    """(v, a) of the track c0 + v k + a k^2 / 2 with the highest sum of amplitudes `level` (ROWS, N)."""
    best, best_v, best_a = np.float32(-1.0), 0.0, 0.0
    n = level.shape[1]
    for i in range(_ACCELS):
        a = _ACCEL_STEP * (i - _ACCELS // 2)
        for j in range(_SPEEDS):
            v = _SPEED_MIN + _SPEED_STEP * j
            total = np.float32(0.0)
            for k in range(ROWS):
                c = int(c0 + v * k + 0.5 * a * k * k + 0.5)
                if 0 <= c < n:
                    total += level[k, c]
            if total > best:
                best, best_v, best_a = total, v, a
    return best_v, best_a


@njit(cache=True)
def _slope(left, other, c0, v, a, l0, turns):  # type: ignore[no-untyped-def]
    """(l1 of the highest |S|, coherence there), by whole columns."""
    heard, column = np.zeros(ROWS, np.complex64), np.empty(ROWS)
    n = other.shape[1]
    p = np.float32(0.0)
    for k in range(ROWS):
        c = c0 + v * k + 0.5 * a * k * k + 0.5
        if 0 <= int(c) < n:
            heard[k] = left[k, int(c)]
        p += heard[k].real ** 2 + heard[k].imag ** 2
        column[k] = c - l0
    best, best_q, found = np.float32(0.0), np.float32(0.0), 0.0
    for i in range(_SLOPES):
        l1 = _SLOPE_STEP * (i - _SLOPES // 2)
        angle = 2.0 * np.pi * turns * l1
        cos1, sin1 = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        cos, sin = np.float32(1.0), np.float32(0.0)
        re = im = q = np.float32(0.0)
        for k in range(ROWS):
            c = int(column[k] - l1 * k)
            if 0 <= c < n:
                u, w = heard[k], other[k, c]
                x, y = u.real * w.real + u.imag * w.imag, u.imag * w.real - u.real * w.imag
                re += x * cos - y * sin
                im += x * sin + y * cos
                q += w.real * w.real + w.imag * w.imag
            cos, sin = cos * cos1 - sin * sin1, cos * sin1 + sin * cos1
        size = re * re + im * im
        size *= np.float32(1.0 - _SLOPE_PRICE * l1 * l1)
        if size > best:
            best, best_q, found = size, q, l1
    return found, np.sqrt(best / (p * best_q)) if p * best_q > 0.0 else 0.0


@njit(cache=True)
def _along(rows, c0, slope, a, out):  # type: ignore[no-untyped-def]
    """out[k] = rows[k] at c0 + slope m + a m^2 / 2, m = k - _MIDDLE, cubic (Catmull-Rom): linear would have every
    maximum at a whole column. The phase of a baseband echo is constant along range, so its parts are smooth."""
    last = rows.shape[1] - 2
    for k in range(ROWS):
        m = k - _MIDDLE
        c = c0 + slope * m + 0.5 * a * m * m
        i = int(c)
        if c < 1.0 or i >= last:
            out[k] = 0.0
            continue
        f = np.float32(c - i)
        f2 = f * f
        f3 = f2 * f
        h = np.float32(0.5)
        b0, b1 = h * (f2 + f2 - f3 - f), h * (f3 + f3 + f3 - np.float32(5.0) * f2) + np.float32(1.0)
        b2, b3 = h * (np.float32(4.0) * f2 - f3 - f3 - f3 + f), h * (f3 - f2)
        x, y, z, w = rows[k, i - 1], rows[k, i], rows[k, i + 1], rows[k, i + 2]
        out[k] = complex(b0 * x.real + b1 * y.real + b2 * z.real + b3 * w.real,
                         b0 * x.imag + b1 * y.imag + b2 * z.imag + b3 * w.imag)


@njit(cache=True)
def _sum(u, w, l1, l2, turns):  # type: ignore[no-untyped-def]
    """(Re, Im) of the sum of u conj(w) exp(2j pi turns (l1 m + l2 m^2 / 2)): S but for the phase of the middle row."""
    angle = 2.0 * np.pi * turns
    first = angle * (-l1 * _MIDDLE + 0.5 * l2 * _MIDDLE * _MIDDLE)
    step, bend = angle * (l1 + 0.5 * l2 * (1.0 - 2.0 * _MIDDLE)), angle * l2
    cos, sin = np.cos(first), np.sin(first)
    cos1, sin1 = np.cos(step), np.sin(step)
    cos2, sin2 = np.cos(bend), np.sin(bend)
    re = im = 0.0
    for k in range(ROWS):
        x, y = u[k].real * w[k].real + u[k].imag * w[k].imag, u[k].imag * w[k].real - u[k].real * w[k].imag
        re += x * cos - y * sin
        im += x * sin + y * cos
        cos, sin = cos * cos1 - sin * sin1, cos * sin1 + sin * cos1
        cos1, sin1 = cos1 * cos2 - sin1 * sin2, cos1 * sin2 + sin1 * cos2
    return re, im


@njit(cache=True)
def _try(left, other, x, axis, u, w, turns):  # type: ignore[no-untyped-def]
    """|S|^2 at x after a change along `axis`; u and w, the echoes along both tracks, are renewed as far as needed."""
    if axis < 3:
        _along(left, x[0], x[1], x[2], u)
    if axis > 0:
        _along(other, x[3], x[1] - x[4], x[2] - x[5], w)
    re, im = _sum(u, w, x[4], x[5], turns)
    return re * re + im * im


@njit(cache=True)
def _refine(left, other, c0, v, a, l0, l1, turns):  # type: ignore[no-untyped-def]
    """Parabola after parabola to the highest |S|; (l0, Re S, Im S, coherence).

    The variables x, about the middle row so that they hardly depend on each other: column in the left image, slope and
    bend of both tracks, column in the other image, slope and bend of the disparity.
    """
    x = np.array([c0 + v * _MIDDLE + 0.5 * a * _MIDDLE**2, v + a * _MIDDLE, a, 0.0, l1, 0.0])
    x[3] = x[0] - l0 - l1 * _MIDDLE
    start = x.copy()
    size = np.array([1.0, 0.15, 0.04, 1.0, 0.5 * _SLOPE_STEP, 0.004])
    u, w = np.empty(ROWS, np.complex64), np.empty(ROWS, np.complex64)
    best = _try(left, other, x, 1, u, w, turns)
    for sweep in range(_SWEEPS + 1):
        for axis in range(0, 6, 3 if sweep == _SWEEPS else 1):  # at last the two columns alone
            here, h = x[axis], size[axis]
            x[axis] = here - h
            below = _try(left, other, x, axis, u, w, turns)
            x[axis] = here + h
            above = _try(left, other, x, axis, u, w, turns)
            bend = below - 2.0 * best + above
            step = h if above > below else -h
            if bend < 0.0:
                step = min(max(0.5 * h * (below - above) / bend, -h), h)
            x[axis] = here + step
            value = _try(left, other, x, axis, u, w, turns)
            if value <= best or abs(x[0] - start[0]) > SPAN or abs(x[3] - start[3]) > SPAN:
                x[axis] = here
                value = _try(left, other, x, axis, u, w, turns)
            best = value
        if sweep > 0:
            size *= 0.5
    re, im = _sum(u, w, x[4], x[5], turns)
    angle = 2.0 * np.pi * turns * (x[0] - x[3])
    cos, sin = np.cos(angle), np.sin(angle)
    p = q = 0.0
    for k in range(ROWS):
        p += u[k].real * u[k].real + u[k].imag * u[k].imag
        q += w[k].real * w[k].real + w[k].imag * w[k].imag
    coherence = np.sqrt(best / (p * q)) if p * q > 0.0 else 0.0
    newest = x[0] - x[3] - x[4] * _MIDDLE + 0.5 * x[5] * _MIDDLE**2
    return newest, re * cos - im * sin, re * sin + im * cos, coherence
