"""What there is to draw of a flight, in plain arrays: shared by the Rerun recording, the plots and the page.

World and body axes of the project point down (NED, FRD). Viewers want z up, so everything drawn in 3-D goes
through `z_up`: x stays along the course, y turns left, z turns up (a half turn about x, so right-handed).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.errors import BenchError
from sitl.trial_types import FlightLog, TrialResult

Floats = NDArray[np.float64]

# one hue a meaning, the same in the 3-D view, the plots and the page
KIND_COLOURS = {"cylinder": "#e8a33d", "box": "#b08cf0", "wall": "#8fa3ba"}
OTHER_KIND_COLOUR = "#e58fb0"
OUTCOME_COLOURS = {"clean": "#2fae6b", "net_hit": "#d9a021"}
BAD_OUTCOME_COLOUR = "#e0503a"
PATH_COLOUR = "#36a3ff"
DETECTION_COLOUR = "#ff4fa3"
GOAL_COLOUR = "#2fae6b"

# where the stack's positions count from (midpoint of left and right sensor, fixtures/sonars), body FRD
SONAR_ORIGIN_M = (0.08, 0.0, 0.0)

OUTCOME_WORDS = {
    "clean": "clean flight",
    "net_hit": "touched the net",
    "obstacle_hit": "hit an obstacle",
    "timeout": "ran out of time",
    "stuck": "stuck",
    "estimator_failure": "lost its position estimate",
    "infrastructure": "broken off: infrastructure",
    "interrupted": "interrupted",
}


def kind_colour(kind: str) -> str:
    """Hex colour of an obstacle kind."""
    return KIND_COLOURS.get(kind, OTHER_KIND_COLOUR)


def outcome_colour(outcome: str) -> str:
    """Hex colour of an outcome: green clean, amber net, red anything else."""
    return OUTCOME_COLOURS.get(outcome, BAD_OUTCOME_COLOUR)


def rgb(colour: str) -> tuple[int, int, int]:
    """"#rrggbb" as three integers 0..255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


@dataclass(frozen=True)
class DrawnObstacle:
    """One obstacle as a mesh: `vertices_m` (V, 3) world NED, `triangles` (T, 3) vertex indices."""

    name: str
    kind: str
    vertices_m: Floats
    triangles: NDArray[np.int64]
    shape: Any

    def footprint_m(self, axis_a: int, axis_b: int) -> Floats:
        """Convex outline (H, 2) of the mesh seen along the third axis, counter-clockwise."""
        return _convex_hull(self.vertices_m[:, [axis_a, axis_b]])


@dataclass(frozen=True)
class DrawnScene:
    """A scene as `FlightLog.scene` holds it, ready to draw. Lengths in metres, world NED."""

    name: str
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    height_m: float
    netted: bool
    start_m: tuple[float, float, float]
    goal_x_m: float
    obstacles: tuple[DrawnObstacle, ...]

    def distance_m(self, points_m: Floats) -> Floats:
        """Distance (K,) from each point (K, 3) to the nearest obstacle's surface; NaN without obstacles."""
        if not self.obstacles:
            return np.full(len(points_m), np.nan)
        return np.asarray(np.min([o.shape.signed_distance_m(points_m) for o in self.obstacles], axis=0),
                          dtype=np.float64)


@dataclass(frozen=True)
class Flight:
    """A log and its result with what is derived from them once."""

    log: FlightLog
    result: TrialResult

    @cached_property
    def scene(self) -> DrawnScene:
        """The scene it flew through."""
        return drawn_scene(self.log.scene)

    @cached_property
    def time_s(self) -> Floats:
        """Simulated seconds (K,)."""
        return np.asarray(self.log.t_us * 1e-6, dtype=np.float64)

    @cached_property
    def rotation(self) -> Floats:
        """Body to world rotation matrices (K, 3, 3)."""
        return rotation_matrices(self.log.quat)

    @cached_property
    def centre_distance_m(self) -> Floats:
        """From the airframe's centre to the nearest obstacle surface, (K,)."""
        return self.scene.distance_m(self.log.pos_m)

    @cached_property
    def end_tick(self) -> int:
        """The tick at which the course ended (the judged moment), or the last one."""
        course = [k for k, phase in enumerate(self.log.phase) if phase == "course"]
        return course[-1] if course else len(self.log.t_us) - 1

    @cached_property
    def detections_m(self) -> list[Floats]:
        """World positions (n, 3) of what the stack located, a tick each."""
        origin = np.asarray(self.log.airframe.get("sonar_origin_m", SONAR_ORIGIN_M), dtype=np.float64)
        out = []
        for tick, seen in enumerate(self.log.obstacles):
            body = np.array([(o.x_m, o.y_m, o.z_m) for o in seen], dtype=np.float64).reshape(-1, 3)
            out.append(self.log.pos_m[tick] + (body + origin) @ self.rotation[tick].T)
        return out

    def telling_time_s(self) -> float:
        """The moment that shows most: the nearest approach to an obstacle the stack had located, in mid-course."""
        course = [k for k, phase in enumerate(self.log.phase) if phase == "course"]
        late = course[2 * len(course) // 5:3 * len(course) // 5] or list(range(len(self.time_s)))
        near = self.centre_distance_m
        worth = [k for k in late if self.log.obstacles[k] and np.isfinite(near[k])] or late[-1:]
        return float(self.time_s[min(worth, key=lambda k: near[k])])


def drawn_scene(scene: dict[str, Any]) -> DrawnScene:
    """Read the scene of a log (`Scene.to_dict`).

    Raises:
        BenchError: a log whose scene lacks what drawing needs.
    """
    from sitl.shapes import shape_from_table

    try:
        arena, course = scene["arena"], scene["course"]
        obstacles = []
        for index, table in enumerate(scene["obstacles"]):
            shape = shape_from_table(table)
            vertices, triangles = shape.mesh()
            obstacles.append(DrawnObstacle(f"{shape.kind}_{index + 1}", shape.kind,
                                           np.asarray(vertices, dtype=np.float64),
                                           np.asarray(triangles, dtype=np.int64), shape))
        return DrawnScene(
            name=str(scene["name"]), x_m=_pair(arena["x_m"]), y_m=_pair(arena["y_m"]),
            height_m=float(arena["height_m"]), netted=bool(arena.get("netted", False)),
            start_m=(float(course["start_m"][0]), float(course["start_m"][1]), float(course["start_m"][2])),
            goal_x_m=float(course["goal_x_m"]), obstacles=tuple(obstacles))
    except (KeyError, TypeError, IndexError) as error:
        raise BenchError(f"the flight log's scene cannot be drawn: {type(error).__name__} {error}; fly the scene "
                         "again with this version") from error


def _pair(values: Any) -> tuple[float, float]:
    low, high = values
    return float(low), float(high)


def z_up(points: Floats) -> Floats:
    """NED (or FRD) vectors (..., 3) with y left and z up."""
    return np.asarray(points, dtype=np.float64) * (1.0, -1.0, -1.0)


def quaternion_z_up(quat: Floats) -> Floats:
    """Body-to-world quaternions (K, 4) w,x,y,z between the flipped frames, as x,y,z,w (Rerun's order)."""
    w, x, y, z = np.asarray(quat, dtype=np.float64).T
    return np.stack([x, -y, -z, w], axis=1)


def rotation_matrices(quat: Floats) -> Floats:
    """Unit quaternions (K, 4) w,x,y,z as matrices (K, 3, 3) body to world."""
    w, x, y, z = np.asarray(quat, dtype=np.float64).T
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    return np.array(rows).transpose(2, 0, 1)


def heading_velocity_m_s(log: FlightLog) -> Floats:
    """Flown velocity (K, 3) forward, right, down of the heading: what the commands are compared with."""
    rotation = rotation_matrices(log.quat)
    yaw = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    vx, vy, vz = log.vel_m_s.T
    return np.stack([np.cos(yaw) * vx + np.sin(yaw) * vy, -np.sin(yaw) * vx + np.cos(yaw) * vy, vz], axis=1)


def edge_columns(row: NDArray[np.uint8], level: int = 128) -> NDArray[np.int64]:
    """Column of the strongest sample of each run at or over `level` in one edge row (N,)."""
    over = np.flatnonzero(row >= level)
    if over.size == 0:
        return np.zeros(0, dtype=np.int64)
    runs = np.split(over, np.flatnonzero(np.diff(over) > 1) + 1)
    return np.array([run[np.argmax(row[run])] for run in runs], dtype=np.int64)


def sent_commands(log: FlightLog) -> Floats:
    """Commands (K, 4) that went to the vehicle: NaN outside the course, where the stack decides but is not obeyed."""
    on_course = np.array([phase == "course" for phase in log.phase])
    return np.where(on_course[:, None], log.command, np.nan)


def echo_shades(rows: NDArray[np.uint8]) -> tuple[float, float]:
    """Values drawn black and brightest: usual noise and strong echoes. The near eighth, where the transmitter still
    rings, is drawn with the rest but does not set the scale."""
    heard = rows[:, rows.shape[1] // 8:]
    heard = heard[heard > 0]
    if heard.size == 0:
        return 0.0, 255.0
    low, high = np.percentile(heard, [65.0, 99.98])
    return float(low), float(max(high, low + 32.0))


def airframe_mesh(airframe: dict[str, Any]) -> tuple[Floats, NDArray[np.int64], NDArray[np.uint8]]:
    """Body, arms and four propeller discs: vertices (V, 3) body FRD, triangles (T, 3), colours (V, 3).

    The front propellers are red so that the heading shows.
    """
    arm_m = float(airframe.get("wheelbase_m", 0.16)) / 2
    prop_m = float(airframe.get("prop_diameter_m", 0.0762)) / 2
    parts = [_box((0.0, 0.0, 0.0), (0.10, 0.045, 0.04), 0.0, (225, 228, 235)),
             _box((0.06, 0.0, 0.0), (0.02, 0.11, 0.02), 0.0, (54, 163, 255))]
    for forward, right in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
        angle = np.arctan2(right, forward)
        tip = arm_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        parts.append(_box(tuple(tip / 2), (arm_m, 0.012, 0.008), float(angle), (150, 155, 165)))
        parts.append(_disc(tip - np.array([0.0, 0.0, 0.015]), prop_m,
                           (255, 96, 82) if forward > 0 else (235, 235, 240)))
    offset, vertices, triangles, colours = 0, [], [], []
    for points, faces, colour in parts:
        vertices.append(points)
        triangles.append(faces + offset)
        colours.append(np.tile(np.array(colour, dtype=np.uint8), (len(points), 1)))
        offset += len(points)
    return np.concatenate(vertices), np.concatenate(triangles), np.concatenate(colours)


_Part = tuple[Floats, NDArray[np.int64], tuple[int, int, int]]
_BOX_FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                       [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], dtype=np.int64)


def _box(centre: tuple[float, ...], size: tuple[float, float, float], yaw: float,
         colour: tuple[int, int, int]) -> _Part:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    return corners @ turn.T + np.array(centre), _BOX_FACES, colour


def _disc(centre: Floats, radius_m: float, colour: tuple[int, int, int], sides: int = 20) -> _Part:
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    rim = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.zeros(sides)], axis=1)
    around = np.arange(sides)
    faces = np.stack([np.full(sides, sides), around, (around + 1) % sides], axis=1)
    return np.concatenate([rim, np.zeros((1, 3))]) + centre, faces.astype(np.int64), colour


def _convex_hull(points: Floats) -> Floats:
    """Andrew's monotone chain."""
    ordered = sorted({(round(float(a), 9), round(float(b), 9)) for a, b in points})
    if len(ordered) < 3:
        return np.array(ordered, dtype=np.float64).reshape(-1, 2)

    def chain(sequence: list[tuple[float, float]]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for p in sequence:
            while len(out) >= 2 and ((out[-1][0] - out[-2][0]) * (p[1] - out[-2][1])
                                     - (out[-1][1] - out[-2][1]) * (p[0] - out[-2][0])) <= 0:
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]), dtype=np.float64)
