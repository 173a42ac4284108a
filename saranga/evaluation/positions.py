"""Two sensors: azimuth and position through `saranga.localise`."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.evaluation.detections import HIT_M, Truth
from saranga.localise import Matching, edges, localise
from saranga.sonar_geometry import SonarGeometry

EMPTY_RANGE_M = 0.9
"""Range, straight ahead, that stands for an empty answer in the position RMSE: the middle of what the sets draw, the
best that can be said without looking. The paper does not say what it did with empty answers."""
WIDE_DEG = 10.0


@dataclass(frozen=True, eq=False)
class Positions:
    """`azimuth_error_deg`: of every matched hit, (H,); `position_error_m`: (K,) of the strongest answer."""

    azimuth_error_deg: NDArray[np.float64]
    position_error_m: NDArray[np.float64]


def apparent_azimuth(truth: NDArray[Any]) -> NDArray[np.float64]:
    """(K, 4) azimuth that a horizontal pair can see: asin(cos(elevation) sin(azimuth)), radians."""
    return np.arcsin(np.cos(truth["elevation_rad"].astype(np.float64)) * np.sin(truth["azimuth_rad"]))


def locate(rows: NDArray[np.float32], truth: NDArray[Any], sought: Truth, threshold: float, offset_m: float,
           geometry: SonarGeometry, matching: Matching = "one_to_one") -> Positions:
    """Positions from edge rows (K, 2, N) of the left and the right sensor.

    A matched hit is the localised obstacle nearest in range to a true one, within HIT_M of it. The position error is
    that of the obstacle with the strongest left edge, against the nearest true one.
    """
    azimuth = apparent_azimuth(truth)
    range_m = np.where(truth["kind"] >= 0, truth["range_m"].astype(np.float64), np.nan)
    azimuths, distances = [], np.full(len(rows), np.nan)
    for k, (left, right) in enumerate(rows):
        paths, strengths = edges(left, threshold, offset_m=offset_m)
        other, _ = edges(right, threshold, offset_m=offset_m)
        found = localise(paths, other, None, geometry, strengths, matching=matching)
        wanted = np.flatnonzero(sought.sought[k])
        for i in wanted:
            near = min(found, key=lambda o: abs(o.range_m - range_m[k, i]), default=None)
            if near is not None and abs(near.range_m - range_m[k, i]) <= HIT_M:
                azimuths.append(near.azimuth_rad - azimuth[k, i])
        best = max(found, key=lambda o: o.score, default=None)
        x, y = (best.x_m, best.y_m) if best is not None else (EMPTY_RANGE_M, 0.0)
        if wanted.size:
            r, bearing = range_m[k, wanted], azimuth[k, wanted]
            distances[k] = np.hypot(r * np.cos(bearing) - x, r * np.sin(bearing) - y).min()
    return Positions(np.degrees(np.array(azimuths, dtype=np.float64)), distances)
