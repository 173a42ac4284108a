"""Signed distance to finite cylinders and boxes, one numba kernel for scenes, planner, judge and drawings.

A solid is a row of SOLID_COLUMNS numbers: kind (0 cylinder, 1 box), centre (3), unit axes u (3), v (3), w (3),
half_u, half_v, half_w. A cylinder lies along w, its radius is half_u = half_v. World NED metres.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

SOLID_COLUMNS = 16
CYLINDER, BOX = 0.0, 1.0

Floats = NDArray[np.float64]


def cylinder_solid(end_a: Floats, end_b: Floats, radius_m: float) -> list[float]:
    """Row of a finite cylinder with flat ends at the two points (3,)."""
    along = np.asarray(end_b, float) - np.asarray(end_a, float)
    length = float(np.linalg.norm(along))
    w = along / length
    helper = np.eye(3)[int(np.argmin(np.abs(w)))]
    u = np.cross(w, helper)
    u /= np.linalg.norm(u)
    centre = (np.asarray(end_a, float) + end_b) / 2
    return [CYLINDER, *centre, *u, *np.cross(w, u), *w, radius_m, radius_m, length / 2]


def box_solid(centre: Floats, axes: Floats, half_m: tuple[float, float, float]) -> list[float]:
    """Row of a box with unit axes u, v, w as rows of `axes` (3, 3) and half extents along them."""
    return [BOX, *map(float, centre), *map(float, axes.ravel()), *half_m]


@njit(cache=True)
def solid_distance(row, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance of one point to one solid row; negative inside. Exact."""
    dx, dy, dz = x - row[1], y - row[2], z - row[3]
    lu = dx * row[4] + dy * row[5] + dz * row[6]
    lv = dx * row[7] + dy * row[8] + dz * row[9]
    lw = abs(dx * row[10] + dy * row[11] + dz * row[12]) - row[15]
    if row[0] == 0.0:
        side = math.sqrt(lu * lu + lv * lv) - row[13]
        outside = math.sqrt(max(side, 0.0) ** 2 + max(lw, 0.0) ** 2)
        return outside + min(max(side, lw), 0.0)
    qu, qv = abs(lu) - row[13], abs(lv) - row[14]
    outside = math.sqrt(max(qu, 0.0) ** 2 + max(qv, 0.0) ** 2 + max(lw, 0.0) ** 2)
    return outside + min(max(qu, qv, lw), 0.0)


@njit(cache=True)
def _nearest(solids, points, out):  # type: ignore[no-untyped-def]
    for k in range(points.shape[0]):
        best = np.inf
        for s in range(solids.shape[0]):
            best = min(best, solid_distance(solids[s], points[k, 0], points[k, 1], points[k, 2]))
        out[k] = best


def signed_distance_m(solids: Floats, points: Floats) -> Floats:
    """Distance (K,) from points (K, 3) to the nearest of solids (S, 16); inf where there are none."""
    points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    out = np.empty(len(points))
    _nearest(solids, points, out)
    return out


def stack_solids(parts: list[Floats]) -> Floats:
    """All rows of the parts, (S, 16), contiguous."""
    return np.ascontiguousarray(np.concatenate([np.zeros((0, SOLID_COLUMNS)), *parts]))


def surface_points(row: Floats, spacing_m: float = 0.05) -> Floats:
    """Points (K, 3) on the surface of one solid, at most `spacing_m` apart (24 or more around a cylinder)."""
    half_u, half_v, half_w = row[13:16]
    if row[0] == CYLINDER:
        around = max(24, math.ceil(2 * math.pi * half_u / spacing_m))
        turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
        heights = np.linspace(-half_w, half_w, max(2, math.ceil(2 * half_w / spacing_m) + 1))
        radii = np.linspace(0, half_u, max(2, math.ceil(half_u / spacing_m) + 1))
        rings = [(half_u, h) for h in heights] + [(r, h) for h in (-half_w, half_w) for r in radii[:-1]]
        radius, height = (column[:, None] for column in np.array(rings).T)
        local = np.stack([radius * np.cos(turn), radius * np.sin(turn), height + 0 * turn], axis=-1).reshape(-1, 3)
    else:
        ticks = [np.linspace(-h, h, max(2, math.ceil(2 * h / spacing_m) + 1)) for h in (half_u, half_v, half_w)]
        grid = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        on_face = np.any(np.isclose(np.abs(grid), row[13:16]), axis=1)
        local = grid[on_face]
    return row[1:4] + local @ row[4:13].reshape(3, 3)


def gaps_m(bodies: list[Floats]) -> Floats:
    """Smallest distance (B, B) between any two bodies (rows of solids each); 0 or less where they overlap.

    From points on the surfaces of both, so at most half their spacing squared over a radius too long.
    """
    skins = [np.concatenate([surface_points(row) for row in rows]) for rows in bodies]
    gaps = np.full((len(bodies), len(bodies)), np.inf)
    for i in range(len(bodies)):
        for j in range(i):
            one, other = signed_distance_m(bodies[i], skins[j]).min(), signed_distance_m(bodies[j], skins[i]).min()
            gaps[i, j] = gaps[j, i] = min(one, other)
    return gaps
