"""Figures of one flight that change before its outcome does: what two versions of a stack are compared by.

- `first_seen_m`: distance to an obstacle when the stack first reported it for two ticks in a row; the mean over those
  that the vehicle came within PASSED_M of, 0 for one that was never reported.
- `dodge_from_m`: distance to the nearest obstacle when the vehicle first moved sideways faster than SIDEWAYS_M_S.
- `echo_to_setpoint_ms`: from the arrival of the newest echo to the moment its setpoint reaches the autopilot; mean
  over the course. Lockstep only: simulated, with the modelled compute latency.
- `end_speed_m_s`: over ground, when the flight was over.

Each is NaN where the flight did not show it.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.shapes import shape_from_table
from sitl.solids import signed_distance_m
from sitl.trial_types import FlightLog

SAME_OBSTACLE_M = 0.30
PASSED_M = 1.2
SIDEWAYS_M_S = 0.15

Floats = NDArray[np.float64]


def measures_of(log: FlightLog | None, echo_to_setpoint_ms: float = math.nan) -> dict[str, float]:
    """The figures of the module; without a log only the last argument is known."""
    found = {"first_seen_m": math.nan, "dodge_from_m": math.nan, "echo_to_setpoint_ms": echo_to_setpoint_ms,
             "end_speed_m_s": math.nan}
    if log is None or not len(log.t_us):
        return found
    found["end_speed_m_s"] = float(np.hypot(*log.vel_m_s[-1, :2]))
    course = np.array([phase == "course" for phase in log.phase])
    obstacles = [shape_from_table(table).solids() for table in log.scene.get("obstacles", [])]
    if not obstacles or not course.any():
        return found
    apart = np.stack([signed_distance_m(solids, log.pos_m) for solids in obstacles])
    sideways = np.flatnonzero(course & (np.abs(log.vel_m_s[:, 1]) > SIDEWAYS_M_S))
    if len(sideways):
        found["dodge_from_m"] = float(apart[:, sideways[0]].min())
    ticks, points = _reported(log)
    seen = [_seen_m(solids, apart[k], ticks, points) for k, solids in enumerate(obstacles)
            if apart[k, course].min() <= PASSED_M]
    if seen:
        found["first_seen_m"] = float(np.mean(seen))
    return found


def _reported(log: FlightLog) -> tuple[NDArray[np.int64], Floats]:
    """Tick (K,) and world position (K, 3) of everything the stack reported."""
    rows: list[tuple[int, Any]] = [(tick, o) for tick, found in enumerate(log.obstacles) for o in found
                                   if math.isfinite(o.x_m + o.y_m + o.z_m)]
    ticks = np.array([tick for tick, _ in rows], dtype=np.int64)
    body = np.array([(o.x_m, o.y_m, o.z_m) for _, o in rows], dtype=np.float64).reshape(-1, 3)
    w, vector = log.quat[ticks, :1], log.quat[ticks, 1:]
    cross = 2.0 * np.cross(vector, body)
    return ticks, log.pos_m[ticks] + body + w * cross + np.cross(vector, cross)


def _seen_m(solids: Floats, apart_m: Floats, ticks: NDArray[np.int64], points: Floats) -> float:
    here = np.unique(ticks[np.abs(signed_distance_m(solids, points)) <= SAME_OBSTACLE_M])
    again = here[1:][np.diff(here) == 1]
    return max(float(apart_m[again[0]]), 0.0) if len(again) else 0.0
