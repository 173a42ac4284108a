"""One multipath bounce: a flat face (floor, wall, side of a box) mirrors the sound on its way to or from an obstacle.

The face gives the transmitter, or the receiver, an image behind it (Allen and Berkley 1979); the laws of `echoes.py`
hold from there. With the floor this makes the corner echo behind every pole, between two walls that of their corner.
Faces and cylinders send back; edges, spheres and rough surfaces only directly, their bounce is far below the noise.
"""

import math

import numpy as np
from numba import njit

from sitl.acoustics.arrival import BOUNCE, CLOSEST_M, CYLINDER, FACET, fade, finish, unit_to
from sitl.acoustics.echoes import cylinder_amplitude, fresnel_radius, mirror_share, plane_amplitude
from sitl.acoustics.mirrors import NEAREST_M, cylinder_point, facet_point
from sitl.acoustics.occlusion import clear_share
from sitl.acoustics.tracing import axis_of

SMALLEST_HALF_M = 0.15
"""A face mirrors on the way when its sides are twice this at least (a Fresnel radius at 1.66 m is 73 mm)."""
WEAKEST = 8.0
"""Bounces below this many times the floor of direct echoes are left out: 2 counts, a thirtieth of the quiet noise."""


@njit(cache=True)
def bounces(facets, cylinders, near_facets, near_cylinders, tx, rx, rotation, velocity, setting, grid, floor, out, n):  # type: ignore[no-untyped-def]
    """Adds the echoes with one bounce to `out` from row n on; returns the rows then filled. Arguments as `trace`."""
    longest, wavelength = setting[4], setting[1] / setting[0]
    weakest = WEAKEST * floor
    normal, image, point, a, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in near_facets:
        row = facets[k]
        if min(row[9], row[10]) < SMALLEST_HALF_M or row[11] < 0.2:
            continue
        normal[0] = row[4] * row[8] - row[5] * row[7]
        normal[1] = row[5] * row[6] - row[3] * row[8]
        normal[2] = row[3] * row[7] - row[4] * row[6]
        height_t = height_r = 0.0
        for i in range(3):
            height_t += (tx[i] - row[i]) * normal[i]
            height_r += (rx[i] - row[i]) * normal[i]
        if height_t * height_r <= NEAREST_M * NEAREST_M or (row[14] == 1.0 and height_t < 0.0):
            continue
        if abs(height_t) + abs(height_r) > longest:
            continue
        # On the way out the transmitter has an image, on the way back the receiver.
        for order in range(2):
            real, height = (tx, height_t) if order == 0 else (rx, height_r)
            for i in range(3):
                image[i] = real[i] - 2.0 * height * normal[i]
            start, end = (image, rx) if order == 0 else (tx, image)
            for j in near_facets:
                other = facets[j]
                if j == k or other[11] <= 0.0 or not _sees(row, other) or not _sees(other, row):
                    continue
                d1, d2, u, v = facet_point(other, start, end, point)
                if d1 == 0.0 or d1 + d2 > longest:
                    continue
                radius = fresnel_radius(wavelength, max(d1, CLOSEST_M), max(d2, CLOSEST_M))
                if abs(u) > other[9] + radius or abs(v) > other[10] + radius:
                    continue
                amplitude = (other[11] * plane_amplitude(max(d1, CLOSEST_M), max(d2, CLOSEST_M))
                             * mirror_share(other[9] - u, other[9] + u, radius)
                             * mirror_share(other[10] - v, other[10] + v, radius))
                n += _send(facets, cylinders, near_facets, near_cylinders, k, j, -1, point, d1, d2, amplitude, start,
                           end, real, height, order == 0, normal, rotation, velocity, setting, grid, weakest, out, n)
            for j in near_cylinders:
                length = axis_of(cylinders[j], a, w)
                d1, d2, z, cosine = cylinder_point(a, w, cylinders[j, 6], start, end, point)
                if d1 == 0.0 or d1 + d2 > longest:
                    continue
                d1, d2 = max(d1, CLOSEST_M), max(d2, CLOSEST_M)
                amplitude = (cylinders[j, 7] * cylinder_amplitude(d1, d2, cylinders[j, 6], cosine)
                             * mirror_share(z, length - z, fresnel_radius(wavelength, d1, d2)))
                n += _send(facets, cylinders, near_facets, near_cylinders, k, -1, j, point, d1, d2, amplitude, start,
                           end, real, height, order == 0, normal, rotation, velocity, setting, grid, weakest, out, n)
    return n


@njit(cache=True)
def _sees(face, other):  # type: ignore[no-untyped-def]
    """Whether the middle of facet `other` lies before `face`: two faces of one box never see each other."""
    if face[14] != 1.0:
        return True
    before = 0.0
    for i in range(3):
        before += (other[i] - face[i]) * (face[3 + (i + 1) % 3] * face[6 + (i + 2) % 3]
                                          - face[3 + (i + 2) % 3] * face[6 + (i + 1) % 3])
    return before > 0.0


@njit(cache=True)
def _send(facets, cylinders, near_facets, near_cylinders, k, own_facet, own_cylinder, point, d1, d2, amplitude, start,  # type: ignore[no-untyped-def]
          end, real, height, first, normal, rotation, velocity, setting, grid, floor, out, n):
    """The part that all share: where it bounces off facet k, whether it can, and what stands in the way."""
    if abs(amplitude) < floor:
        return 0
    face = facets[k]
    above = 0.0
    for i in range(3):
        above += (point[i] - face[i]) * normal[i]
    above = above if height > 0.0 else -above
    wavelength = setting[1] / setting[0]
    if above < -fresnel_radius(wavelength, d1, d2):
        return 0
    # The way between the image and the point crosses the face at the bounce. A corner echoes from where both faces
    # meet, half by either order: that is in the shares of the faces, which end there.
    share = abs(height) / (abs(height) + max(above, 0.0))
    bounce = np.empty(3)
    u = v = 0.0
    for i in range(3):
        image = start[i] if first else end[i]
        bounce[i] = image + share * (point[i] - image)
        u += (bounce[i] - face[i]) * face[3 + i]
        v += (bounce[i] - face[i]) * face[6 + i]
    way = d1 if first else d2
    radius = fresnel_radius(wavelength, max(share * way, CLOSEST_M), max((1.0 - share) * way, CLOSEST_M))
    amplitude *= (face[11] * max(mirror_share(face[9] - u, face[9] + u, radius), 0.0)
                  * max(mirror_share(face[10] - v, face[10] + v, radius), 0.0))
    if abs(amplitude) < floor:
        return 0
    to_t, to_r = np.empty(3), np.empty(3)
    other = end if first else start
    if first:
        unit_to(real, bounce, to_t)
        unit_to(end, point, to_r)
    else:
        unit_to(start, point, to_t)
        unit_to(real, bounce, to_r)
    if not finish(out, n, amplitude, 1.0, 0.0, d1, d2, to_t, to_r, rotation, velocity, setting, grid, floor,
                  FACET if own_facet >= 0 else CYLINDER, own_facet if own_facet >= 0 else own_cylinder, BOUNCE):
        return 0
    clear = clear_share(facets, near_facets, k, cylinders, near_cylinders, own_cylinder, real, bounce, wavelength)
    clear *= _between(facets, near_facets, k, own_facet, cylinders, near_cylinders, own_cylinder, bounce, point,
                      wavelength)
    clear *= clear_share(facets, near_facets, own_facet, cylinders, near_cylinders, own_cylinder, other, point,
                         wavelength)
    if math.hypot(out[n, 1], out[n, 2]) * clear < floor:
        return 0
    fade(out, n, clear)
    return 1


@njit(cache=True)
def _between(facets, near_facets, k, own_facet, cylinders, near_cylinders, own_cylinder, start, end, wavelength):  # type: ignore[no-untyped-def]
    """`clear_share` between the bounce and the point: neither of the two faces is in its own way."""
    skipped = near_facets[near_facets != own_facet] if own_facet >= 0 else near_facets
    return clear_share(facets, skipped, k, cylinders, near_cylinders, own_cylinder, start, end, wavelength)
