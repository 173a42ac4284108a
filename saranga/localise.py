"""Where the obstacles are: from edges of two or three echo images to positions (Algorithm 1, paper eqs 11-14).

Geometry. The left sensor transmits, so the path of an echo is p_L = 2 r_L at the left sensor and
p_R = r_L + r_R at the right one; their disparity dp_H = p_L - p_R = r_L - r_R is positive for an obstacle nearer
to the right sensor, which is y > 0 (right) in body FRD. In the same way dp_V = p_L - p_D > 0 is nearer to the
lower sensor, z > 0 (down). Where the printed equations are wrong this follows the errata: direction cosines
(y = r dp_H / b_H, z = r dp_V / b_V, x the rest, rejected when imaginary) instead of spherical angles, and a median
over the matches of each p_L. Positions are from the sonar, along the body axes: y from the middle between left and
right sensor, z from the middle between left and lower one (r_L^2 - r_R^2 = 2 b y about that middle).
"""

from dataclasses import dataclass
from math import asin, atan2
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from saranga.errors import UsageError
from saranga.resample import COLUMN_M
from saranga.sonar_geometry import SonarGeometry

Matching = Literal["one_to_one", "median"]

DISPARITY_TOLERANCE = 0.15
"""A disparity up to this share over the baseline is noise and is clamped to it; beyond it is no match. One column
of noise is 6 % of a 0.10 m baseline."""


@dataclass(frozen=True)
class Obstacle:
    """One echoing point, body FRD: azimuth positive right, elevation positive down (as z is), in radians.

    `range_m` is (r_L + r_R) / 2 in 2-D and p_L / 2 in 3-D; `score` is the strength of the left edge, 0..1.
    """

    range_m: float
    azimuth_rad: float
    elevation_rad: float
    x_m: float
    y_m: float
    z_m: float
    score: float


def edges(
    edge_row: NDArray[np.float32], threshold: float, *, refine: bool = True, offset_m: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Path lengths of the edges in the newest row of an edge map.

    Args:
        edge_row: (N,), edge strength 0..1 a column; NaN counts as nothing there.
        threshold: the paper's tau_c.
        refine: one sub-sample position for every run of columns over the threshold (centroid of the run and of the
            neighbour on each side); False gives every column over the threshold, as the paper does.
        offset_m: the denoiser's `edge_offset_m`, range by which its edges lie beyond the obstacle.

    Returns:
        Paths in metres (k,), rising, and strengths (k,).
    """
    row = np.ascontiguousarray(edge_row, dtype=np.float32)
    columns, strength = _runs(row, np.float32(threshold), refine)
    paths = 2.0 * (columns * COLUMN_M - offset_m)
    ahead = paths > 0.0
    return paths[ahead], strength[ahead]


def localise(
    paths_left: ArrayLike,
    paths_right: ArrayLike,
    paths_down: ArrayLike | None,
    geometry: SonarGeometry,
    strengths: ArrayLike | None = None,
    *,
    matching: Matching = "one_to_one",
    tolerance: float = DISPARITY_TOLERANCE,
) -> list[Obstacle]:
    """Obstacles from the path lengths of each sensor's edges (Algorithm 1 with errata).

    Args:
        paths_left, paths_right, paths_down: metres; `paths_down` None (or a missing third sensor) is the 2-D case.
        geometry: gives baseline_h_m and baseline_v_m.
        strengths: of the left edges, becomes `Obstacle.score` (1 where absent).
        matching: `one_to_one` pairs each left edge with at most one edge of the other sensor, as many pairs as
            possible at the least sum of squared disparities; `median` is the paper's: every pair within the
            baseline, then the median disparity of each left edge.
        tolerance: share of the baseline by which a disparity may exceed it and be clamped (noise).

    Returns:
        Sorted by range. Edges with no partner, and triplets whose x would be imaginary, give nothing.

    Raises:
        UsageError: unknown `matching`, or `paths_down` with a geometry that has no down sensor.
    """
    if matching not in ("one_to_one", "median"):
        raise UsageError(f"unknown matching {matching!r}: known are one_to_one, median")
    left = np.asarray(paths_left, dtype=np.float64).ravel()
    order = np.argsort(left, kind="stable")
    left = left[order]
    right = np.sort(np.asarray(paths_right, dtype=np.float64).ravel())
    score = np.ones(left.size) if strengths is None else np.asarray(strengths, dtype=np.float64).ravel()[order]
    three_d = paths_down is not None
    if three_d and geometry.baseline_v_m <= 0.0:
        raise UsageError(f"sonar {geometry.name!r} has no down sensor but paths_down is given: use a suite with three "
                         "sensors, or None")
    down = np.sort(np.asarray(paths_down, dtype=np.float64).ravel()) if three_d else np.empty(0)
    one_to_one = matching == "one_to_one"
    limit_h, limit_v = (b * (1.0 + tolerance) for b in (geometry.baseline_h_m, geometry.baseline_v_m))
    pair = _one_to_one if one_to_one else _median_disparity
    across = pair(left, right, limit_h)
    return positions(left, across, pair(left, down, limit_v) if three_d else None, geometry, score)


def positions(
    paths_left: ArrayLike,
    across_m: ArrayLike,
    below_m: ArrayLike | None,
    geometry: SonarGeometry,
    strengths: ArrayLike | None = None,
) -> list[Obstacle]:
    """Obstacles from left paths (k,) and their disparities, however these were found (`saranga.disparity`).

    Args:
        across_m: left less right path, below_m: left less down path (None: 2-D), (k,); NaN: no partner, no obstacle.
            More than the baseline counts as the baseline.
        strengths: becomes `Obstacle.score` (1 where absent).

    Returns:
        Sorted by range.
    """
    left, across = (np.asarray(a, dtype=np.float64).ravel() for a in (paths_left, across_m))
    below = np.zeros(left.size) if below_m is None else np.asarray(below_m, dtype=np.float64).ravel()
    score = np.ones(left.size) if strengths is None else np.asarray(strengths, dtype=np.float64).ravel()
    found = _positions(left, across, below, below_m is not None, geometry.baseline_h_m, geometry.baseline_v_m)
    return [_obstacle(row, score) for row in found]


def _obstacle(row: NDArray[np.float64], score: NDArray[np.float64]) -> Obstacle:
    range_m, x, y, z = (float(v) for v in row[:4])
    elevation = asin(max(-1.0, min(1.0, z / range_m)))
    return Obstacle(range_m, atan2(y, x), elevation, x, y, z, float(score[int(row[4])]))


@njit(cache=True)
def _runs(row, threshold, refine):  # type: ignore[no-untyped-def]
    n = row.size
    columns = np.empty(n)
    strength = np.empty(n)
    k = 0
    i = 0
    while i < n:
        if not row[i] > threshold:
            i += 1
            continue
        if not refine:
            columns[k] = i
            strength[k] = row[i]
            k += 1
            i += 1
            continue
        stop = i
        while stop < n and row[stop] > threshold:
            stop += 1
        weight = 0.0
        moment = 0.0
        peak = 0.0
        for j in range(max(i - 1, 0), min(stop + 1, n)):
            if row[j] > 0.0:
                weight += row[j]
                moment += row[j] * j
                peak = max(peak, row[j])
        if weight > 0.0:
            columns[k] = moment / weight
            strength[k] = peak
            k += 1
        i = stop
    return columns[:k].copy(), strength[:k].copy()


@njit(cache=True)
def _one_to_one(left, other, limit):  # type: ignore[no-untyped-def]
    """Disparity left - partner of each left edge (NaN: none); both inputs rise, so the best pairing never crosses."""
    n, m = left.size, other.size
    count = np.zeros((n + 1, m + 1), dtype=np.int64)
    cost = np.zeros((n + 1, m + 1))
    move = np.zeros((n + 1, m + 1), dtype=np.int8)
    for i in range(1, n + 1):
        for j in range(1, m + 1):
            best, price, step = count[i - 1, j], cost[i - 1, j], 1
            if count[i, j - 1] > best or (count[i, j - 1] == best and cost[i, j - 1] < price):
                best, price, step = count[i, j - 1], cost[i, j - 1], 2
            gap = left[i - 1] - other[j - 1]
            if abs(gap) <= limit:
                pairs, paid = count[i - 1, j - 1] + 1, cost[i - 1, j - 1] + gap * gap
                if pairs > best or (pairs == best and paid < price):
                    best, price, step = pairs, paid, 3
            count[i, j], cost[i, j], move[i, j] = best, price, step
    disparity = np.full(n, np.nan)
    i, j = n, m
    while i > 0 and j > 0:
        if move[i, j] == 3:
            disparity[i - 1] = left[i - 1] - other[j - 1]
            i -= 1
            j -= 1
        elif move[i, j] == 1:
            i -= 1
        else:
            j -= 1
    return disparity


@njit(cache=True)
def _median_disparity(left, other, limit):  # type: ignore[no-untyped-def]
    disparity = np.full(left.size, np.nan)
    for i in range(left.size):
        near = left[i] - other[np.abs(left[i] - other) <= limit]
        if near.size:
            disparity[i] = np.median(near)
    return disparity


@njit(cache=True)
def _positions(left, across, below, three_d, base_h, base_v):  # type: ignore[no-untyped-def]
    out = np.empty((left.size, 5))
    k = 0
    for i in range(left.size):
        if np.isnan(across[i]) or np.isnan(below[i]):
            continue
        r = left[i] / 2.0 if three_d else (left[i] - across[i]) / 2.0
        sine_h = min(1.0, max(-1.0, across[i] / base_h))
        sine_v = min(1.0, max(-1.0, below[i] / base_v)) if three_d else 0.0
        rest = 1.0 - sine_h * sine_h - sine_v * sine_v
        if rest < 0.0 or r <= 0.0:
            continue
        out[k, 0] = r
        out[k, 1] = r * np.sqrt(rest)
        out[k, 2] = r * sine_h
        out[k, 3] = r * sine_v
        out[k, 4] = i
        k += 1
    found = out[:k]
    return found[np.argsort(found[:, 0], kind="mergesort")]
