"""Obstacles of several kinds, staggered in random order around the line of a straight flight."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from sitl.generators.base import GeneratorTable, stagger
from sitl.shapes import Shape, shape_from_table
from sitl.validation import OrderedRange, Positive, Table

LANES = (0.0, 1.0, -1.0, 0.5, -0.5)


def _texts(value: Any) -> Any:
    return (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


Texts = Annotated[tuple[str, ...], BeforeValidator(_texts)]


class Part(Table):
    """One kind of obstacle; every range is a number or [smallest, largest], drawn uniformly.

    Attributes:
        shape: box; pole (upright, or leaning by `tilt_deg` about its middle; 90 is level); sheet (a thin flat wall).
        count: how many of it.
        length_m, width_m: of a box or sheet (a sheet has no width).
        diameter_m: of a pole.
        height_m: of a box or sheet; length of a pole.
        base_height_m: of the lower side above the ground (upright ones), or of a leaning pole's middle.
        yaw_deg, tilt_deg: turned about the vertical; leaning from it.
        material: one of these, by chance.
        aside: stands in no lane of its own, but anywhere across the course.
    """

    shape: Literal["box", "pole", "sheet"]
    count: int = Field(ge=1, le=40)
    length_m: OrderedRange = (0.5, 0.5)
    width_m: OrderedRange = (0.2, 0.2)
    diameter_m: OrderedRange = (0.06, 0.06)
    height_m: OrderedRange = (1.8, 1.8)
    base_height_m: OrderedRange = (0.0, 0.0)
    yaw_deg: OrderedRange = (-90.0, 90.0)
    tilt_deg: OrderedRange = (0.0, 0.0)
    material: Texts = ("cardboard",)
    aside: bool = False

    def draw(self, rng: np.random.Generator, x_m: float, y_m: float) -> Shape:
        """One of it at a place."""
        def some(limits: tuple[float, float]) -> float:
            return round(float(rng.uniform(*limits)), 4)

        table: dict[str, Any] = {"material": str(rng.choice(np.array(self.material)))}
        yaw_deg, height_m, base_m = some(self.yaw_deg), some(self.height_m), some(self.base_height_m)
        turn = math.radians(yaw_deg)
        if self.shape == "box":
            table |= {"kind": "box", "x_m": x_m, "y_m": y_m, "yaw_deg": yaw_deg, "length_m": some(self.length_m),
                      "width_m": some(self.width_m), "height_m": height_m, "base_height_m": base_m}
        elif self.shape == "sheet":
            half = some(self.length_m) / 2
            dx, dy = half * math.cos(turn), half * math.sin(turn)
            table |= {"kind": "wall", "from_m": [x_m - dx, y_m - dy], "to_m": [x_m + dx, y_m + dy],
                      "height_m": height_m, "base_height_m": base_m}
        else:
            table |= {"kind": "cylinder", "diameter_m": some(self.diameter_m)}
            tilt = math.radians(some(self.tilt_deg))
            if tilt == 0.0:
                table |= {"x_m": x_m, "y_m": y_m, "height_m": height_m, "base_height_m": base_m}
            else:
                across = 0.5 * height_m * math.sin(tilt)
                up = 0.5 * height_m * math.cos(tilt)
                middle = max(base_m, up + 0.01)
                dx, dy = across * math.cos(turn), across * math.sin(turn)
                table |= {"end_a_m": [x_m - dx, y_m - dy, middle - up], "end_b_m": [x_m + dx, y_m + dy, middle + up]}
        return shape_from_table(table, "generator")


class Mixed(GeneratorTable):
    """Obstacles of all `part`s in random order, in lanes around the start's line.

    Attributes:
        part: what there is.
        lane_m: how far to both sides of the start's line the obstacles in the way reach.
        aside_m: how far from the middle of the arena the others may stand.
    """

    kind: Literal["mixed"] = "mixed"
    count: int = Field(default=1, ge=1, le=40)
    part: Annotated[tuple[Part, ...], BeforeValidator(lambda v: tuple(v) if isinstance(v, list) else v)] = Field(
        min_length=1)
    spacing_m: Positive = 1.5
    lane_m: Positive = 0.5
    jitter_m: float = Field(default=0.1, ge=0.0, le=1.0)
    aside_m: Positive = 1.8

    @property
    def staggered(self) -> int:
        return max(1, sum(part.count for part in self.part if not part.aside))

    def draw(self, rng: np.random.Generator, arena_x_m: tuple[float, float], arena_y_m: tuple[float, float],
             start_m: tuple[float, float, float]) -> list[Shape]:
        """Obstacles of one course; see `Generator.draw`."""
        ahead = [part for part in self.part if not part.aside for _ in range(part.count)]
        lanes = [LANES[k % len(LANES)] * self.lane_m for k in range(len(ahead))]
        order = rng.permutation(len(ahead))
        places = stagger(rng, self.x_m, self.spacing_m, lanes, self.jitter_m) if ahead else []
        middle = 0.5 * (arena_y_m[0] + arena_y_m[1])
        shapes = [ahead[k].draw(rng, x, start_m[1] + y) for k, (x, y) in zip(order, places, strict=True)]
        for part in self.part:
            if part.aside:
                shapes += [part.draw(rng, float(rng.uniform(*self.x_m)),
                                     middle + float(rng.uniform(-self.aside_m, self.aside_m)))
                           for _ in range(part.count)]
        return shapes


GENERATOR = Mixed
