"""Upright poles clustered around the line of a straight flight."""

from typing import Literal

import numpy as np
from pydantic import Field

from sitl.generators.base import GeneratorTable, stagger
from sitl.shapes.cylinder import Cylinder
from sitl.validation import OrderedPair, Positive


class Poles(GeneratorTable):
    """The first pole stands straight ahead and the next ones close the lanes within half a metre to both sides.

    They follow each other at least `spacing_m` apart along x, so that a vehicle which looks only at the nearest
    one has the room to pass it before the next. The remaining poles stand aside.

    Attributes:
        lane_m: distance between neighbouring lanes; a pole and the airframe close 0.25 m.
        aside_m: how far from the start's line the remaining poles stand, at least and at most.
    """

    kind: Literal["poles"] = "poles"
    count: int = Field(default=6, ge=1, le=40)
    diameter_m: Positive = 0.06
    height_m: Positive = 1.8
    material: str = "pvc"
    spacing_m: Positive = 1.25
    lane_m: Positive = 0.22
    jitter_m: float = Field(default=0.012, ge=0.0, le=0.5)
    blockers: int = Field(default=5, ge=1, le=40)
    aside_m: OrderedPair = (0.95, 1.6)

    @property
    def staggered(self) -> int:
        return min(self.blockers, self.count)

    def draw(self, rng: np.random.Generator, arena_x_m: tuple[float, float], arena_y_m: tuple[float, float],
             start_m: tuple[float, float, float]) -> list[Cylinder]:
        """Poles of one course; see `Generator.draw`."""
        lanes = [(k + 1) // 2 * (1 if k % 2 else -1) * self.lane_m for k in range(self.staggered)]
        places = [(x, start_m[1] + y) for x, y in stagger(rng, self.x_m, self.spacing_m, lanes, self.jitter_m)]
        for _ in range(self.count - self.staggered):
            side = float(rng.choice([-1.0, 1.0]))
            y = start_m[1] + side * float(rng.uniform(*self.aside_m))
            low, high = arena_y_m[0] + self.min_gap_m, arena_y_m[1] - self.min_gap_m
            places.append((float(rng.uniform(*self.x_m)), min(max(y, low), high)))
        return [Cylinder(x_m=x, y_m=y, diameter_m=self.diameter_m, height_m=self.height_m, material=self.material)
                for x, y in places]


GENERATOR = Poles
