"""What stands in the way: the part of an echo's amplitude that passes the facets and cylinders before it.

A straight ray through a body loses everything, one that clears it by more than a Fresnel radius nothing, with the
smooth border of `echoes.mirror_share` between. Sound bent around a body is left out, and so are echoes of echoes.
"""

import math

from numba import njit

from sitl.acoustics.echoes import fresnel_radius, mirror_share

SKIP_M = 0.010
"""Crossings this near to the reflection point or the sensor are the reflecting body itself."""


@njit(cache=True)
def facet_cover(row, start, end, wavelength):  # type: ignore[no-untyped-def]
    """Part 0..1 of the ray from `start` to `end` that a facet stops."""
    n0 = row[4] * row[8] - row[5] * row[7]
    n1 = row[5] * row[6] - row[3] * row[8]
    n2 = row[3] * row[7] - row[4] * row[6]
    a = (start[0] - row[0]) * n0 + (start[1] - row[1]) * n1 + (start[2] - row[2]) * n2
    b = (end[0] - row[0]) * n0 + (end[1] - row[1]) * n1 + (end[2] - row[2]) * n2
    if a * b >= 0.0:
        return 0.0
    t = a / (a - b)
    u = v = length = 0.0
    for i in range(3):
        step = end[i] - start[i]
        length += step * step
        offset = start[i] + t * step - row[i]
        u += offset * row[3 + i]
        v += offset * row[6 + i]
    length = math.sqrt(length)
    d1, d2 = t * length, (1.0 - t) * length
    if min(d1, d2) < SKIP_M:
        return 0.0
    radius = fresnel_radius(wavelength, d1, d2)
    if abs(u) > row[9] + 2.0 * radius or abs(v) > row[10] + 2.0 * radius:
        return 0.0
    return (mirror_share(row[9] - u, row[9] + u, radius) * mirror_share(row[10] - v, row[10] + v, radius))


@njit(cache=True)
def cylinder_cover(row, start, end, wavelength):  # type: ignore[no-untyped-def]
    """Part 0..1 of the ray from `start` to `end` that a cylinder stops."""
    ww = wr = rr = wo = ro = 0.0
    for i in range(3):
        w = row[3 + i] - row[i]
        r = end[i] - start[i]
        o = start[i] - row[i]
        ww += w * w
        wr += w * r
        rr += r * r
        wo += w * o
        ro += r * o
    across = ww * rr - wr * wr
    if across < 1e-12:
        return 0.0
    # Nearest approach of the two lines: at t of the ray, at s of the axis.
    t = (wr * wo - ww * ro) / across
    if t <= 0.0 or t >= 1.0:
        return 0.0
    length = math.sqrt(rr)
    d1, d2 = t * length, (1.0 - t) * length
    if min(d1, d2) < SKIP_M:
        return 0.0
    s = (wo + t * wr) / ww
    gap = 0.0
    for i in range(3):
        step = start[i] + t * (end[i] - start[i]) - row[i] - s * (row[3 + i] - row[i])
        gap += step * step
    gap = math.sqrt(gap)
    radius = fresnel_radius(wavelength, d1, d2)
    if gap > row[6] + 2.0 * radius:
        return 0.0
    axis = math.sqrt(ww)
    return (mirror_share(row[6] - gap, row[6] + gap, radius)
            * max(0.0, mirror_share(s * axis, (1.0 - s) * axis, radius)))


@njit(cache=True)
def clear_share(facets, near_facets, own_facet, cylinders, near_cylinders, own_cylinder, start, end, wavelength):  # type: ignore[no-untyped-def]
    """Part of the amplitude that gets from `start` to `end`; the near_* arrays list the rows worth asking."""
    clear = 1.0
    for k in near_facets:
        if k != own_facet:
            clear *= 1.0 - facet_cover(facets[k], start, end, wavelength)
    for k in near_cylinders:
        if k != own_cylinder:
            clear *= 1.0 - cylinder_cover(cylinders[k], start, end, wavelength)
    return clear
