"""RotorPy worlds: JSON with `bounds` and axis-aligned `blocks`, metres, z up.

Source: rotorpy/world.py and rotorpy/worlds/README.md: extents are [xmin, xmax, ymin, ymax, zmin, zmax]; leaving the
bounds is a collision. `start` and `goal` [x, y, z] are an addition of courses built on it; both may be left out. With
z up, the right hand of a course along +x is -y. The world is turned about the vertical so that the course runs along
+x; bounds that lie oblique then become the upright rectangle around them.
"""

import math
from pathlib import Path
from typing import Any

from saranga.errors import UsageError
from sitl.importers.checks import box_table, course_table, distance_m, numbers, scene_head

FORMAT = "RotorPy world (bounds:, blocks:)"
HEIGHT_M = 1.0
LOWEST_M, HIGHEST_M = 0.5, 4.0
"""The rangefinder's estimate of height is good in between."""
INSIDE_M = 1.0
CLEAR_M = 1.0
LEAST_COURSE_M = 2.0

Table = dict[str, Any]


def accepts(data: Table) -> bool:
    """Whether it has the keys of a world."""
    return "bounds" in data or "blocks" in data


def scene_tables(data: Table, path: Path) -> Table:
    """Tables of a scene whose course runs along +x.

    Raises:
        UsageError: one line with file, key and value.
    """
    version = data.get("version")
    if version is not None and str(version) not in ("1", "1.0"):
        raise UsageError(f"{path}: version = {version!r}: only 1 is known; correct the file")
    if "bounds" not in data:
        raise UsageError(f"{path}: bounds is missing: give bounds.extents, [xmin, xmax, ymin, ymax, zmin, zmax]")
    x0, x1, y0, y1, z0, z1 = _extents(data["bounds"], f"{path}: bounds")
    blocks = _blocks(data, path)
    start, goal, height, said = _ends(data, (x0, x1, y0, y1, z0, z1), blocks, path)
    angle = math.atan2(goal[1] - start[1], goal[0] - start[0])
    c, s = math.cos(angle), math.sin(angle)

    def turned(x: float, y: float) -> tuple[float, float]:
        return c * (x - start[0]) + s * (y - start[1]), s * (x - start[0]) - c * (y - start[1])

    boxes = []
    for index, (bx0, bx1, by0, by1, bz0, bz1) in enumerate(blocks):
        x, y = turned((bx0 + bx1) / 2, (by0 + by1) / 2)
        box = box_table(x, y, bx1 - bx0, by1 - by0, bz0 - z0, bz1 - bz0, math.degrees(angle),
                        f"{path}: blocks[{index}]")
        boxes += [box] if box is not None else []
    corners = [turned(x, y) for x in (x0, x1) for y in (y0, y1)]
    xs, ys = [x for x, _ in corners], [y for _, y in corners]
    goal_x = math.hypot(goal[0] - start[0], goal[1] - start[1])
    oblique = min(abs(c), abs(s)) > 1e-9
    return {
        "scene": scene_head(path, "RotorPy world", f"{len(boxes)} blocks; {said}; turned by "
                            f"{math.degrees(angle):.0f} deg so that the course runs along +x, flown at {height:g} m"
                            + ("; bounds widened to the rectangle around them" if oblique else "")),
        "arena": {"x_m": [min(xs), max(xs)], "y_m": [min(ys), max(ys)], "height_m": z1 - z0, "netted": True},
        "course": course_table((0.0, 0.0), goal_x, height),
        "obstacle": boxes}


def _extents(holder: Any, where: str) -> list[float]:
    if not isinstance(holder, dict) or "extents" not in holder:
        raise UsageError(f"{where}.extents is missing: [xmin, xmax, ymin, ymax, zmin, zmax]; correct the file")
    found = numbers(holder["extents"], 6, f"{where}.extents")
    for axis, name in enumerate("xyz"):
        if found[2 * axis] >= found[2 * axis + 1]:
            raise UsageError(f"{where}.extents: {name}min = {found[2 * axis]:g} is not below {name}max = "
                             f"{found[2 * axis + 1]:g}; correct the file")
    return found


def _blocks(data: Table, path: Path) -> list[list[float]]:
    blocks = data.get("blocks")
    if blocks is None:
        return []
    if not isinstance(blocks, list):
        raise UsageError(f"{path}: blocks = {blocks!r}: must be a list; correct the file")
    return [_extents(block, f"{path}: blocks[{index}]") for index, block in enumerate(blocks)]


def _ends(data: Table, bounds: tuple[float, ...], blocks: list[list[float]], path: Path
          ) -> tuple[tuple[float, float], tuple[float, float], float, str]:
    """Start and goal in the world's plane, flight height above its floor, and where they come from."""
    x0, x1, y0, y1, z0, z1 = bounds
    room = z1 - z0
    given = {key: _point(data, key, bounds, path) for key in ("start", "goal")}
    asked = given["start"] or given["goal"]
    height = min(max(asked[2] - z0, LOWEST_M), HIGHEST_M) if asked else HEIGHT_M
    height = min(height, 0.75 * room)
    long_x = x1 - x0 >= y1 - y0
    low, high = (x0, x1) if long_x else (y0, y1)
    inside = min(INSIDE_M, 0.1 * (high - low))
    middle = (y0 + y1) / 2 if long_x else (x0 + x1) / 2
    boxes = [{"x_m": (b[0] + b[1]) / 2, "y_m": (b[2] + b[3]) / 2, "length_m": b[1] - b[0], "width_m": b[3] - b[2],
              "yaw_deg": 0.0} for b in blocks if b[5] > z0]
    start, goal = given["start"], given["goal"]
    if start is not None:
        first = start[:2]
    else:
        across = (y1 - y0 if long_x else x1 - x0) / 2 - inside
        tries = [middle + sign * k * 0.25 for k in range(max(int(across / 0.25), 0) + 1) for sign in (1, -1)]
        places = [(low + inside, t) if long_x else (t, low + inside) for t in tries]
        first = next((p for p in places if all(distance_m(b, *p) >= CLEAR_M for b in boxes)), places[0])
    if goal is not None:
        last = goal[:2]
    else:
        far = high - inside if first[0 if long_x else 1] <= (low + high) / 2 else low + inside
        last = (far, first[1]) if long_x else (first[0], far)
    if math.dist(first, last) < LEAST_COURSE_M:
        raise UsageError(f"{path}: start and goal are {math.dist(first, last):.2f} m apart in the plane: must be at "
                         f"least {LEAST_COURSE_M:g} m; correct the file")
    missing = [key for key in given if given[key] is None]
    said = f"no {' and '.join(missing)} given: along the longest side" if missing else "start and goal as given"
    return (first[0], first[1]), (last[0], last[1]), height, said


def _point(data: Table, key: str, bounds: tuple[float, ...], path: Path) -> tuple[float, float, float] | None:
    if data.get(key) is None:
        return None
    found = numbers(data[key], 3, f"{path}: {key}")
    for axis, name in enumerate("xyz"):
        low, high = bounds[2 * axis], bounds[2 * axis + 1]
        inside = low <= found[axis] <= high if name == "z" else low < found[axis] < high
        if not inside:
            raise UsageError(f"{path}: {key}[{axis}] = {found[axis]:g} must lie inside bounds, {low:g} .. {high:g}; "
                             "correct the file")
    return found[0], found[1], found[2]
