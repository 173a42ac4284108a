"""Can a course be flown, and can it be flown without looking? Plane checks at flight height."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sitl.solids import signed_distance_m

AIRFRAME_RADIUS_M = 0.12
"""Around the 160 mm frame with its propellers (118 mm to a propeller's tip)."""
MARGIN_M = 0.20
MUST_FIT_RADIUS_M = AIRFRAME_RADIUS_M + MARGIN_M
HALF_WIDTH_M = 0.0947
"""Half of what the level airframe sweeps flying along x: motors at 56.6 mm plus a propeller's radius of 38.1 mm."""
CELL_M = 0.05
LANE_REACH_M = 0.5
LANE_STEP_M = 0.05
SAMPLE_M = 0.02

Floats = NDArray[np.float64]
Point = tuple[float, float, float]


def way_through(solids: Floats, arena_x_m: tuple[float, float], arena_y_m: tuple[float, float], netted: bool,
                start_m: Point, goal_x_m: float, height_m: float, radius_m: float = MUST_FIT_RADIUS_M,
                heights_m: tuple[float, float] | None = None) -> bool:
    """Whether a ball of `radius_m` can move from above the start to x = goal_x_m.

    A grid of 5 cm over the arena, free where the ball touches neither obstacle nor (if netted) net; every neighbour is
    a way. In the plane at `height_m`, or with `heights_m` anywhere between those two. The arena's own end behind the
    start and beyond the goal do not count.

    Args:
        solids: (S, 16) as in `sitl.solids`.
    """
    xs = np.arange(arena_x_m[0], arena_x_m[1] + CELL_M / 2, CELL_M)
    ys = np.arange(arena_y_m[0], arena_y_m[1] + CELL_M / 2, CELL_M)
    zs = np.array([height_m]) if heights_m is None else np.arange(heights_m[0], heights_m[1] + CELL_M / 2, CELL_M)
    grid = np.stack(np.meshgrid(xs, ys, -zs, indexing="ij"), axis=-1).reshape(-1, 3)
    free = (signed_distance_m(solids, grid) >= radius_m).reshape(len(xs), len(ys), len(zs))
    if netted:
        free &= ((ys - arena_y_m[0] >= radius_m) & (arena_y_m[1] - ys >= radius_m))[None, :, None]
    labels, _ = ndimage.label(free, structure=np.ones((3, 3, 3)))
    i = int(np.argmin(np.abs(xs - start_m[0])))
    j = int(np.argmin(np.abs(ys - start_m[1])))
    home = labels[i, j, int(np.argmin(np.abs(zs - height_m)))]
    return bool(home != 0 and np.any(labels[xs >= goal_x_m] == home))


def lane_clearance_m(solids: Floats, from_x_m: float, to_x_m: float, y_m: Floats, height_m: float) -> Floats:
    """Smallest obstacle distance (L,) on straight lines along x at each y (L,); inf without obstacles."""
    xs = np.arange(from_x_m, to_x_m + SAMPLE_M, SAMPLE_M)
    grid = np.stack(np.meshgrid(y_m, xs, [-height_m], indexing="ij"), axis=-1)[..., [1, 0, 2]].reshape(-1, 3)
    return signed_distance_m(solids, grid).reshape(len(y_m), len(xs)).min(axis=1)


def straight_flight_hits(solids: Floats, start_m: Point, goal_x_m: float, height_m: float) -> bool:
    """Whether the level airframe, flown straight along x from the start at `height_m`, touches an obstacle."""
    lane = lane_clearance_m(solids, start_m[0], goal_x_m, np.array([start_m[1]]), height_m)
    # Samples 2 cm apart along x overestimate the distance to a round pole by under 1 mm.
    return bool(lane[0] < HALF_WIDTH_M - 0.001)


def dodges_needed(solids: Floats, start_m: Point, goal_x_m: float, height_m: float) -> int:
    """0, 1 or 2: how many sideways moves of at most half a metre the course asks for at least.

    0 when a straight flight passes; 1 when some straight lane within LANE_REACH_M of the start's is free all the
    way; otherwise 2, which means two or more.
    """
    if not straight_flight_hits(solids, start_m, goal_x_m, height_m):
        return 0
    lanes = start_m[1] + np.arange(-LANE_REACH_M, LANE_REACH_M + LANE_STEP_M / 2, LANE_STEP_M)
    free = lane_clearance_m(solids, start_m[0], goal_x_m, lanes, height_m) >= HALF_WIDTH_M
    return 1 if bool(np.any(free)) else 2
