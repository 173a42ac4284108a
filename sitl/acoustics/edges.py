"""Edges made ready: which faces meet at each, found from the facets, so that the kernel knows where an edge is lit.

A hard edge needs the direction into its half-plane (Keller's angle is counted from it); a rounded corner needs the
normals of both faces, between which its arc mirrors, and its axis lies a corner radius inside both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.primitives import Primitives

Floats = NDArray[np.float64]

READY_COLUMNS = 16
"""end a (3), unit direction (3), length_m, reflectivity, radius_m, kind, first vector (3), second vector (3)."""
HALF_PLANE, ARC, BARE = 0.0, 1.0, 2.0
"""Kinds: hard edge (first vector points into the face), rounded corner (the normals of its faces), edge of no known
face (first vector is the normal it came with; taken as lit from everywhere)."""
TOUCH_M = 1e-4


class _Face(NamedTuple):
    normal: Floats
    inwards: Floats


def ready_edges(primitives: Primitives) -> Floats:
    """One row of READY_COLUMNS for each edge of `primitives`, (E, 16)."""
    rows = np.zeros((len(primitives.edges), READY_COLUMNS))
    for row, edge in zip(rows, primitives.edges, strict=True):
        start, end = edge[0:3], edge[3:6]
        length = float(np.linalg.norm(end - start))
        direction = (end - start) / length
        faces = _faces(primitives.facets, start, end, direction)
        radius = float(edge[10])
        row[6:9] = length, edge[9], radius
        if radius > 0.0 and len(faces) >= 2:
            first, second = _outward(faces[0], faces[1]), _outward(faces[1], faces[0])
            start = start - radius * (first + second)
            row[9], row[10:13], row[13:16] = ARC, first, second
        elif radius == 0.0 and faces:
            row[9], row[10:13] = HALF_PLANE, faces[0].inwards
        else:
            row[9], row[10:13] = BARE, edge[6:9]
        row[0:3], row[3:6] = start, direction
    rows.setflags(write=False)
    return rows


def _faces(facets: Floats, start: Floats, end: Floats, direction: Floats) -> list[_Face]:
    """The facets that end in this edge."""
    found = []
    for facet in facets:
        centre, u, v = facet[0:3], facet[3:6], facet[6:9]
        for along, across, half_along, half in ((u, v, facet[9], facet[10]), (v, u, facet[10], facet[9])):
            if abs(abs(along @ direction) - 1.0) > 1e-6:
                continue
            middle = (start + end) / 2.0 - centre
            off_plane = abs(middle @ np.cross(u, v))
            side = float(middle @ across)
            if off_plane < TOUCH_M and abs(abs(side) - half) < TOUCH_M and abs(middle @ along) <= half_along:
                found.append(_Face(np.cross(u, v), -np.sign(side) * across))
    return found


def _outward(face: _Face, other: _Face) -> Floats:
    """The normal of `face` on the side that the other face of a convex corner leaves free."""
    return -np.sign(float(face.normal @ other.inwards)) * face.normal
