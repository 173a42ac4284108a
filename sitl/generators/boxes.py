"""Cardboard boxes in random pose, staggered around the line of a straight flight."""

from typing import Literal

import numpy as np
from pydantic import Field

from sitl.generators.base import GeneratorTable, stagger
from sitl.shapes.box import Box
from sitl.validation import OrderedRange, Positive

_LANES = (0.0, 1.0, -1.0, 0.5, -0.5)


class Boxes(GeneratorTable):
    """Boxes of random size and any yaw; a turned flat face sends the beam away and leaves only its corners.

    Attributes:
        least_count: the number of boxes is drawn from least_count .. count.
        length_m, width_m, height_m: smallest and largest.
        lane_m: how far to both sides of the start's line they reach. None stands further out, so that a vehicle
            which only ever dodges locally is not led into a net.
    """

    kind: Literal["boxes"] = "boxes"
    count: int = Field(default=5, ge=1, le=40)
    least_count: int = Field(default=4, ge=1, le=40)
    length_m: OrderedRange = (0.46, 0.67)
    width_m: OrderedRange = (0.19, 0.25)
    height_m: OrderedRange = (1.15, 1.38)
    material: str = "cardboard"
    spacing_m: Positive = 1.5
    lane_m: Positive = 0.5
    jitter_m: float = Field(default=0.1, ge=0.0, le=1.0)

    def draw(self, rng: np.random.Generator, arena_x_m: tuple[float, float], arena_y_m: tuple[float, float],
             start_m: tuple[float, float, float]) -> list[Box]:
        """Boxes of one course; see `Generator.draw`."""
        count = int(rng.integers(min(self.least_count, self.count), self.count + 1))
        lanes = [_LANES[k % len(_LANES)] * self.lane_m for k in range(count)]
        return [Box(x_m=x, y_m=start_m[1] + y, yaw_deg=float(rng.uniform(-90.0, 90.0)),
                    length_m=float(rng.uniform(*self.length_m)), width_m=float(rng.uniform(*self.width_m)),
                    height_m=float(rng.uniform(*self.height_m)), material=self.material)
                for x, y in stagger(rng, self.x_m, self.spacing_m, lanes, self.jitter_m)]


GENERATOR = Boxes
