"""What a shape is, and the parts its kinds share."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from sitl.materials import load_material
from sitl.primitives import Primitives
from sitl.solids import signed_distance_m
from sitl.validation import Table

Floats = NDArray[np.float64]
Triangles = NDArray[np.int64]

BOX_TRIANGLES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                          [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], dtype=np.int64)


@runtime_checkable
class Shape(Protocol):
    """An obstacle. World NED metres; immutable."""

    @property
    def kind(self) -> str:
        """The name scene files know it by."""

    def to_table(self) -> dict[str, Any]:
        """The table it can be read from again, JSON-ready."""

    def solids(self) -> Floats:
        """(S, 16) rows for the signed distance, see `sitl.solids`."""

    def signed_distance_m(self, points: Floats) -> Floats:
        """Distance (K,) of points (K, 3) to the surface, negative inside."""

    def primitives(self) -> Primitives:
        """What the acoustics see of it."""

    def mesh(self) -> tuple[Floats, Triangles]:
        """Vertices (V, 3) and triangles (T, 3) for drawing, outward by the right-hand rule."""

    def describe(self) -> str:
        """Such as "cylinder at x 4.20 m, y -0.31 m"."""


class ShapeTable(Table):
    """Base of the kinds: a checked table that knows its geometry."""

    material: str = "pvc"

    def to_table(self) -> dict[str, Any]:
        """The table it can be read from again, JSON-ready."""
        return self.model_dump(mode="json", exclude_none=True)

    def solids(self) -> Floats:
        """(S, 16), see `sitl.solids`."""
        raise TypeError(f"{type(self).__name__} has no solids")

    def signed_distance_m(self, points: Floats) -> Floats:
        """Distance (K,) of points (K, 3) to the surface, negative inside."""
        return signed_distance_m(self.solids(), points)

    @property
    def reflectivity(self) -> float:
        """Pressure amplitude mirrored, 0..1."""
        return load_material(self.material).reflectivity

    @property
    def albedo(self) -> float:
        """Part of the arriving power that the surface scatters in all directions, 0..1."""
        return load_material(self.material).albedo

    def check_material(self, where: str) -> None:
        """Look the material up now, so that a wrong name is reported with its table.

        Raises:
            UsageError: unknown material.
        """
        try:
            load_material(self.material)
        except UsageError as error:
            raise UsageError(f"{where} material: {error}") from error


def box_corners(centre: Floats, axes: Floats, half_m: Floats) -> Floats:
    """Corners (8, 3) of a box, axes (3, 3) as rows, in the order BOX_TRIANGLES expects."""
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=np.float64)
    return centre + (signs * half_m) @ axes
