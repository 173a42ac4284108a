"""What a generator is, and how obstacles are staggered along a course."""

from collections.abc import Sequence
from typing import Protocol, Self, runtime_checkable

import numpy as np
from pydantic import Field, model_validator

from sitl.shapes import Shape
from sitl.validation import NotNegative, OrderedPair, Positive, Table


@runtime_checkable
class Generator(Protocol):
    """Draws the obstacles of one course."""

    @property
    def dodges(self) -> int:
        """How many dodges a course must need, see `sitl.feasibility.dodges_needed`."""

    @property
    def min_gap_m(self) -> float:
        """Least distance between the surfaces of two obstacles."""

    def draw(self, rng: np.random.Generator, arena_x_m: tuple[float, float], arena_y_m: tuple[float, float],
             start_m: tuple[float, float, float]) -> Sequence[Shape]:
        """One drawing for one start; all randomness from `rng`. It may break the scene's rules."""


class GeneratorTable(Table):
    """Keys that every staggering generator has.

    Attributes:
        x_m: first and last place of an obstacle's centre along the course.
        spacing_m: least distance along x from one obstacle in the way to the next.
        min_gap_m: see Generator.
        dodges: see Generator.
    """

    count: int = Field(ge=1, le=40)
    x_m: OrderedPair = (2.3, 8.6)
    spacing_m: Positive
    min_gap_m: NotNegative = 0.9
    dodges: int = Field(default=2, ge=1, le=2)

    @model_validator(mode="after")
    def _room(self) -> Self:
        need = (self.staggered - 1) * self.spacing_m
        if self.x_m[1] - self.x_m[0] < need:
            raise ValueError(f"x_m = {list(self.x_m)} is too short for {self.staggered} obstacles {self.spacing_m:g} m "
                             f"apart ({need:g} m)")
        return self

    @property
    def staggered(self) -> int:
        """How many of `count` stand in the way of the flight."""
        return self.count


def stagger(rng: np.random.Generator, x_m: tuple[float, float], spacing_m: float, offsets_m: Sequence[float],
            jitter_m: float) -> list[tuple[float, float]]:
    """Places (x, y offset from the start): the first straight ahead, the others in the lanes beside it.

    Args:
        x_m: first and last x.
        spacing_m: least distance along x; what is left of the room is shared out at random.
        offsets_m: lanes, the first one taken by the first obstacle, the others in random order.
        jitter_m: uniform, around each lane.
    """
    count = len(offsets_m)
    slack_m = max(x_m[1] - x_m[0] - (count - 1) * spacing_m, 0.0)
    places = np.sort(rng.uniform(0.0, slack_m, count)) + np.arange(count) * spacing_m + x_m[0]
    order = [offsets_m[0], *rng.permutation(np.array(offsets_m[1:], dtype=np.float64))]
    return [(float(x), float(y + rng.uniform(-jitter_m, jitter_m))) for x, y in zip(places, order, strict=True)]
