"""Every straight echo of one transmitter at one receiver: the laws of `echoes.py` run over a scene's primitives."""

import math

import numpy as np
from numba import njit

from sitl.acoustics.arrival import (
    ARRIVAL_COLUMNS,
    BOUNCE,
    CLOSEST_M,
    CYLINDER,
    DIFFUSE,
    DIRECT,
    EDGE,
    FACET,
    SPHERE,
    STRAIGHT,
    fade,
    finish,
    unit_to,
)
from sitl.acoustics.echoes import (
    arc_radius,
    cylinder_amplitude,
    edge_amplitude,
    fresnel_radius,
    mirror_share,
    plane_amplitude,
    sphere_amplitude,
)
from sitl.acoustics.mirrors import cylinder_point, facet_point, sphere_point
from sitl.acoustics.occlusion import clear_share

__all__ = ["ARRIVAL_COLUMNS", "BOUNCE", "CYLINDER", "DIFFUSE", "DIRECT", "EDGE", "FACET", "SPHERE", "STRAIGHT", "near",
           "trace"]

ROOT_HALF = math.sqrt(0.5)


@njit(cache=True)
def near(facets, cylinders, origin, reach):  # type: ignore[no-untyped-def]
    """Rows whose bounding sphere comes within `reach` of `origin`."""
    near_facets = np.empty(facets.shape[0], np.int64)
    near_cylinders = np.empty(cylinders.shape[0], np.int64)
    n = m = 0
    for k in range(facets.shape[0]):
        row = facets[k]
        size = math.sqrt(row[9] * row[9] + row[10] * row[10])
        gap = math.sqrt((row[0] - origin[0]) ** 2 + (row[1] - origin[1]) ** 2 + (row[2] - origin[2]) ** 2)
        if gap - size < reach:
            near_facets[n] = k
            n += 1
    for k in range(cylinders.shape[0]):
        row = cylinders[k]
        size = gap = 0.0
        for i in range(3):
            half = 0.5 * (row[3 + i] - row[i])
            middle = row[i] + half - origin[i]
            size += half * half
            gap += middle * middle
        if math.sqrt(gap) - math.sqrt(size) - row[6] < reach:
            near_cylinders[m] = k
            m += 1
    return near_facets[:n], near_cylinders[:m]


@njit(cache=True)
def trace(facets, cylinders, spheres, edges, near_facets, near_cylinders, tx, rx, rotation, velocity, setting, grid,  # type: ignore[no-untyped-def]
          floor, out):
    """Straight echoes and the direct sound from `tx` at `rx`; returns how many rows of `out` hold them.

    Args:
        facets, cylinders, spheres: rows of `sitl.primitives`; edges: rows of `sitl.acoustics.edges`.
        near_facets, near_cylinders: rows within reach, from `near`.
        tx, rx: (3,) world NED; rotation: (3, 3) body to world; velocity: (3,) of both sensors, world.
        setting: fop_hz, c_m_s, absorption in neper a metre, bandwidth_hz, longest path_m.
        grid: directivity, `beam.py`.
        floor: amplitude below which an echo is left out.
        out: (K, ARRIVAL_COLUMNS).
    """
    fop, c, longest = setting[0], setting[1], setting[4]
    wavelength = c / fop
    wavenumber = 2.0 * math.pi / wavelength
    point, to_t, to_r = np.empty(3), np.empty(3), np.empty(3)
    n = 0
    gap = math.sqrt((rx[0] - tx[0]) ** 2 + (rx[1] - tx[1]) ** 2 + (rx[2] - tx[2]) ** 2)
    if gap > 1e-6:
        # Cross-talk: both look at the middle: the same distance, no motion between them.
        for i in range(3):
            point[i] = 0.5 * (tx[i] + rx[i])
        unit_to(tx, point, to_t)
        unit_to(rx, point, to_r)
        n += finish(out, n, 1.0 / gap, 1.0, 0.0, 0.5 * gap, 0.5 * gap, to_t, to_r, rotation, np.zeros(3), setting, grid,
                    floor, DIRECT, 0.0, STRAIGHT)
    for k in near_facets:
        row = facets[k]
        d1, d2, u, v = facet_point(row, tx, rx, point)
        if d1 == 0.0 or d1 + d2 > longest:
            continue
        d1, d2 = max(d1, CLOSEST_M), max(d2, CLOSEST_M)
        radius = fresnel_radius(wavelength, d1, d2)
        if abs(u) > row[9] + 1.5 * radius or abs(v) > row[10] + 1.5 * radius:
            continue
        amplitude = (row[11] * plane_amplitude(d1, d2) * mirror_share(row[9] - u, row[9] + u, radius)
                     * mirror_share(row[10] - v, row[10] + v, radius))
        unit_to(tx, point, to_t)
        unit_to(rx, point, to_r)
        if finish(out, n, amplitude, 1.0, 0.0, d1, d2, to_t, to_r, rotation, velocity, setting, grid, floor, FACET, k,
                  STRAIGHT):
            fade(out, n, clear_share(facets, near_facets, k, cylinders, near_cylinders, -1, tx, point, wavelength)
                 * clear_share(facets, near_facets, k, cylinders, near_cylinders, -1, rx, point, wavelength))
            n += 1
    a, w = np.empty(3), np.empty(3)
    for k in near_cylinders:
        row = cylinders[k]
        length = axis_of(row, a, w)
        d1, d2, z, cosine = cylinder_point(a, w, row[6], tx, rx, point)
        if d1 == 0.0 or d1 + d2 > longest:
            continue
        d1, d2 = max(d1, CLOSEST_M), max(d2, CLOSEST_M)
        share = mirror_share(z, length - z, fresnel_radius(wavelength, d1, d2))
        amplitude = row[7] * share * cylinder_amplitude(d1, d2, row[6], cosine)
        unit_to(tx, point, to_t)
        unit_to(rx, point, to_r)
        if finish(out, n, amplitude, 1.0, 0.0, d1, d2, to_t, to_r, rotation, velocity, setting, grid, floor, CYLINDER,
                  k, STRAIGHT):
            fade(out, n, clear_share(facets, near_facets, -1, cylinders, near_cylinders, k, tx, point, wavelength)
                 * clear_share(facets, near_facets, -1, cylinders, near_cylinders, k, rx, point, wavelength))
            n += 1
    for k in range(spheres.shape[0]):
        row = spheres[k]
        d1, d2, cosine = sphere_point(row, tx, rx, point)
        if d1 == 0.0 or d1 + d2 > longest:
            continue
        d1, d2 = max(d1, CLOSEST_M), max(d2, CLOSEST_M)
        unit_to(tx, point, to_t)
        unit_to(rx, point, to_r)
        if finish(out, n, row[4] * sphere_amplitude(d1, d2, row[3], cosine), 1.0, 0.0, d1, d2, to_t, to_r, rotation,
                  velocity, setting, grid, floor, SPHERE, k, STRAIGHT):
            fade(out, n, clear_share(facets, near_facets, -1, cylinders, near_cylinders, -1, tx, point, wavelength)
                 * clear_share(facets, near_facets, -1, cylinders, near_cylinders, -1, rx, point, wavelength))
            n += 1
    for k in range(edges.shape[0]):
        row = edges[k]
        gap = 0.0
        for i in range(3):
            middle = row[i] + 0.5 * row[6] * row[3 + i] - tx[i]
            gap += middle * middle
        if math.sqrt(gap) - 0.5 * row[6] > 0.5 * longest + 0.2:
            continue
        for i in range(3):
            a[i] = row[i]
            w[i] = row[3 + i]
        d1, d2, z, cosine = cylinder_point(a, w, row[8], tx, rx, point)
        if d1 == 0.0 or d1 + d2 > longest:
            continue
        d1, d2 = max(d1, CLOSEST_M), max(d2, CLOSEST_M)
        share = mirror_share(z, row[6] - z, fresnel_radius(wavelength, d1, d2))
        if share < 1e-3:
            continue
        if row[8] > 0.0:
            amplitude = cylinder_amplitude(d1, d2, row[8], cosine)
            if row[9] == 1.0:
                amplitude *= _arc_share(row, point, z, wavelength, d1, d2, cosine)
            turn_re, turn_im = 1.0, 0.0
        else:
            cos_in, cos_out = _cosines(row, tx, rx, point, d1, d2)
            amplitude = edge_amplitude(d1, d2, cos_in, cos_out, wavenumber)
            turn_re, turn_im = -ROOT_HALF, ROOT_HALF
        unit_to(tx, point, to_t)
        unit_to(rx, point, to_r)
        if finish(out, n, amplitude * row[7] * share, turn_re, turn_im, d1, d2, to_t, to_r, rotation, velocity, setting,
                  grid, floor, EDGE, k, STRAIGHT):
            fade(out, n, clear_share(facets, near_facets, -1, cylinders, near_cylinders, -1, tx, point, wavelength)
                 * clear_share(facets, near_facets, -1, cylinders, near_cylinders, -1, rx, point, wavelength))
            n += 1
    return n


@njit(cache=True)
def axis_of(row, a, w):  # type: ignore[no-untyped-def]
    """Writes the end `a` (3,) and the unit direction `w` (3,) of a cylinder; returns its length."""
    length = 0.0
    for i in range(3):
        a[i] = row[i]
        w[i] = row[3 + i] - row[i]
        length += w[i] * w[i]
    length = math.sqrt(length)
    for i in range(3):
        w[i] /= length
    return length


@njit
def _arc_share(row, point, z, wavelength, d1, d2, cosine):  # type: ignore[no-untyped-def]
    """Part of the cylinder's echo that the arc between the two faces of a rounded corner gives."""
    along = side = between = across = 0.0
    for i in range(3):
        offset = (point[i] - row[i] - z * row[3 + i]) / row[8]
        along += offset * row[10 + i]
        side += offset * row[13 + i]
        between += row[10 + i] * row[13 + i]
    across = math.sqrt(max(1.0 - between * between, 1e-12))
    angle = math.atan2((side - between * along) / across, along)
    span = math.atan2(across, between)
    radius = arc_radius(wavelength, d1, d2, row[8], cosine)
    return max(0.0, mirror_share(row[8] * angle, row[8] * (span - angle), radius))


@njit
def _cosines(row, tx, rx, point, d1, d2):  # type: ignore[no-untyped-def]
    """Cosines of Keller's angles of transmitter and receiver."""
    cos_in = cos_out = 0.0
    for i in range(3):
        cos_in += (tx[i] - point[i]) / d1 * row[10 + i]
        cos_out += (rx[i] - point[i]) / d2 * row[10 + i]
    if row[9] == 2.0:
        cos_in = math.sqrt(max(0.0, 1.0 - cos_in * cos_in))
        cos_out = math.sqrt(max(0.0, 1.0 - cos_out * cos_out))
    return cos_in, cos_out
