"""How far a course lets a robot fly before it meets something, in robot sizes: the traversability of AvoidBench.

From each of many starts over the course the robot, a disc as wide as itself, moves straight along seven headings of a
forward-facing vehicle, 20 degrees apart, until it touches an obstacle or a wall; a start where it does not fit counts
0. The mean free distance over the size is the traversability (Yu et al., "AvoidBench", after Nous et al. 2016; the
paper's section "Experiments": seven sectors of 20 degrees, 1100 trajectories). The size is the wheelbase, 0.16 m: with
it a room with the paper's obstacles gives the paper's figures.

A netted room ends at its nets. An open course is taken as a piece of an endless one, so that a forest has the mean
free path of a forest: a ray that leaves it on one side comes in on the other.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sitl.scene_spec import Arena
from sitl.solids import solid_distance

SIZE_M = 0.16
HEADINGS = 7
HEADING_STEP_DEG = 20.0
SAMPLES = 1100
LONGEST_M = 30.0
_TOUCH_M = 0.005
_PHI2 = 1.32471795724474602596
"""Plastic number: starts are its low-discrepancy sequence, the same for every course."""


@dataclass(frozen=True)
class Traversability:
    """Of one course.

    Attributes:
        mean: free distance over the robot's size, all starts and headings.
        std: standard deviation over the starts.
        starts_m: (K, 2) x, y.
        free_m: (K, 7) free distance along each heading, 0 where the robot does not fit.
        height_m: at which the rays run.
    """

    mean: float
    std: float
    starts_m: NDArray[np.float64]
    free_m: NDArray[np.float64]
    height_m: float


def traversability(solids: NDArray[np.float64], arena: Arena, height_m: float, x_m: tuple[float, float] | None = None,
                   samples: int = SAMPLES, size_m: float = SIZE_M, headings_rad: NDArray[np.float64] | None = None
                   ) -> Traversability:
    """Traversability of a course at flight height.

    Args:
        solids: (S, 16) as in `sitl.solids`.
        arena: walls of a netted room; the tile of an open one.
        height_m: of the rays.
        x_m: part of an open arena that obstacles stand in; the tile ends there.
        samples: starts and headings together, as the paper counts its trajectories.
        headings_rad: from x towards y; the paper's seven if left out.
    """
    if headings_rad is None:
        headings_rad = np.radians(HEADING_STEP_DEG * (np.arange(HEADINGS) - HEADINGS // 2))
    low = np.array([arena.x_m[0], arena.y_m[0]])
    high = np.array([arena.x_m[1], arena.y_m[1]])
    if not arena.netted and x_m is not None:
        low[0], high[0] = x_m
    count = math.ceil(samples / len(headings_rad))
    at = (np.arange(1, count + 1)[:, None] * np.array([1.0 / _PHI2, 1.0 / _PHI2**2])) % 1.0
    starts = low + at * (high - low)
    free = np.empty((count, len(headings_rad)))
    _march(solids, starts, np.ascontiguousarray(headings_rad), low, high, arena.netted, -height_m, size_m / 2.0, free)
    return Traversability(float(free.mean() / size_m), float(free.mean(axis=1).std() / size_m), starts, free, height_m)


@njit(cache=True)
def _march(solids, starts, headings, low, high, walls, z, radius, out):  # type: ignore[no-untyped-def]
    """Free distances (K, H) by stepping as far as the nearest obstacle allows."""
    for k in range(starts.shape[0]):
        for h in range(headings.size):
            dx, dy = math.cos(headings[h]), math.sin(headings[h])
            x, y, gone = starts[k, 0], starts[k, 1], 0.0
            while gone < LONGEST_M:
                gap = np.inf
                for s in range(solids.shape[0]):
                    gap = min(gap, solid_distance(solids[s], x, y, z))
                if walls:
                    gap = min(gap, x - low[0], high[0] - x, y - low[1], high[1] - y)
                else:
                    # an obstacle beyond the edge of the tile is only seen once the ray is there
                    gap = min(gap, radius + 0.25)
                gap -= radius
                if gap < _TOUCH_M:
                    break
                gone += gap
                x += gap * dx
                y += gap * dy
                if not walls:
                    x = low[0] + (x - low[0]) % (high[0] - low[0])
                    y = low[1] + (y - low[1]) % (high[1] - low[1])
            out[k, h] = min(gone, LONGEST_M)
