"""A cardboard box standing on the ground or above it, turned about the vertical."""

import math
from typing import Literal

import numpy as np

from sitl.primitives import Primitives, edge_row, facet_row
from sitl.shapes.base import BOX_TRIANGLES, Floats, ShapeTable, Triangles, box_corners
from sitl.solids import box_solid
from sitl.validation import NotNegative, Positive

DOWN = np.array([0.0, 0.0, 1.0])


class Box(ShapeTable):
    """A box with its centre over (x_m, y_m).

    Its flat faces send the beam back only where they face the sensor; the corners, rounded to
    `corner_radius_m`, follow the cylinder law. The signed distance takes the corners as sharp, which errs to the
    safe side by at most 0.41 corner radii.

    Attributes:
        yaw_deg: turn from world x towards y (clockwise seen from above).
        length_m, width_m, height_m: along its own x, its own y, and up.
        base_height_m: of its underside above the ground.
    """

    kind: Literal["box"] = "box"
    x_m: float
    y_m: float
    length_m: Positive
    width_m: Positive
    height_m: Positive
    yaw_deg: float = 0.0
    base_height_m: NotNegative = 0.0
    corner_radius_m: NotNegative = 0.004
    material: str = "cardboard"

    def _centre(self) -> Floats:
        return np.array([self.x_m, self.y_m, -self.base_height_m - self.height_m / 2])

    def _axes(self) -> Floats:
        c, s = math.cos(math.radians(self.yaw_deg)), math.sin(math.radians(self.yaw_deg))
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def _half(self) -> tuple[float, float, float]:
        return self.length_m / 2, self.width_m / 2, self.height_m / 2

    def solids(self) -> Floats:
        return np.array([box_solid(self._centre(), self._axes(), self._half())])

    def primitives(self) -> Primitives:
        """Four sides and the top as facets, four upright corners and four top edges; the underside is unseen."""
        centre, (ax, ay, _), (hx, hy, hz) = self._centre(), self._axes(), self._half()
        r, rough, rc = self.reflectivity, self.albedo, self.corner_radius_m
        up = -DOWN
        facets, edges = [facet_row(centre + hz * up, ay, ax, hy, hx, r, rough, closed=True)], []
        sides = ((ax, hx, ay, hy), (ay, hy, -ax, hx), (-ax, hx, -ay, hy), (-ay, hy, ax, hx))
        for normal, half_n, along, half_a in sides:
            middle = centre + half_n * normal
            # u x v = normal with v down; the face's corner in the direction `along` is the one counted here.
            facets.append(facet_row(middle, np.cross(DOWN, normal), DOWN, half_a, hz, r, rough, closed=True))
            corner = middle + half_a * along
            edges.append(edge_row(corner + hz * DOWN, corner + hz * up, normal, r, rc))
            edges.append(edge_row(middle - half_a * along + hz * up, corner + hz * up, normal, r, rc))
        return Primitives.of(facets=facets, edges=edges)

    def mesh(self) -> tuple[Floats, Triangles]:
        return box_corners(self._centre(), self._axes(), np.array(self._half())), BOX_TRIANGLES

    def describe(self) -> str:
        return f"box at x {self.x_m:.2f} m, y {self.y_m:.2f} m"


SHAPE = Box
