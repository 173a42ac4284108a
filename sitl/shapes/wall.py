"""A thin upright wall or panel: flat, with hard edges at its ends."""

from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from sitl.materials import load_material
from sitl.primitives import Primitives, edge_row, facet_row
from sitl.shapes.base import BOX_TRIANGLES, Floats, ShapeTable, Triangles, box_corners
from sitl.solids import box_solid
from sitl.validation import NotNegative, Pair, Positive

DOWN = np.array([0.0, 0.0, 1.0])


class Wall(ShapeTable):
    """A wall over the line from `from_m` to `to_m` on the ground.

    The acoustics see one two-sided facet in its middle plane, so keep `thickness_m` small.

    Attributes:
        from_m, to_m: x and y of its ends.
        height_m, base_height_m: its extent and its lower edge above the ground.
    """

    kind: Literal["wall"] = "wall"
    from_m: Pair
    to_m: Pair
    height_m: Positive
    base_height_m: NotNegative = 0.0
    thickness_m: Positive = 0.005
    material: str = "board"

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.from_m == self.to_m:
            raise ValueError(f"from_m and to_m are the same point {list(self.from_m)}")
        return self

    def _frame(self) -> tuple[Floats, Floats, float]:
        """Centre, axes as rows (along, across, down), half length."""
        a, b = np.array(self.from_m), np.array(self.to_m)
        length = float(np.linalg.norm(b - a))
        along = np.array([*(b - a) / length, 0.0])
        centre = np.array([*(a + b) / 2, -self.base_height_m - self.height_m / 2])
        return centre, np.array([along, np.cross(DOWN, along), DOWN]), length / 2

    def solids(self) -> Floats:
        centre, axes, half = self._frame()
        return np.array([box_solid(centre, axes, (half, self.thickness_m / 2, self.height_m / 2))])

    def primitives(self) -> Primitives:
        """The facet and its two upright edges, hard (Keller); a rough wall has a second, only diffuse facet behind."""
        centre, (along, across, _), half = self._frame()
        half_h, r = self.height_m / 2, self.reflectivity
        # along x down points to -across; turn u so that the normal is `across`.
        facets = [facet_row(centre, -along, DOWN, half, half_h, r, self.albedo, load_material(self.material).flutter_m)]
        if self.albedo > 0.0:
            facets.append(facet_row(centre, along, DOWN, half, half_h, 0.0, self.albedo))
        edges = [edge_row(end + half_h * DOWN, end - half_h * DOWN, across, r, 0.0)
                 for end in (centre - half * along, centre + half * along)]
        return Primitives.of(facets=facets, edges=edges)

    def mesh(self) -> tuple[Floats, Triangles]:
        centre, axes, half = self._frame()
        return box_corners(centre, axes, np.array([half, self.thickness_m / 2, self.height_m / 2])), BOX_TRIANGLES

    def describe(self) -> str:
        (ax, ay), (bx, by) = self.from_m, self.to_m
        return f"wall from x {ax:.2f} m, y {ay:.2f} m to x {bx:.2f} m, y {by:.2f} m"


SHAPE = Wall
