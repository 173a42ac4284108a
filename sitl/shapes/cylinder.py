"""A round pole, pipe or trunk: upright, or with any axis."""

from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from sitl.primitives import Primitives, cylinder_row
from sitl.shapes.base import Floats, ShapeTable, Triangles
from sitl.solids import cylinder_solid
from sitl.validation import NotNegative, Positive, Triple

MESH_SIDES = 24
_UPRIGHT = ("x_m", "y_m", "height_m")


class Cylinder(ShapeTable):
    """A cylinder with flat ends, given upright (x_m, y_m, height_m, base_height_m) or by its two ends.

    Attributes:
        x_m, y_m: where an upright one stands.
        height_m: length of an upright one.
        base_height_m: of its lower end above the ground.
        end_a_m, end_b_m: centres of the ends of an oblique one: x, y, height above the ground.
        diameter_m: outer.
    """

    kind: Literal["cylinder"] = "cylinder"
    diameter_m: Positive
    x_m: float | None = None
    y_m: float | None = None
    height_m: Positive | None = None
    base_height_m: NotNegative = 0.0
    end_a_m: Triple | None = None
    end_b_m: Triple | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        upright = [key for key in _UPRIGHT if getattr(self, key) is not None]
        ends = [key for key in ("end_a_m", "end_b_m") if getattr(self, key) is not None]
        if not ((len(upright) == 3 and not ends) or (len(ends) == 2 and not upright and not self.base_height_m)):
            given = ", ".join(upright + ends) or "none of them"
            raise ValueError(f"give either x_m, y_m and height_m, or end_a_m and end_b_m (given: {given})")
        if self.end_a_m is not None and self.end_a_m == self.end_b_m:
            raise ValueError(f"end_a_m and end_b_m are the same point {list(self.end_a_m)}")
        return self

    def ends_m(self) -> tuple[Floats, Floats]:
        """Centres of the two ends, (3,) world NED."""
        if self.end_a_m is not None and self.end_b_m is not None:
            return np.array(self.end_a_m) * (1, 1, -1), np.array(self.end_b_m) * (1, 1, -1)
        assert self.x_m is not None and self.y_m is not None and self.height_m is not None
        low = np.array([self.x_m, self.y_m, -self.base_height_m])
        return low, low - (0.0, 0.0, self.height_m)

    def solids(self) -> Floats:
        return np.array([cylinder_solid(*self.ends_m(), self.diameter_m / 2)])

    def primitives(self) -> Primitives:
        return Primitives.of(cylinders=[cylinder_row(*self.ends_m(), self.diameter_m / 2, self.reflectivity,
                                                     self.albedo)])

    def mesh(self) -> tuple[Floats, Triangles]:
        """Vertices (2 n + 2, 3) and triangles: two rings and two centres."""
        row = self.solids()[0]
        u, v, w = row[4:13].reshape(3, 3)
        turn = np.linspace(0, 2 * np.pi, MESH_SIDES, endpoint=False)
        ring = self.diameter_m / 2 * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
        low, high = row[1:4] - row[15] * w, row[1:4] + row[15] * w
        n = MESH_SIDES
        k = np.arange(n)
        after = (k + 1) % n
        triangles = np.concatenate([
            np.stack([k, after, n + after], axis=1), np.stack([k, n + after, n + k], axis=1),
            np.stack([np.full(n, 2 * n), after, k], axis=1),
            np.stack([np.full(n, 2 * n + 1), n + k, n + after], axis=1)])
        return np.concatenate([low + ring, high + ring, [low, high]]), triangles.astype(np.int64)

    def describe(self) -> str:
        low, high = self.ends_m()
        x, y = (low + high)[:2] / 2
        return f"cylinder at x {x:.2f} m, y {y:.2f} m"


SHAPE = Cylinder
