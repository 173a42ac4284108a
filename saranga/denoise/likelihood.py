"""Log-likelihood of "an echo peaks here" for every cell of an echo image.

Along range the complex samples are filtered by w = (R + load I)^-1 p, where p is the pulse and R the noise's own
autocorrelation, estimated from the image: a matched filter in white noise, and a whitened one in the coloured noise
of propellers (where the plain matched filter would lose 1.5 dB against no filter at all). From row to row nothing is
assumed about phase. With q the power over the row's noise floor, an echo of amplitude A (in noise RMS) gives the
log-likelihood ratio ln I0(2 A sqrt(q)) - A^2 (Rice against Rayleigh), for the design amplitude A.

Recordings of amplitudes alone (imaginary part 0 everywhere) cannot be filtered so: their noise would have one degree
of freedom instead of two. There q is the square of the amplitude itself over the row's noise floor. Such recordings
may hold means of several cycles, whose noise scatters less than a single cycle's: the scatter seen in the image is
stretched to that of a single one, and faint echoes with it.
"""

import numpy as np
from numba import njit

TAP_STEP = 2
TAPS = 13
"""Filter taps, every second column: 25 columns, +-3.4 s of the pulse."""
REACH = (TAPS // 2) * TAP_STEP
"""Columns at each end of what was measured where the filter lacks half its input: no evidence there."""
DESIGN_AMPLITUDE = 1.2
"""Echo amplitude in noise RMS that the evidence is weighed for: faint, with a long history."""
_LOADING = 0.03
"""White noise added to the estimate, share of its power: keeps the inverse tame (the pulse is only known so well).
Where pulse and noise have one band, 0.1 finds 7 points less at 0 dB; where they have not, both find the same."""
_FLOOR_ROWS = 2
"""The noise floor of a row is the mean of its own and of so many on each side: one median scatters by a tenth, and
propellers do not change within 0.1 s."""
_FLOOR = 2.5e-3
"""The noise floor is at least this share of a row's highest power (-26 dB): the pulse's shape is not known better."""
_POWER_CAP = 1.0 / _FLOOR
_LN2 = float(np.log(2.0))
_LOW_SHARE = 0.1587
_RAYLEIGH_SCATTER = 1.0 - float(np.sqrt(-np.log(1.0 - _LOW_SHARE) / _LN2))
"""(median - 16 % point) / median of a Rayleigh envelope: 0.50. Below the median echoes hardly count."""


@njit(cache=True)
def usable_rows(iq, rows):  # type: ignore[no-untyped-def]
    """(M,) True where a row was measured: within the history, finite, not all zero."""
    m, n = iq.shape
    usable = np.zeros(m, dtype=np.bool_)
    for k in range(max(m - rows, 0), m):
        power = 0.0
        for c in range(n):
            power += iq[k, c].real * iq[k, c].real + iq[k, c].imag * iq[k, c].imag
        usable[k] = power > 0.0 and power < np.inf
    return usable


@njit(cache=True)
def whitened_taps(iq, usable, pulse_sigma, blank):  # type: ignore[no-untyped-def]
    """(TAPS,) real filter taps at every TAP_STEP columns, from the image's autocorrelation along range."""
    m, n = iq.shape
    lags = np.zeros(TAPS)
    for k in range(m):
        if not usable[k]:
            continue
        power = np.zeros(TAPS)
        for lag in range(TAPS):
            s = np.float32(0.0)
            for c in range(blank, n - TAPS * TAP_STEP, 4):
                a = iq[k, c]
                b = iq[k, c + lag * TAP_STEP]
                s += a.real * b.real + a.imag * b.imag
            power[lag] = s
        if power[0] > 0.0 and np.abs(power).max() <= power[0]:  # else: an echo half over the end of the sum
            lags += power / power[0]
    matrix = np.zeros((TAPS, TAPS))
    template = np.zeros(TAPS)
    for i in range(TAPS):
        x = (i - TAPS // 2) * TAP_STEP / pulse_sigma
        template[i] = np.exp(-0.5 * x * x)
        for j in range(TAPS):
            matrix[i, j] = lags[abs(i - j)] / max(lags[0], 1e-12)
        matrix[i, i] = 1.0 + _LOADING
    taps = np.linalg.solve(matrix, template)
    return (taps / np.abs(taps).sum()).astype(np.float32)


@njit(cache=True)
def filter_row(x, taps, out):  # type: ignore[no-untyped-def]
    """out[c] = sum of taps[t] x[c + t TAP_STEP]; x reaches REACH columns over both ends of out."""
    out[:] = 0.0
    for t in range(taps.size):
        w = taps[t]
        at = t * TAP_STEP
        for c in range(out.size):
            out[c] += w * x[c + at]


@njit(cache=True)
def filtered_power(iq, usable, taps, blank):  # type: ignore[no-untyped-def]
    """(M, N) power over each row's noise floor (mean 1 in noise), 0 in unusable rows."""
    m, n = iq.shape
    out = np.zeros((m, n), dtype=np.float32)
    re = np.zeros(n + 2 * REACH, dtype=np.float32)
    im = np.zeros(n + 2 * REACH, dtype=np.float32)
    fr = np.zeros(n, dtype=np.float32)
    fi = np.zeros(n, dtype=np.float32)
    highest = np.zeros(m, dtype=np.float32)
    floors = np.zeros(m, dtype=np.float32)
    for k in range(m):
        if not usable[k]:
            continue
        for c in range(n):
            keep = c >= blank
            re[c + REACH] = iq[k, c].real if keep else np.float32(0.0)
            im[c + REACH] = iq[k, c].imag if keep else np.float32(0.0)
        filter_row(re, taps, fr)
        filter_row(im, taps, fi)
        for c in range(n):
            out[k, c] = fr[c] * fr[c] + fi[c] * fi[c]
            highest[k] = max(highest[k], out[k, c])
        floors[k] = np.median(out[k, blank + REACH:n - REACH:2]) / np.float32(np.log(2.0))
    for k in range(m):
        if not usable[k]:
            continue
        total, rows = np.float32(0.0), np.float32(0.0)
        for i in range(max(k - _FLOOR_ROWS, 0), min(k + _FLOOR_ROWS + 1, m)):
            if usable[i]:
                total += floors[i]
                rows += np.float32(1.0)
        floor = max(total / rows, np.float32(_FLOOR) * highest[k])
        scale = np.float32(1.0) / floor if floor > 0.0 else np.float32(0.0)
        for c in range(n):
            out[k, c] *= scale
    return out


@njit(cache=True)
def has_phase(iq, usable):  # type: ignore[no-untyped-def]
    """Whether any usable row has an imaginary part."""
    for k in range(iq.shape[0]):
        if usable[k]:
            for c in range(iq.shape[1]):
                if iq[k, c].imag != 0.0:
                    return True
    return False


@njit(cache=True)
def amplitude_power(iq, usable, blank):  # type: ignore[no-untyped-def]
    """(M, N) |iq|^2 over each row's noise floor (mean 1 in noise), 0 in unusable rows and before `blank`."""
    m, n = iq.shape
    out = np.zeros((m, n), dtype=np.float32)
    scatter = np.empty(m)
    rows = 0
    for k in range(m):
        if not usable[k]:
            continue
        for c in range(blank, n):
            out[k, c] = np.hypot(iq[k, c].real, iq[k, c].imag)
        ordered = np.sort(out[k, blank:n:2])
        middle = ordered[ordered.size // 2]
        if middle > 0.0:
            scatter[rows] = 1.0 - ordered[int(_LOW_SHARE * ordered.size)] / middle
            rows += 1
            out[k] /= middle
        else:
            out[k] = 0.0
    if rows == 0:
        return out
    stretch = np.float32(max(_RAYLEIGH_SCATTER / max(np.median(scatter[:rows]), 0.05), 1.0))
    for k in range(m):
        if not usable[k]:
            continue
        highest = np.float32(0.0)
        for c in range(blank, n):
            a = max(np.float32(1.0) + (out[k, c] - np.float32(1.0)) * stretch, np.float32(0.0))
            out[k, c] = a * a * np.float32(_LN2)
            highest = max(highest, out[k, c])
        scale = np.float32(1.0) / max(np.float32(_FLOOR) * highest, np.float32(1.0))
        for c in range(blank, n):
            out[k, c] *= scale
    return out


@njit(cache=True)
def power_over_noise(iq, usable, with_phase, pulse_sigma, blank):  # type: ignore[no-untyped-def]
    """(M, N) power over the noise, filtered where the phase is known."""
    if with_phase:
        return filtered_power(iq, usable, whitened_taps(iq, usable, pulse_sigma, blank), blank)
    return amplitude_power(iq, usable, blank)


@njit(cache=True)
def log_likelihood_table(amplitude):  # type: ignore[no-untyped-def]
    """ln I0(2 A sqrt(q)) - A^2 for q = 0, 1/16, 2/16 ... up to the cap."""
    size = int(_POWER_CAP * 16) + 1
    table = np.empty(size, dtype=np.float32)
    for i in range(size):
        x = 2.0 * amplitude * np.sqrt(i / 16.0)
        total = 1.0
        term = 1.0
        j = 1
        while term > 1e-12 * total:
            term *= (0.5 * x / j) ** 2
            total += term
            j += 1
        table[i] = np.log(total) - amplitude * amplitude
    return table


@njit(cache=True)
def log_likelihood(power, usable, table, blank):  # type: ignore[no-untyped-def]
    """(M, N) float32; 0 (no evidence) in unusable rows and where the filter lacks input."""
    m, n = power.shape
    out = np.zeros((m, n), dtype=np.float32)
    last = table.size - 1
    for k in range(m):
        if not usable[k]:
            continue
        for c in range(blank + REACH, n - REACH):
            at = min(int(power[k, c] * np.float32(16.0) + np.float32(0.5)), last)
            out[k, c] = table[at]
    return out
