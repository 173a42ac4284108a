"""A forest: trunks at random, at a stated density, with branches above and beside the flight."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from sitl.shapes import Shape
from sitl.shapes.tree import Tree
from sitl.validation import NotNegative, OrderedPair, OrderedRange, Table


class Forest(Table):
    """Trees in the whole arena between `x_m`, no two trunks nearer than `trunk_gap_m`.

    Attributes:
        x_m: first and last trunk along the course.
        density_m2: trunks a square metre.
        diameter_m, height_m: of the trunk.
        branches: a tree; between `branch_height_m` above the ground.
        dodges: see `Generator`.
    """

    kind: Literal["forest"] = "forest"
    x_m: OrderedPair = (2.0, 11.0)
    density_m2: float = Field(gt=0.0, le=3.0)
    diameter_m: OrderedRange = (0.2, 0.3)
    height_m: OrderedRange = (5.0, 9.0)
    branches: int = Field(default=4, ge=0, le=40)
    branch_height_m: OrderedPair = (1.7, 4.0)
    branch_length_m: OrderedRange = (0.3, 0.9)
    leaves: int = Field(default=6, ge=0, le=200)
    trunk_gap_m: NotNegative = 0.9
    dodges: int = Field(default=1, ge=1, le=2)

    @property
    def min_gap_m(self) -> float:
        """Branches of neighbours may meet; the trunks are kept apart in the drawing."""
        return 0.0

    def draw(self, rng: np.random.Generator, arena_x_m: tuple[float, float], arena_y_m: tuple[float, float],
             start_m: tuple[float, float, float]) -> list[Shape]:
        """Trees of one course; see `Generator.draw`. Places that would stand too near another are drawn again."""
        area_m2 = (self.x_m[1] - self.x_m[0]) * (arena_y_m[1] - arena_y_m[0])
        wanted = math.floor(self.density_m2 * area_m2 + float(rng.uniform()))
        centres: list[tuple[float, float, float]] = []
        for _ in range(200 * max(wanted, 1)):
            if len(centres) == wanted:
                break
            x, y = float(rng.uniform(*self.x_m)), float(rng.uniform(*arena_y_m))
            diameter_m = float(rng.uniform(*self.diameter_m))
            if all(math.hypot(x - a, y - b) > self.trunk_gap_m + 0.5 * (diameter_m + d) for a, b, d in centres):
                centres.append((x, y, diameter_m))
        return [Tree(x_m=x, y_m=y, diameter_m=d, height_m=float(rng.uniform(*self.height_m)), branches=self.branches,
                     branch_height_m=self.branch_height_m, branch_length_m=self.branch_length_m, leaves=self.leaves,
                     seed=int(rng.integers(2**31))) for x, y, d in centres]


GENERATOR = Forest
