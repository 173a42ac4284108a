"""Aerialist and SBFT UAV testing competition: a test in YAML, boxes in the field of a PX4 mission.

Frame, read from Aerialist's sources (aerialist/px4): `trajectory.py` compares obstacles with PX4's
vehicle_local_position, so x is north, y east, metres from home; `simulator.py` spawns a box in Gazebo (east, north, up)
at (y, x, z), turned by radians(-r), with size (w, l, h), so r is in degrees from x towards y, l lies along the box's
x and w along its y; `obstacle.py` has CENTER_POSITION = True: (x, y) is the centre, and z the height of the underside
(it counts a flight above h as above the box). This is the project's own convention but for the course's direction.
"""

import json
import math
from pathlib import Path
from typing import Any

from saranga.errors import UsageError
from sitl.importers.checks import box_table, course_table, distance_m, number, numbers, outline, scene_head

FORMAT = "Aerialist test (simulation: obstacles:)"
SECTIONS = ("drone", "robot", "simulation", "test", "mission", "assertion", "agent")
EARTH_M_PER_DEG = math.radians(1.0) * 6_371_000.0
HEIGHT_M = 1.0
MARGIN_M = 8.0
LEAST_COURSE_M = 2.0
AHEAD_M = 3.0
"""Free run before and behind the obstacles where no mission says it."""
NAVIGATION = (16, 17, 18, 19, 21, 82)
"""MAV_CMD_NAV_WAYPOINT, LOITER_*, LAND and SPLINE_WAYPOINT."""
TAKEOFF = 22

Table = dict[str, Any]


def accepts(data: Table) -> bool:
    """Whether it has the sections of a test."""
    return "simulation" in data or ("obstacles" in data and "bounds" not in data) or "drone" in data


def scene_tables(data: Table, path: Path) -> Table:
    """Tables of a scene whose course runs along +x.

    Raises:
        UsageError: one line with file, key and value.
    """
    version = data.get("version")
    if version is not None and str(version) not in ("1", "1.0"):
        raise UsageError(f"{path}: version = {version!r}: only 1 is known; correct the file")
    boxes = _boxes(data, path)
    start, goal, said = _ends(data, boxes, path)
    angle = math.atan2(goal[1] - start[1], goal[0] - start[0])
    turned = [_turned(box, start, angle) for box in boxes]
    goal_x = math.hypot(goal[0] - start[0], goal[1] - start[1])
    corners = [corner for box in turned for corner in outline(box)]
    xs = [0.0, goal_x, *(x for x, _ in corners)]
    ys = [0.0, *(y for _, y in corners)]
    top = max([5.0, *(b["base_height_m"] + b["height_m"] + 1.0 for b in turned)])
    return {
        "scene": scene_head(path, "Aerialist test", f"{len(boxes)} boxes; {said}; course turned from "
                            f"{math.degrees(angle) % 360.0:.0f} deg (clockwise from north) to +x, flown at "
                            f"{HEIGHT_M:g} m"),
        "arena": {"x_m": [min(xs) - MARGIN_M, max(xs) + MARGIN_M], "y_m": [min(ys) - MARGIN_M, max(ys) + MARGIN_M],
                  "height_m": top, "netted": False},
        "course": course_table((0.0, 0.0), goal_x, HEIGHT_M),
        "obstacle": turned}


def _turned(box: Table, start: tuple[float, float], angle: float) -> Table:
    c, s = math.cos(angle), math.sin(angle)
    dx, dy = box["x_m"] - start[0], box["y_m"] - start[1]
    return {**box, "x_m": c * dx + s * dy, "y_m": -s * dx + c * dy,
            "yaw_deg": math.remainder(box["yaw_deg"] - math.degrees(angle), 360.0)}


def _section(data: Table, key: str, path: Path) -> Table:
    value = data.get(key)
    if value is not None and not isinstance(value, dict):
        raise UsageError(f"{path}: {key} = {value!r}: must be a section of keys; correct the file")
    return value or {}


def _boxes(data: Table, path: Path) -> list[Table]:
    where = "simulation.obstacles" if "simulation" in data else "obstacles"
    holder = _section(data, "simulation", path) if "simulation" in data else data
    given = holder.get("obstacles")
    if isinstance(given, dict):
        given = [given]
    if given is None:
        given = []
    if not isinstance(given, list):
        raise UsageError(f"{path}: {where} = {given!r}: must be a list; correct the file")
    if given and not any(isinstance(item, dict | list) for item in given):
        if len(given) % 7:
            raise UsageError(f"{path}: {where} has {len(given)} numbers: must be seven a box, [l, w, h, x, y, z, r]; "
                             "correct the file")
        given = [given[k:k + 7] for k in range(0, len(given), 7)]
    boxes = (_box(item, f"{path}: {where}[{index}]") for index, item in enumerate(given))
    return [box for box in boxes if box is not None]


def _box(item: Any, where: str) -> Table | None:
    if isinstance(item, list):
        size = dict(zip("lwh", item[:3], strict=False))
        place = dict(zip("xyzr", numbers(item, 7, where)[3:], strict=True))
        angle = place["r"]
    elif isinstance(item, dict):
        shape = item.get("shape", "box")
        if str(shape).lower() != "box":
            raise UsageError(f"{where}.shape = {shape!r}: only boxes are known; correct the file")
        size, place = _part(item, "size", "lwh", where), _part(item, "position", "xy", where)
        angle = place.get("r", place.get("angle", 0.0))
    else:
        raise UsageError(f"{where} = {item!r}: must be a box, with size and position, or [l, w, h, x, y, z, r]; "
                         "correct the file")
    length, width, height = (number(size[k], f"{where}.size.{k}", above=0.0) for k in "lwh")
    x, y = (number(place[k], f"{where}.position.{k}") for k in "xy")
    return box_table(x, y, length, width, number(place.get("z", 0.0), f"{where}.position.z"), height,
                     number(angle, f"{where}.position.r"), where)


def _part(item: Table, key: str, needed: str, where: str) -> Table:
    part = item.get(key)
    if not isinstance(part, dict):
        raise UsageError(f"{where}.{key} = {part!r}: must give {', '.join(needed)}; correct the file")
    for name in needed:
        if name not in part:
            raise UsageError(f"{where}.{key}.{name} is missing; correct the file")
    return part


# ---- start and goal ----------------------------------------------------------------------------------------
def _ends(data: Table, boxes: list[Table], path: Path) -> tuple[tuple[float, float], tuple[float, float], str]:
    """Start and goal (north, east), and in words where they come from."""
    named = None
    for key in ("drone", "robot", "test", "mission"):
        section = data.get(key)
        if isinstance(section, dict) and isinstance(section.get("mission_file"), str):
            named = section["mission_file"]
            break
    plan = _find(named, path)
    if plan is not None:
        start, goal = _mission(plan)
        return start, goal, f"start and farthest waypoint of {plan.name}"
    start, goal = _around(boxes)
    return start, goal, (f"mission {named!r} is not there" if named else "no mission") + ": a line past all boxes"


def _find(named: str | None, path: Path) -> Path | None:
    """The mission file, as named, beside the test, or below one of the folders above it (samples/...)."""
    if named is None or "://" in named:
        return None
    folders = [path.parent, *path.resolve().parents][:4]
    candidates = [folder / named for folder in folders] + [path.parent / Path(named).name]
    return next((c for c in candidates if c.suffix == ".plan" and c.is_file()), None)


def _mission(plan: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    """From the take-off to the navigation item farthest from it, metres from home (PX4's local origin)."""
    try:
        mission = json.loads(plan.read_text(encoding="utf-8-sig"))["mission"]
        items = [i for i in mission["items"] if i.get("command") in (*NAVIGATION, TAKEOFF)]
        places = [(i["command"], float(i["params"][4]), float(i["params"][5])) for i in items
                  if i["params"][4] is not None and i["params"][5] is not None]
        home = mission.get("plannedHomePosition") or places[0][1:]
        home = (float(home[0]), float(home[1]))
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise UsageError(f"{plan}: not a mission of QGroundControl ({type(error).__name__}: {error}); correct or "
                         "remove it") from error
    points = [(c, _local(lat, lon, home)) for c, lat, lon in places if lat or lon]
    start = next((p for c, p in points if c == TAKEOFF), (0.0, 0.0))
    goals = [p for c, p in points if c != TAKEOFF]
    goal = max(goals, key=lambda p: math.dist(p, start), default=start)
    if not LEAST_COURSE_M <= math.dist(goal, start) <= 1000.0:
        raise UsageError(f"{plan}: its farthest waypoint is {math.dist(goal, start):.1f} m from the start: must be "
                         f"{LEAST_COURSE_M:g} .. 1000 m; correct or remove it")
    return start, goal


def _local(lat: float, lon: float, home: tuple[float, float]) -> tuple[float, float]:
    north = (lat - home[0]) * EARTH_M_PER_DEG
    return north, (lon - home[1]) * EARTH_M_PER_DEG * math.cos(math.radians(home[0]))


def _around(boxes: list[Table]) -> tuple[tuple[float, float], tuple[float, float]]:
    """From home along the axis on which the boxes lie, until past the last."""
    if not boxes:
        return (0.0, 0.0), (10.0, 0.0)
    mean = [sum(b[k] for b in boxes) / len(boxes) for k in ("x_m", "y_m")]
    axis = 0 if abs(mean[0]) > abs(mean[1]) else 1
    sign = 1.0 if mean[axis] >= 0.0 else -1.0
    along = [sign * corner[axis] for box in boxes for corner in outline(box)]
    free = min(distance_m(box, 0.0, 0.0) for box in boxes) >= 1.0
    start = 0.0 if free else min(0.0, min(along)) - AHEAD_M
    goal = max(max(along) + AHEAD_M, start + LEAST_COURSE_M)
    ends = [(sign * v, 0.0) if axis == 0 else (0.0, sign * v) for v in (start, goal)]
    return ends[0], ends[1]
