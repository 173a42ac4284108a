"""One scene: obstacles and motion drawn, and from them the delay, strength and phase of every echo in every cycle."""

import math

import numpy as np
from numba import njit

from saranga.synthesis.counter_rng import below, between, log_between, near_normal, pick, unit
from saranga.synthesis.paths import (
    ARC,
    COSINE,
    CYLINDER,
    EDGE,
    HOVER,
    PLANE,
    POINT,
    arc_displacement,
    beam,
    cylinder_legs,
    plane_legs,
    point_legs,
    strength,
)

ABSENT_DB = -99.0
"""Stands for no echo in `psnr_db` and `snr_db`, so that truth is finite."""
COUNT, PATH, MODEL, BAND, PSNR, PSNR_IMAGE, LEVEL, FIRST_ROW, DRIFT, MULTIPLICATIVE, RING = range(11)
SCENE_FIELDS = 11
KIND, RANGE, AZIMUTH, ELEVATION, CLOSING, SIZE, VARIANT = range(7)
OBSTACLE_FIELDS = 7
_NEPER = math.log(10.0) / 20.0


@njit(cache=True)
def _move(n, state, kind, ux, uy, shift):  # type: ignore[no-untyped-def]
    """Fill `shift` (M, 2), the vehicle's place relative to the newest cycle; returns its newest velocity."""
    closing, sideways = between(state, n.closing), between(state, n.sideways)
    along, radius = between(state, n.acceleration), between(state, n.radius)
    left = unit(state) < 0.5
    ax, ay = between(state, n.sway), between(state, n.sway)
    wx, wy = 2.0 * math.pi * between(state, n.sway_hz), 2.0 * math.pi * between(state, n.sway_hz)
    px, py = 2.0 * math.pi * unit(state), 2.0 * math.pi * unit(state)
    jitter = between(state, n.jitter)
    newest = n.rows - 1
    vx, vy = closing * ux - sideways * uy, closing * uy + sideways * ux
    if kind == HOVER:
        vx, vy = ax * wx * math.cos(px), ay * wy * math.cos(py)
    speed, heading = math.hypot(vx, vy), math.atan2(vy, vx)
    curvature = 0.0
    if kind == ARC:
        curvature = -1.0 / radius if left else 1.0 / radius
    for m in range(n.rows):
        t = (m - newest) * n.cycle_s
        if kind == HOVER:
            shift[m, 0] = ax * (math.sin(wx * t + px) - math.sin(px))
            shift[m, 1] = ay * (math.sin(wy * t + py) - math.sin(py))
        else:
            shift[m, 0], shift[m, 1] = arc_displacement(speed * t + 0.5 * along * t * t, heading, curvature)
        if m < newest:
            shift[m, 0] += jitter * near_normal(state)
            shift[m, 1] += jitter * near_normal(state)
    return vx, vy


@njit(cache=True)
def draw_scene(n, state, delay, gain, turn, shift, fade, scene, obstacle, path_m, snr_db):  # type: ignore[no-untyped-def]
    """Draw everything but the noise itself.

    Args:
        n: Numbers. state: a started stream.
        delay, gain, turn: (S, 4, M) filled with columns to the leading edge (-1: no echo), peak in full scales, and
            phase in turns. shift (M, 2), fade (M,): scratch.
        scene: (SCENE_FIELDS,). obstacle: (4, OBSTACLE_FIELDS). path_m, snr_db: (S, 4) of the newest cycle.
    """
    # Locals, because every look into `n` within a loop counts its arrays' references up and down.
    rows, cycle_s, sensors, directivity = n.rows, n.cycle_s, n.sensors, n.directivity
    wavenumber, reach_h, reach_v, newest = n.wavenumber, n.reach_h, n.reach_v, n.rows - 1
    tx = sensors[0]
    count, path = pick(state, n.count_sum), pick(state, n.path_sum)
    band, response = below(state, n.bandwidths.shape[0]), 0
    absorption = _NEPER * between(state, n.absorption_db)
    bandwidth = n.bandwidths[band]
    delay[:] = -1.0
    gain[:] = 0.0
    path_m[:] = 0.0
    snr_db[:] = ABSENT_DB
    obstacle[:] = 0.0
    obstacle[:, KIND] = -1.0
    vx = vy = 0.0
    for i in range(count):
        kind = pick(state, n.kind_sum)
        azimuth = between(state, n.azimuth)
        elevation = between(state, n.elevation)
        if kind in (PLANE, CYLINDER):
            elevation = 0.0
        now = between(state, n.range_m)
        a, b = between(state, n.cosine_a), between(state, n.cosine_b)
        omega, phi = between(state, n.cosine_omega), 2.0 * math.pi * unit(state)
        ux = math.cos(elevation) * math.cos(azimuth)
        uy, uz = math.cos(elevation) * math.sin(azimuth), math.sin(elevation)
        if path == COSINE:
            now = a + b * math.cos(phi)
        elif i == 0:
            vx, vy = _move(n, state, path, math.cos(azimuth), math.sin(azimuth), shift)
        size = 0.0
        if kind == CYLINDER:
            size = log_between(state, n.cylinder)
        elif kind == POINT:
            size = log_between(state, n.point)
        elif kind == EDGE:
            size = 1.0 + 1.0 / math.cos(between(state, n.edge_angle))
        level = math.exp(_NEPER * between(state, n.reflectivity_db))
        fading = _NEPER * between(state, n.fading_db)
        response = below(state, n.responses)
        first, last = 0, newest
        if unit(state) < n.partial:
            if unit(state) < 0.5:
                first = 1 + below(state, newest)
            else:
                last = below(state, newest)
        obstacle[i, KIND], obstacle[i, RANGE] = kind, now
        obstacle[i, AZIMUTH], obstacle[i, ELEVATION] = azimuth, elevation
        obstacle[i, CLOSING] = b * omega * math.sin(phi) if path == COSINE else ux * vx + uy * vy
        obstacle[i, SIZE], obstacle[i, VARIANT] = size, band * n.responses + response
        for m in range(n.rows):
            fade[m] = level * math.exp(fading * near_normal(state))
        for s in range(sensors.shape[0]):
            rx = sensors[s]
            for m in range(rows):
                mx = my = mz = 0.0
                if path == COSINE:
                    back = now - a - b * math.cos(omega * (m - newest) * cycle_s + phi)
                    mx, my, mz = back * ux, back * uy, back * uz
                else:
                    mx, my = shift[m, 0], shift[m, 1]
                if kind == PLANE:
                    reach = now - ux * mx - uy * my
                    out, inward = plane_legs(ux, uy, reach, tx, rx)
                    x, y, z = 1e3 * ux, 1e3 * uy, 0.0
                elif kind == CYLINDER:
                    x, y, z = (now + size) * ux - mx, (now + size) * uy - my, 0.0
                    out, inward = cylinder_legs(x, y, size, tx, rx)
                else:
                    x, y, z = now * ux - mx, now * uy - my, now * uz - mz
                    out, inward = point_legs(x, y, z, tx, rx)
                way = out + inward
                # The way is kept in `delay` until its rate of change is known.
                delay[s, i, m] = -1.0
                if m == newest:
                    path_m[s, i] = way
                if way < 0.05 or m < first or m > last:
                    continue
                delay[s, i, m] = way
                loud = fade[m] * math.exp(-absorption * way) * strength(kind, out, inward, size, wavenumber)
                if directivity:
                    loud *= beam(x, y, z, tx, reach_h, reach_v) * beam(x, y, z, rx, reach_h, reach_v)
                gain[s, i, m] = loud
        _ways_to_delays(n, delay[:, i], gain[:, i], turn[:, i], bandwidth)
    _set_levels(n, state, count, gain, snr_db, scene)
    scene[COUNT], scene[PATH], scene[BAND] = count, path, band


@njit(cache=True)
def _ways_to_delays(n, delay, gain, turn, bandwidth):  # type: ignore[no-untyped-def]
    """Path lengths (S, M) to columns and phases, with the receiver moving while the sound travels, and the loss of
    the Doppler shift in the receiver's band, 1 / sqrt(1 + (2 f / B)^2) (acoustics.md)."""
    rows, cycle_s, column_m, columns = n.rows, n.cycle_s, n.column_m, n.columns
    doppler, fop_hz, c = n.doppler, n.fop_hz, n.c
    for s in range(delay.shape[0]):
        # Newest first: the row before must still be a path length when its difference is taken.
        for m in range(rows - 1, -1, -1):
            way = delay[s, m]
            if way < 0.0:
                continue
            rate = 0.0
            if doppler:
                if m > 0 and delay[s, m - 1] > 0.0:
                    rate = (way - delay[s, m - 1]) / cycle_s
                elif m + 1 < rows and gain[s, m + 1] > 0.0:
                    rate = (delay[s, m + 1] * 2.0 * column_m - way) / cycle_s
                # Towards the reflection point at v = -rate/2: the delay is (way / c) (1 - v/c) to first order.
                way *= 1.0 + 0.5 * rate / c
                x = 2.0 * fop_hz * rate / c / bandwidth
                gain[s, m] /= math.sqrt(1.0 + x * x)
            delay[s, m] = way / (2.0 * column_m)
            turns = fop_hz * way / c
            turn[s, m] = math.floor(turns) - turns
            if delay[s, m] >= columns:
                gain[s, m] = 0.0


@njit(cache=True)
def _set_levels(n, state, count, gain, snr_db, scene):  # type: ignore[no-untyped-def]
    """Noise level and PSNR drawn; `gain` scaled from relative strengths to full scales."""
    newest = n.rows - 1
    level = log_between(state, n.level)
    psnr = between(state, n.psnr_db)
    scene[MODEL] = 1.0 if unit(state) < n.speckle else 0.0
    scene[MULTIPLICATIVE] = between(state, n.multiplicative)
    scene[DRIFT] = between(state, n.drift_db)
    scene[FIRST_ROW] = 0.0
    if unit(state) < n.start:
        scene[FIRST_ROW] = 1 + below(state, newest)
    ring = unit(state) < n.ring
    scene[RING] = math.exp(_NEPER * between(state, n.ring_db)) if ring else 0.0
    scene[LEVEL], scene[PSNR], scene[PSNR_IMAGE] = level, ABSENT_DB, ABSENT_DB
    strongest = anywhere = 0.0
    for i in range(count):
        strongest = max(strongest, gain[0, i, newest])
        for m in range(int(scene[FIRST_ROW]), gain.shape[2]):
            anywhere = max(anywhere, gain[0, i, m])
    reference = anywhere if n.psnr_image or strongest == 0.0 else strongest
    if reference == 0.0:
        gain[:] = 0.0
        return
    factor = level * math.exp(_NEPER * psnr) / reference
    for s in range(gain.shape[0]):
        for i in range(count):
            for m in range(gain.shape[2]):
                gain[s, i, m] *= factor
            if gain[s, i, newest] > 0.0:
                snr_db[s, i] = max(math.log(gain[s, i, newest] / level) / _NEPER, ABSENT_DB)
    if strongest > 0.0:
        scene[PSNR] = math.log(strongest * factor / level) / _NEPER
    scene[PSNR_IMAGE] = math.log(anywhere * factor / level) / _NEPER


@njit(cache=True)
def scratch(n):  # type: ignore[no-untyped-def]
    """(delay, gain, turn, shift, fade) for `draw_scene`."""
    shape = (n.sensors.shape[0], 4, n.rows)
    return np.empty(shape), np.empty(shape), np.zeros(shape), np.zeros((n.rows, 2)), np.zeros(n.rows)
