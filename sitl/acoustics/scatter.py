"""The diffuse part of rough surfaces: points on bark and moss, each a Lambert patch (`echoes.diffuse_amplitude`).

Real roughness scatters from everywhere; here one point stands for each SPACING_M x SPACING_M of surface, at a place
drawn once from the surface itself. Within one pulse (27 mm of range) and beam there are then ten or more, enough for
the sum to fade like speckle. Points are kept in patches, so that what is far, turned away or hidden costs nothing.
"""

import math
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sitl.acoustics.arrival import CLOSEST_M, CYLINDER, DIFFUSE, FACET, fade, finish, unit_to
from sitl.acoustics.echoes import diffuse_amplitude
from sitl.acoustics.occlusion import clear_share
from sitl.primitives import Primitives

SPACING_M = 0.09
WEAKEST = 40.0
"""A single point below this many times the floor of mirrors is left out: 10 counts, a sixth of the quiet noise."""
PATCH_POINTS = 4
"""Points along each side of a patch."""
FEWEST_AROUND = 3
BEHIND = -0.3
"""Patches whose direction along the boresight is less than this are not asked: the horn hears nothing there."""

Floats = NDArray[np.float64]


class Scatterers(NamedTuple):
    """patches (P, 10): centre (3), normal (3; zero around a cylinder), radius_m, kind, row, first point;
    points (K, 7): place (3), normal (3), albedo x area. The last patch's points end the array."""

    patches: Floats
    points: Floats


def ready_scatterers(primitives: Primitives) -> Scatterers:
    """Points and patches of every facet and cylinder with an albedo."""
    patches: list[list[float]] = []
    points: list[Floats] = []
    count = 0
    for kind, rows in ((FACET, primitives.facets), (CYLINDER, primitives.cylinders)):
        for index, row in enumerate(rows):
            if row[12 if kind == FACET else 8] <= 0.0:
                continue
            for normal, found in (_on_facet(row) if kind == FACET else _on_cylinder(row)):
                centre = found[:, :3].mean(axis=0)
                radius = float(np.linalg.norm(found[:, :3] - centre, axis=1).max())
                patches.append([*centre, *normal, radius, kind, float(index), float(count)])
                points.append(found)
                count += len(found)
    return Scatterers(np.array(patches).reshape(-1, 10), np.concatenate([np.zeros((0, 7)), *points]))


def _cells(length_m: float) -> int:
    return max(1, round(length_m / SPACING_M))


def _on_facet(row: Floats) -> list[tuple[Floats, Floats]]:
    """(normal, points) of each patch."""
    centre, u, v, half_u, half_v = row[0:3], row[3:6], row[6:9], float(row[9]), float(row[10])
    normal = np.cross(u, v)
    many_u, many_v = _cells(2 * half_u), _cells(2 * half_v)
    rng = np.random.default_rng(crc32(row.tobytes()))
    jitter = rng.random((many_u, many_v, 2))
    albedo_area = float(row[12]) * 4 * half_u * half_v / (many_u * many_v)
    out = []
    for a in range(0, many_u, PATCH_POINTS):
        for b in range(0, many_v, PATCH_POINTS):
            i, j = (grid.ravel() for grid in np.meshgrid(np.arange(a, min(a + PATCH_POINTS, many_u)),
                                                         np.arange(b, min(b + PATCH_POINTS, many_v)), indexing="ij"))
            x = half_u * (2 * (i + jitter[i, j, 0]) / many_u - 1)
            y = half_v * (2 * (j + jitter[i, j, 1]) / many_v - 1)
            found = np.empty((i.size, 7))
            found[:, :3] = centre + x[:, None] * u + y[:, None] * v
            found[:, 3:6], found[:, 6] = normal, albedo_area
            out.append((normal, found))
    return out


def _on_cylinder(row: Floats) -> list[tuple[Floats, Floats]]:
    """(zero, points) of each ring."""
    start, along, radius = row[0:3], row[3:6] - row[0:3], float(row[6])
    length = float(np.linalg.norm(along))
    w = along / length
    e1 = np.cross(w, np.eye(3)[int(np.argmin(np.abs(w)))])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(w, e1)
    many, around = _cells(length), max(FEWEST_AROUND, math.ceil(2 * math.pi * radius / SPACING_M))
    rng = np.random.default_rng(crc32(row.tobytes()))
    jitter = rng.random((many, around, 2))
    albedo_area = float(row[8]) * 2 * math.pi * radius * length / (many * around)
    out = []
    for a in range(0, many, PATCH_POINTS):
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(a, min(a + PATCH_POINTS, many)), np.arange(around),
                                                     indexing="ij"))
        turn = 2 * math.pi * (j + jitter[i, j, 0]) / around
        outward = np.cos(turn)[:, None] * e1 + np.sin(turn)[:, None] * e2
        found = np.empty((i.size, 7))
        found[:, :3] = start + (length * (i + jitter[i, j, 1]) / many)[:, None] * w + radius * outward
        found[:, 3:6], found[:, 6] = outward, albedo_area
        out.append((np.zeros(3), found))
    return out


@njit(cache=True)
def scatter(patches, points, facets, cylinders, near_facets, near_cylinders, tx, rx, rotation, velocity, setting, grid,  # type: ignore[no-untyped-def]
            floor, out, n):
    """Adds the echoes of all points in reach to `out` from row n on; returns the rows then filled.

    Occlusion is asked once for a patch, on the transmitter's way: the sensors are a hand apart. Arguments as
    `tracing.trace`.
    """
    wavelength, longest, weakest = setting[1] / setting[0], setting[4], WEAKEST * floor
    point, to_t, to_r = np.empty(3), np.empty(3), np.empty(3)
    for p in range(patches.shape[0]):
        patch = patches[p]
        gap = facing = ahead = 0.0
        for i in range(3):
            step = patch[i] - tx[i]
            gap += step * step
            facing -= step * patch[3 + i]
            ahead += step * rotation[i, 0]
        gap = math.sqrt(gap)
        if gap - patch[6] > 0.5 * longest or ahead + patch[6] < BEHIND * gap:
            continue
        flat = patch[3] != 0.0 or patch[4] != 0.0 or patch[5] != 0.0
        if flat and facing <= 0.0:
            continue
        own_facet = int(patch[8]) if patch[7] == FACET else -1
        own_cylinder = int(patch[8]) if patch[7] == CYLINDER else -1
        for i in range(3):
            point[i] = patch[i]
        clear = clear_share(facets, near_facets, own_facet, cylinders, near_cylinders, own_cylinder, tx, point,
                            wavelength)
        if clear < 0.03:
            continue
        last = int(patches[p + 1, 9]) if p + 1 < patches.shape[0] else points.shape[0]
        for k in range(int(patch[9]), last):
            cos_in = cos_out = 0.0
            for i in range(3):
                point[i] = points[k, i]
            d1 = unit_to(tx, point, to_t)
            d2 = unit_to(rx, point, to_r)
            if d1 + d2 > longest:
                continue
            for i in range(3):
                cos_in -= to_t[i] * points[k, 3 + i]
                cos_out -= to_r[i] * points[k, 3 + i]
            if cos_in <= 0.0 or cos_out <= 0.0:
                continue
            d1, d2 = max(d1, CLOSEST_M), max(d2, CLOSEST_M)
            amplitude = diffuse_amplitude(d1, d2, cos_in, cos_out, 1.0, points[k, 6])
            if finish(out, n, amplitude, 1.0, 0.0, d1, d2, to_t, to_r, rotation, velocity, setting, grid, weakest,
                      patch[7], patch[8], DIFFUSE):
                fade(out, n, clear)
                n += 1
    return n
