"""From echoes to images: sparse responses added to a row, noise from the bank, envelope, label.

Noise is not turned by its random phase: the echoes are, the other way, which is the same for the envelope and free.
"""

import math

import numpy as np
from numba import njit

from saranga.synthesis.counter_rng import below, start_stream, unit
from saranga.synthesis.noise_bank import BANK_UNIT
from saranga.synthesis.responses import PHASES, RESPONSE_UNIT
from saranga.synthesis.scene import (
    BAND,
    COUNT,
    DRIFT,
    FIRST_ROW,
    LEVEL,
    MODEL,
    MULTIPLICATIVE,
    RING,
    VARIANT,
    draw_scene,
    scratch,
)

SCENE_CHANNEL = 0
NOISE_CHANNEL = 16
_NEPER = math.log(10.0) / 20.0
_TURN = 2.0 * math.pi


@njit(cache=True)
def add_response(  # type: ignore[no-untyped-def]
    re, im, table_re, table_im, first, past, lead, column, height, turns
):
    """Add entries `first` to `past` of R (PHASES, T), its leading edge at `column` (any fraction), times `height` and
    exp(2j pi turns)."""
    n = math.floor(column)
    q = math.floor((column - n) * PHASES + 0.5)
    if q == PHASES:
        q = 0
        n += 1
    a = np.float32(height * RESPONSE_UNIT * math.cos(_TURN * turns))
    b = np.float32(height * RESPONSE_UNIT * math.sin(_TURN * turns))
    start = n - lead
    low, high = max(first, -start), min(past, re.shape[0] - start)
    if low >= high:
        return
    # Slices, so that no index can be negative: only then are the loops turned into vector instructions.
    target_re, target_im = re[start + low:start + high], im[start + low:start + high]
    source_re, source_im = table_re[q, low:high], table_im[q, low:high]
    for j in range(high - low):
        x, y = np.float32(source_re[j]), np.float32(source_im[j])
        target_re[j] += a * x - b * y
        target_im[j] += a * y + b * x


@njit(cache=True)
def envelope_in_noise(re, im, row_re, row_im, offset, rms, limit, out):  # type: ignore[no-untyped-def]
    """|re + j im + rms * row|, at most `limit`; the periodic row is read around from `offset`."""
    g = np.float32(rms * BANK_UNIT)
    done = 0
    while done < re.shape[0]:
        n = min(row_re.shape[0] - offset, re.shape[0] - done)
        clean_re, clean_im, target = re[done:done + n], im[done:done + n], out[done:done + n]
        noise_re, noise_im = row_re[offset:offset + n], row_im[offset:offset + n]
        for k in range(n):
            x = clean_re[k] + g * np.float32(noise_re[k])
            y = clean_im[k] + g * np.float32(noise_im[k])
            size = np.sqrt(x * x + y * y)
            target[k] = size if size < limit else limit
        done += n
        offset = 0


@njit(cache=True)
def complex_in_noise(re, im, row_re, row_im, offset, rms, envelope, turns, iq):  # type: ignore[no-untyped-def]
    """The same row complex, turned by `turns` back to the phase of its echoes, and limited as `envelope` is."""
    g, period = np.float32(rms * BANK_UNIT), row_re.shape[0]
    a, b = np.float32(math.cos(_TURN * turns)), np.float32(math.sin(_TURN * turns))
    for k in range(re.shape[0]):
        x = re[k] + g * np.float32(row_re[(offset + k) % period])
        y = im[k] + g * np.float32(row_im[(offset + k) % period])
        size = np.sqrt(x * x + y * y)
        f = envelope[k] / size if size > envelope[k] else np.float32(1.0)
        iq[k] = np.complex64(complex(f * (a * x - b * y), f * (a * y + b * x)))


@njit(cache=True)
def hidden_edge(n, delay, gain, tables, variants, count, i):  # type: ignore[no-untyped-def]
    """Whether echo `i` has no edge in eq. 9: the sum of the envelopes, of unit echoes as in eq. 7, stays over tau from
    the nearer echo on."""
    before = -1
    for j in range(count):
        nearer = delay[j] < delay[i] or (delay[j] == delay[i] and j < i)
        if gain[j] > 0.0 and nearer and (before < 0 or delay[j] > delay[before]):
            before = j
    if before < 0:
        return False
    first = math.ceil(delay[before] + tables[3][int(variants[before])])
    last = math.floor(delay[i] + tables[3][int(variants[i])])
    for k in range(first, last + 1):
        total = 0.0
        for j in range(count):
            if gain[j] > 0.0:
                whole = math.floor(k - delay[j])
                q = math.floor((1.0 - (k - delay[j] - whole)) * PHASES)
                entry = int(whole) + 1 + tables[2]
                if q == PHASES:
                    q, entry = 0, entry - 1
                if 0 <= entry < tables[5].shape[2]:
                    total += RESPONSE_UNIT * tables[5][int(variants[j]), q, entry]
        if total < n.merge_level:
            return False
    return True


@njit(cache=True)
def draw_label(label, column, blur):  # type: ignore[no-untyped-def]
    """Mark a leading edge: one column, floor(delay) (eqs 7 and 9), or a Gaussian about the exact delay."""
    if blur == 0.0:
        label[int(column)] = 1.0
        return
    reach = int(4.0 * blur) + 1
    for k in range(max(int(column) - reach, 0), min(int(column) + reach + 2, label.shape[0])):
        x = (k - column) / blur
        label[k] = max(label[k], np.float32(math.exp(-0.5 * x * x)))


@njit(cache=True)
def render(  # type: ignore[no-untyped-def]
    n, state, scene, obstacle, delay, gain, turn, tables, bank, white, re, im, image, label, iq
):
    """One sensor's image (M, N), label (M, N) and, unless it is empty, complex image iq (M, N).

    `tables` is (re, im, lead, rise, extent, size) of the responses; `bank` and `white` are (re, im, starts, banded).
    """
    # Locals, because every look into a tuple within the loop counts its arrays' references up and down.
    rows, newest, limit, p_lost = n.rows, n.rows - 1, np.float32(n.limit), n.lost
    merge, blur, least, profile = n.merge, n.blur, n.least_snr, n.ring_profile
    count, first_row, ring = int(scene[COUNT]), int(scene[FIRST_ROW]), scene[RING]
    newest_level, drift, sigma = scene[LEVEL], _NEPER * scene[DRIFT] / newest, scene[MULTIPLICATIVE]
    table_re, table_im, lead, extent = tables[0], tables[1], tables[2], tables[4]
    white_re = white[0]
    speckle, want_iq = scene[MODEL] == 1.0, iq.shape[0] > 0
    noise = white if speckle else bank
    noise_re, noise_im, starts = noise[0], noise[1], noise[2]
    own = n.own_band > 0.0 and unit(state) < n.own_band
    group = int(scene[BAND]) if noise[3] and not own else below(state, starts.shape[0] - 1)
    group = min(group, starts.shape[0] - 2)
    rows_from, rows_in, period = starts[group], starts[group + 1] - starts[group], noise_re.shape[1]
    variants = obstacle[:, VARIANT]
    ring_turn = unit(state)
    label[:] = 0.0
    for m in range(rows):
        out = image[m]
        level = newest_level * math.exp(drift * (newest - m))
        lost = unit(state) < p_lost and m < newest
        row, offset = rows_from + below(state, rows_in), below(state, period)
        spin, other = unit(state), below(state, white_re.shape[0])
        if m < first_row:
            lost = True
        else:
            for i in range(count):
                if gain[i, m] <= 0.0 or gain[i, m] < least * level:
                    continue
                if not merge or not hidden_edge(n, delay[:, m], gain[:, m], tables, variants, count, i):
                    draw_label(label[m], delay[i, m], blur)
        if lost:
            out[:] = 0.0
            if want_iq:
                iq[m, :] = 0.0
            continue
        re[:] = 0.0
        im[:] = 0.0
        silent = True
        for i in range(count):
            if gain[i, m] > 0.0:
                v = int(variants[i])
                add_response(re, im, table_re[v], table_im[v], extent[v, 0], extent[v, 1], lead, delay[i, m],
                             gain[i, m], turn[i, m] - spin)
                silent = False
        if speckle and not silent:
            multiply_speckle(re, im, white_re[other], sigma)
        if ring > 0.0:
            add_ring(re, im, profile, ring, ring_turn - spin)
        envelope_in_noise(re, im, noise_re[row], noise_im[row], offset, level, limit, out)
        if want_iq:
            complex_in_noise(re, im, noise_re[row], noise_im[row], offset, level, out, spin, iq[m])
    if n.free_scale:
        normalise(image, iq)


@njit(cache=True)
def add_ring(re, im, profile, height, turns):  # type: ignore[no-untyped-def]
    """Add the ring-down, `profile` up to its first 0, times `height` and exp(2j pi turns)."""
    a = np.float32(height * math.cos(_TURN * turns))
    b = np.float32(height * math.sin(_TURN * turns))
    for k in range(re.shape[0]):
        if profile[k] == 0.0:
            break
        re[k] += a * profile[k]
        im[k] += b * profile[k]


@njit(cache=True)
def multiply_speckle(re, im, row, sigma):  # type: ignore[no-untyped-def]
    """Times 1 + eta_m, eta_m real with standard deviation `sigma`; `row` is the real part of a unit complex row."""
    g = np.float32(sigma * math.sqrt(2.0) * BANK_UNIT)
    for k in range(re.shape[0]):
        factor = np.float32(1.0) + g * np.float32(row[k])
        re[k] *= factor
        im[k] *= factor


@njit(cache=True)
def normalise(image, iq):  # type: ignore[no-untyped-def]
    """Divide by the mean of the image."""
    total = 0.0
    for m in range(image.shape[0]):
        for k in range(image.shape[1]):
            total += image[m, k]
    if total <= 0.0:
        return
    f = np.float32(image.size / total)
    for m in range(image.shape[0]):
        for k in range(image.shape[1]):
            image[m, k] *= f
        if iq.shape[0] > 0:
            for k in range(image.shape[1]):
                iq[m, k] *= f


@njit(cache=True, nogil=True)
def fill_scenes(  # type: ignore[no-untyped-def]
    n, seed, first, sensors, channels, tables, bank, white, images, labels, iq, scenes, obstacles, paths_m, snrs_db
):
    """Draw and render scenes `first`, `first` + 1, ...

    Args:
        sensors: (R,) index into n.sensors of each image wanted; channels: (R,) number of its role, which keeps its
            noise the same whichever other sensors are asked for.
        images, labels: float32 (K, R, M, N). iq: complex64 of the same shape, or K = 0.
        scenes (K, SCENE_FIELDS), obstacles (K, 4, OBSTACLE_FIELDS), paths_m and snrs_db (K, S, 4): truth.
    """
    state = np.empty(1, np.uint64)
    delay, gain, turn, shift, fade = scratch(n)
    re, im = np.empty(n.columns, np.float32), np.empty(n.columns, np.float32)
    nothing = np.empty((0, 0), np.complex64)
    for k in range(images.shape[0]):
        start_stream(state, seed, first + k, SCENE_CHANNEL)
        draw_scene(n, state, delay, gain, turn, shift, fade, scenes[k], obstacles[k], paths_m[k], snrs_db[k])
        for r in range(sensors.shape[0]):
            s = sensors[r]
            start_stream(state, seed, first + k, NOISE_CHANNEL + channels[r])
            target = iq[k, r] if iq.shape[0] > 0 else nothing
            render(n, state, scenes[k], obstacles[k], delay[s], gain[s], turn[s], tables, bank, white, re, im,
                   images[k, r], labels[k, r], target)
