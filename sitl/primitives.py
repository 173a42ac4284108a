"""What every shape is lowered to for the acoustics: flat facets, cylinders, spheres and straight edges, plain arrays.

The acoustic laws (specular plane, cylinder, Keller edge) each run over one of these arrays, so a new shape
needs no new acoustics. Coordinates are world NED in metres (z down, ground at z = 0).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FACET_COLUMNS = 15
"""centre (3), unit u (3), unit v (3), half_u_m, half_v_m, reflectivity, albedo, flutter_m, closed; the normal is u x v.

A closed facet (1) is a face of a body and has a front only; an open one (0) mirrors on both sides. The rough surface
(albedo: part of the power it scatters) lies on the front."""
CYLINDER_COLUMNS = 9
"""end a (3), end b (3), radius_m, reflectivity, albedo."""
SPHERE_COLUMNS = 5
"""centre (3), radius_m, reflectivity."""
EDGE_COLUMNS = 11
"""end a (3), end b (3), unit normal (3) of one adjacent face, reflectivity, corner_radius_m.

Keller's angle phi is taken from the normal; a corner radius of 0 is a hard half-plane edge, more than 0 follows
the cylinder law of that radius.
"""


def _rows(rows: Iterable[Iterable[float]], columns: int) -> NDArray[np.float64]:
    given = [list(row) for row in rows]
    # Columns that a row leaves out at its end are 0.
    array = np.array([row + [0.0] * (columns - len(row)) for row in given], dtype=np.float64).reshape(-1, columns)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Primitives:
    """Acoustic primitives of one shape or of a whole scene; float64, C-contiguous, read-only.

    Attributes:
        facets: (F, 15), see FACET_COLUMNS.
        cylinders: (C, 9), see CYLINDER_COLUMNS.
        edges: (E, 11), see EDGE_COLUMNS.
        spheres: (S, 5), see SPHERE_COLUMNS.
    """

    facets: NDArray[np.float64]
    cylinders: NDArray[np.float64]
    edges: NDArray[np.float64]
    spheres: NDArray[np.float64]

    @staticmethod
    def of(
        facets: Iterable[Iterable[float]] = (),
        cylinders: Iterable[Iterable[float]] = (),
        edges: Iterable[Iterable[float]] = (),
        spheres: Iterable[Iterable[float]] = (),
    ) -> "Primitives":
        """From rows in the column order above."""
        return Primitives(
            _rows(facets, FACET_COLUMNS), _rows(cylinders, CYLINDER_COLUMNS), _rows(edges, EDGE_COLUMNS),
            _rows(spheres, SPHERE_COLUMNS)
        )

    @staticmethod
    def empty() -> "Primitives":
        """No primitives: free field."""
        return Primitives.of()

    @staticmethod
    def concatenate(parts: Iterable["Primitives"]) -> "Primitives":
        """All the rows of the parts, in order."""
        parts = list(parts)
        return Primitives.of(
            [row for p in parts for row in p.facets],
            [row for p in parts for row in p.cylinders],
            [row for p in parts for row in p.edges],
            [row for p in parts for row in p.spheres],
        )

    def __len__(self) -> int:
        return len(self.facets) + len(self.cylinders) + len(self.edges) + len(self.spheres)


def facet_row(
    centre: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    half_u_m: float,
    half_v_m: float,
    reflectivity: float,
    albedo: float = 0.0,
    flutter_m: float = 0.0,
    closed: bool = False,
) -> list[float]:
    """One row of `Primitives.facets`; u and v are unit vectors, metres otherwise."""
    return [*map(float, centre), *map(float, u), *map(float, v), half_u_m, half_v_m, reflectivity, albedo, flutter_m,
            float(closed)]


def cylinder_row(
    end_a: NDArray[np.float64], end_b: NDArray[np.float64], radius_m: float, reflectivity: float, albedo: float = 0.0
) -> list[float]:
    """One row of `Primitives.cylinders`."""
    return [*map(float, end_a), *map(float, end_b), radius_m, reflectivity, albedo]


def sphere_row(centre: NDArray[np.float64], radius_m: float, reflectivity: float) -> list[float]:
    """One row of `Primitives.spheres`."""
    return [*map(float, centre), radius_m, reflectivity]


def edge_row(
    end_a: NDArray[np.float64],
    end_b: NDArray[np.float64],
    face_normal: NDArray[np.float64],
    reflectivity: float,
    corner_radius_m: float,
) -> list[float]:
    """One row of `Primitives.edges`."""
    return [*map(float, end_a), *map(float, end_b), *map(float, face_normal), reflectivity, corner_radius_m]
