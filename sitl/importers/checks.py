"""Numbers out of foreign files, and the course that a straight line from a start to a goal makes."""

import math
from pathlib import Path
from typing import Any

from saranga.errors import UsageError

LONG_M = 60.0
"""Beyond this a course is flown at 2 m/s, the paper's fastest, else at 1 m/s."""
LEAST_TIMEOUT_S, USUAL_TIMEOUT_S = 60.0, 140.0
"""The upper one leaves time for take-off in the 180 s that a flight may take by default."""
LARGEST_M = 1000.0


def number(value: Any, where: str, *, above: float | None = None) -> float:
    """A finite number; text such as `1e1`, which YAML 1.1 does not take for a number, counts.

    Raises:
        UsageError: it is none, is beyond a kilometre, or not above `above`.
    """
    try:
        found = math.nan if isinstance(value, bool) or value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found) or abs(found) > LARGEST_M:
        raise UsageError(f"{where} = {value!r}: must be a number, finite and within {LARGEST_M:g}; correct the file")
    if above is not None and found <= above:
        raise UsageError(f"{where} = {value!r}: must be above {above:g}; correct the file")
    return found


def numbers(value: Any, count: int, where: str) -> list[float]:
    """`count` finite numbers.

    Raises:
        UsageError: not a list of as many, or one of them is none.
    """
    if not isinstance(value, list) or len(value) != count:
        raise UsageError(f"{where} = {value!r}: must be a list of {count} numbers; correct the file")
    return [number(item, f"{where}[{index}]") for index, item in enumerate(value)]


def box_table(x_m: float, y_m: float, length_m: float, width_m: float, base_m: float, height_m: float,
              yaw_deg: float, where: str) -> dict[str, Any] | None:
    """[[obstacle]] of a box; what is below the ground is cut off, None where that is all of it."""
    top_m, base_m = base_m + height_m, max(base_m, 0.0)
    if top_m <= base_m:
        return None
    if min(length_m, width_m, top_m - base_m) <= 0.0:
        raise UsageError(f"{where}: a size is not positive; correct the file")
    return {"kind": "box", "x_m": x_m, "y_m": y_m, "length_m": length_m, "width_m": width_m,
            "height_m": top_m - base_m, "base_height_m": base_m, "yaw_deg": math.remainder(yaw_deg, 360.0)}


def outline(table: dict[str, Any]) -> list[tuple[float, float]]:
    """Corners of a box in the plane."""
    c, s = math.cos(math.radians(table["yaw_deg"])), math.sin(math.radians(table["yaw_deg"]))
    half = [(a * table["length_m"] / 2, b * table["width_m"] / 2) for a in (-1, 1) for b in (-1, 1)]
    return [(table["x_m"] + c * u - s * v, table["y_m"] + s * u + c * v) for u, v in half]


def distance_m(table: dict[str, Any], x_m: float, y_m: float) -> float:
    """From a point to a box in the plane, 0 inside."""
    c, s = math.cos(math.radians(table["yaw_deg"])), math.sin(math.radians(table["yaw_deg"]))
    dx, dy = x_m - table["x_m"], y_m - table["y_m"]
    u, v = abs(c * dx + s * dy) - table["length_m"] / 2, abs(-s * dx + c * dy) - table["width_m"] / 2
    return math.hypot(max(u, 0.0), max(v, 0.0))


def course_table(start: tuple[float, float], goal_x_m: float, height_m: float) -> dict[str, Any]:
    """[course]: straight along +x; nothing says that it must be dodged."""
    length_m = goal_x_m - start[0]
    speed_m_s = 1.0 if length_m <= LONG_M else 2.0
    usual = min(max(2.5 * length_m / speed_m_s, LEAST_TIMEOUT_S), USUAL_TIMEOUT_S)
    return {"start_x_m": start[0], "start_y_m": start[1], "goal_x_m": goal_x_m, "height_m": height_m,
            "speed_m_s": speed_m_s, "timeout_s": max(usual, 1.3 * length_m / speed_m_s), "must_dodge": False}


def scene_head(path: Path, kind: str, text: str) -> dict[str, Any]:
    """[scene]; the description says what was assumed."""
    return {"name": path.stem or "course", "description": f"{kind}: {text}"}
