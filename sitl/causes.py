"""Why a flight ended as it did: one label a flight, with the numbers behind it.

Labels: clean, infrastructure, interrupted, estimator, stuck, timeout as the judge has them; a hit is one of
`rear_strike` (struck by a part behind the vehicle's middle after the obstacle was passed), `never_detected`, `late`
(first seen nearer than the sideways move needs), `wrong_side` (steered towards it), `blown_by_wind` (steered away,
moved towards it), `misjudged` (seen in time, steered away, and still hit); a touched net is `net`, with what led there.

The distance a dodge needs: at speed v, to move y sideways at the acceleration A takes sqrt(2 y / A) and the stack and
the autopilot take DELAY first, so v (DELAY + sqrt(2 y / A)) - with y the airframe's half width plus half the margin.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.shapes import shape_from_table
from sitl.solids import signed_distance_m, surface_points
from sitl.trial_types import FlightLog

SAME_OBSTACLE_M = 0.30
"""A position the stack reports belongs to an obstacle whose surface is within this."""
SIDEWAYS_M = 0.22
"""Half of what the airframe sweeps, and half the room it should keep."""
ACCELERATION_M_S2 = 2.5
DELAY_S = 0.25
"""Compute, the stack's tick, the image's memory and the vehicle's lean."""
LOOK_BACK_S = 1.0
WIND_M_S = 0.25
PLAIN = ("clean", "infrastructure", "interrupted", "stuck", "timeout")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Label:
    """`name` as in the module; `reason` one line."""

    name: str
    reason: str


def label_of(outcome: str, cause: str, part: str | None, obstacle: int | None, log: FlightLog | None) -> Label:
    """Label a flight.

    Args:
        outcome, cause, part, obstacle: of the judge (`sitl.judge.Judgement`).
        log: what was flown; without it only the outcome is known.
    """
    if outcome in PLAIN:
        return Label(outcome, cause)
    if outcome == "estimator_failure":
        return Label("estimator", cause)
    if log is None or len(log.t_us) < 2:
        return Label("net" if outcome == "net_hit" else "unknown", f"{cause}; no flight log to tell why")
    if outcome == "net_hit":
        return _net(cause, log)
    if obstacle is None or obstacle >= len(log.scene.get("obstacles", [])):
        return Label("unknown", cause)
    return _hit(cause, part, obstacle, log)


def _hit(cause: str, part: str | None, obstacle: int, log: FlightLog) -> Label:
    solids = shape_from_table(log.scene["obstacles"][obstacle]).solids()
    last = len(log.t_us) - 1
    end = log.pos_m[last]
    nearest = _nearest_point(solids, end)
    ahead, right = _in_body(log, last, nearest - end)[:2]
    if ahead < -0.02 and (part in ("rear", "side", "propeller")):
        return Label("rear_strike", f"{-ahead:.2f} m behind the vehicle's middle when struck; {cause}")
    seen = _seen_at_m(log, solids)
    speed = float(np.median(np.linalg.norm(log.vel_m_s[max(last - 16, 0):last + 1, :2], axis=1)))
    needed = speed * (DELAY_S + math.sqrt(2.0 * SIDEWAYS_M / ACCELERATION_M_S2))
    if seen is None:
        return Label("never_detected", f"no position reported within {SAME_OBSTACLE_M:g} m of it; {cause}")
    if seen < needed:
        return Label("late", f"first seen at {seen:.2f} m, {needed:.2f} m needed at {speed:.2f} m/s; {cause}")
    back = log.t_us >= log.t_us[last] - LOOK_BACK_S * 1e6
    commanded = float(log.command[back, 1].mean())
    moved = float(np.mean([_in_body(log, k, log.vel_m_s[k])[1] for k in np.flatnonzero(back)]))
    side = math.copysign(1.0, right)
    if commanded * side > 0.05:
        return Label("wrong_side", f"steered {commanded:+.2f} m/s, the obstacle at {right:+.2f} m; {cause}")
    if -commanded * side > 0.05 and moved * side > -0.02 and abs(moved - commanded) > WIND_M_S:
        return Label("blown_by_wind", f"steered {commanded:+.2f} m/s, moved {moved:+.2f} m/s; {cause}")
    return Label("misjudged", f"seen at {seen:.2f} m, steered {commanded:+.2f} m/s with it at {right:+.2f} m; {cause}")


def _net(cause: str, log: FlightLog) -> Label:
    back = log.t_us >= log.t_us[-1] - LOOK_BACK_S * 1e6
    commanded = float(log.command[back, 1].mean())
    moved = float(np.mean([_in_body(log, k, log.vel_m_s[k])[1] for k in np.flatnonzero(back)]))
    if abs(moved - commanded) > WIND_M_S:
        return Label("net", f"steered {commanded:+.2f} m/s, moved {moved:+.2f} m/s; {cause}")
    return Label("net", f"dodging at {commanded:+.2f} m/s; nets return no echo; {cause}")


def _seen_at_m(log: FlightLog, solids: Floats) -> float | None:
    """Distance to the obstacle when the stack first reported it for two ticks in a row."""
    before = False
    for k, found in enumerate(log.obstacles):
        world = [log.pos_m[k] + _to_world(log, k, np.array([o.x_m, o.y_m, o.z_m])) for o in found
                 if math.isfinite(o.x_m + o.y_m + o.z_m)]
        here = bool(world) and float(np.abs(signed_distance_m(solids, np.array(world))).min()) <= SAME_OBSTACLE_M
        if here and before:
            return float(signed_distance_m(solids, log.pos_m[k:k + 1])[0])
        before = here
    return None


def _nearest_point(solids: Floats, at: Floats) -> Floats:
    points = np.concatenate([surface_points(row, 0.03) for row in solids])
    return points[int(np.argmin(np.linalg.norm(points - at, axis=1)))]


def _rotation(quat: Floats) -> Floats:
    w, x, y, z = quat
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def _to_world(log: FlightLog, k: int | np.integer[Any], body: Floats) -> Any:
    return _rotation(log.quat[k]) @ body


def _in_body(log: FlightLog, k: int | np.integer[Any], world: Floats) -> Any:
    return _rotation(log.quat[k]).T @ world
