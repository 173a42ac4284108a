"""What happened in a flight: the airframe's swept volume against obstacles and nets, the goal and the clock."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.scene import Scene
from sitl.solids import signed_distance_m
from sitl.swept_volume import (
    NET,
    OBSTACLE,
    PATH,
    POS,
    PROPELLER,
    QUAT,
    SPEED,
    AirframeVolume,
    Spheres,
    new_memory,
    rotate,
    sweep,
)

STUCK_AFTER_US = 8_000_000
STUCK_PROGRESS_M = 0.3
DECLARED_OUTCOMES = ("estimator_failure", "infrastructure", "interrupted")
NET_SIDES = ("rear net", "front net", "left net", "right net", "ceiling net")


@dataclass(frozen=True)
class Judgement:
    """What happened. Lengths in metres.

    Attributes:
        outcome: clean, net_hit, obstacle_hit, timeout, stuck, estimator_failure, infrastructure or interrupted.
        cause: one line for people.
        t_us: simulated time of the end of the course, or of the hit.
        duration_s: from the start of the course to `t_us`; NaN when the course never started.
        min_clearance_m: least distance of the airframe to an obstacle (the ground is none) from take-off on; 0 when
            one was hit, NaN without obstacles.
        net_clearance_m: the same to the nets; NaN without nets.
        part: front, side, rear (of body and arms, by direction) or propeller; None when nothing was hit.
        obstacle_index: into `Scene.obstacles`, None when none was hit.
        path_length_m: flown during the course.
    """

    outcome: str
    cause: str
    t_us: int
    duration_s: float
    min_clearance_m: float
    net_clearance_m: float
    part: str | None
    obstacle_index: int | None
    path_length_m: float

    @property
    def success_strict(self) -> bool:
        """Clean flights only."""
        return self.outcome == "clean"

    @property
    def success_lenient(self) -> bool:
        """The paper's composite rule, which lets a touched net pass."""
        return self.outcome in ("clean", "net_hit")


class Judge:
    """Watches one flight. Obstacles and nets count from the first `update` on, goal and clock from `start_course`.

    An obstacle hit after the goal, while landing, still counts; a net touched then is said and does not: the course
    ends at the goal, and a room may have less behind it than stopping takes. All else is final. Between updates
    the pose is taken to move evenly. The ground is never a hit.
    """

    def __init__(self, scene: Scene, airframe: AirframeVolume | None = None) -> None:
        self._scene = scene
        self._spheres = Spheres(airframe or AirframeVolume())
        self._table = self._spheres.table
        self._reach_m = self._spheres.reach_m
        self._solids = scene.solids
        arena = scene.arena
        self._net = (np.array([*arena.x_m, *arena.y_m, -arena.height_m]) if arena.netted
                     else np.array([-np.inf, np.inf, -np.inf, np.inf, -np.inf]))
        self._memory = new_memory()
        self._t_us: int | None = None
        self._course_us: int | None = None
        self._mark = (0, 0.0)
        self._path_start_m = 0.0
        self._path_end_m: float | None = None
        self._end: tuple[str, str, int] | None = None
        self._part: str | None = None
        self._obstacle: int | None = None
        self.reached_goal = False
        self._net_after_goal = False

    @property
    def finished(self) -> bool:
        """Whether the course has ended, one way or the other."""
        return self._end is not None

    def start_course(self, t_us: int) -> None:
        """From now on the goal counts, the clock runs and progress is asked for."""
        self._course_us = t_us
        self._mark = (t_us, float(self._memory[POS]))
        self._path_start_m = float(self._memory[PATH])

    def fail(self, outcome: str, cause: str) -> None:
        """Declare what the judge cannot see. It replaces a clean course, never an earlier failure.

        Raises:
            ValueError: an outcome that only the judge itself gives.
        """
        if outcome not in DECLARED_OUTCOMES:
            raise ValueError(f"outcome {outcome!r} cannot be declared: one of {', '.join(DECLARED_OUTCOMES)}")
        if self._end is None:
            self._finish(outcome, cause, self._t_us or 0)
        elif self._end[0] == "clean":
            self._finish(outcome, f"course flown clean, but then: {cause}", self._end[2])

    def update(self, t_us: int, pos_m: NDArray[np.float64], quat: NDArray[np.float64]) -> None:
        """Take in a pose.

        Args:
            t_us: simulated, later than the update before.
            pos_m: (3,) world NED of the airframe's reference point.
            quat: (4,) w,x,y,z body to world; normalised here.
        """
        if self._end is not None and self._end[0] != "clean":
            return
        last_us = self._t_us
        if last_us is not None and t_us <= last_us:
            if t_us < last_us:
                self._finish("infrastructure", f"simulated time ran backwards from {last_us} to {t_us} us", last_us)
            return
        self._t_us = t_us
        dt_us = 0 if last_us is None else t_us - last_us
        code, sphere, what, share = sweep(self._table, self._reach_m, self._solids, self._net, self._memory,
                                          pos_m, quat, dt_us * 1e-6)
        if code == 0:
            if self._course_us is not None and self._end is None:
                self._watch_course(t_us, pos_m[0])
        elif code < 0:
            pose = f"position {_text(pos_m)}, quaternion {_text(quat)}"
            self._finish("infrastructure", f"the simulated pose is not a number at {t_us / 1e6:.3f} s ({pose})", t_us)
        else:
            self._hit(code, sphere, what, t_us - round((1.0 - share) * dt_us))

    def result(self) -> Judgement:
        """What happened so far; a flight that has not finished is never clean."""
        t_us = self._t_us or 0
        outcome, cause, end_us = self._end or (
            "infrastructure", f"not finished: broken off at {t_us / 1e6:.2f} s", t_us)
        started = self._course_us
        duration_s = float("nan") if started is None else max(end_us - started, 0) / 1e6
        path_end_m = self._memory[PATH] if self._path_end_m is None else self._path_end_m
        path_m = 0.0 if started is None else float(path_end_m) - self._path_start_m
        return Judgement(outcome, cause, end_us, duration_s, _least(self._memory[OBSTACLE]), _least(self._memory[NET]),
                         self._part, self._obstacle, path_m)

    # ---- ends --------------------------------------------------------------------------------------
    def _finish(self, outcome: str, cause: str, t_us: int) -> None:
        self._end = (outcome, cause, t_us)
        if self._path_end_m is None:
            self._path_end_m = float(self._memory[PATH])

    def _watch_course(self, t_us: int, x_m: float) -> None:
        assert self._course_us is not None
        course = self._scene.course
        course_s = (t_us - self._course_us) / 1e6
        if x_m >= self._mark[1] + STUCK_PROGRESS_M:
            self._mark = (t_us, x_m)
        if x_m >= course.goal_x_m:
            self.reached_goal = True
            self._finish("clean", f"reached the goal at x {course.goal_x_m:.2f} m after {course_s:.1f} s", t_us)
        elif course_s >= course.timeout_s:
            self._finish("timeout", f"not at the goal after {course.timeout_s:g} s: x {x_m:.2f} m of "
                         f"{course.goal_x_m:.2f} m", t_us)
        elif t_us - self._mark[0] >= STUCK_AFTER_US:
            self._finish("stuck", f"less than {STUCK_PROGRESS_M:g} m of progress in {STUCK_AFTER_US / 1e6:g} s at "
                         f"x {x_m:.2f} m, y {self._memory[POS + 1]:.2f} m", t_us)

    def _hit(self, code: int, sphere: int, what: int, t_us: int) -> None:
        """A touch at the pose in memory."""
        pos = self._memory[POS:POS + 3]
        when = f"at {self._memory[SPEED]:.2f} m/s" + (" after the goal" if self.reached_goal else "")
        if code == 2:
            name, part = self._struck_part(sphere, _NET_NORMALS[what])
            text = f"{name} hit the {NET_SIDES[what]} at x {pos[0]:.2f} m, y {pos[1]:.2f} m {when}"
            if not self.reached_goal:
                self._part = part
                self._finish("net_hit", text, t_us)
            elif not self._net_after_goal and self._end is not None:
                self._net_after_goal = True
                self._end = (self._end[0], f"{self._end[1]}; {text}", self._end[2])
            return
        self._obstacle = int(self._scene.solid_owner[what])
        name, self._part = self._struck_part(sphere, self._towards(what, sphere))
        shape = self._scene.obstacles[self._obstacle]
        self._finish("obstacle_hit", f"{name} hit obstacle {self._obstacle + 1} ({shape.describe()}) {when}", t_us)

    def _towards(self, solid: int, sphere: int) -> NDArray[np.float64]:
        """World direction (3,) from the sphere into the obstacle: down the gradient of the distance."""
        at = self._memory[POS:POS + 3] + np.array(rotate(self._memory[QUAT:QUAT + 4], *self._table[sphere, :3]))
        step = 1e-5
        points = np.concatenate([at + step * np.eye(3), at - step * np.eye(3)])
        d = signed_distance_m(self._solids[solid:solid + 1], points)
        return d[3:] - d[:3]

    def _struck_part(self, sphere: int, towards: NDArray[np.float64]) -> tuple[str, str]:
        """Name for the text and part for the record of what was struck."""
        if self._spheres.part[sphere] == PROPELLER:
            return self._spheres.label[sphere], "propeller"
        inverse = self._memory[QUAT:QUAT + 4] * (1.0, -1.0, -1.0, -1.0)
        x, y, _ = rotate(inverse, *towards)
        angle_deg = abs(math.degrees(math.atan2(y, x)))
        part = "front" if angle_deg <= 45.0 else "rear" if angle_deg >= 135.0 else "side"
        return f"{part} of the {self._spheres.label[sphere]}", part


_NET_NORMALS = np.array([[-1.0, 0, 0], [1.0, 0, 0], [0, -1.0, 0], [0, 1.0, 0], [0, 0, -1.0]])


def _least(distance_m: float) -> float:
    """A least distance for the record: 0 when touched, NaN when there was nothing to touch."""
    return max(float(distance_m), 0.0) if math.isfinite(distance_m) else float("nan")


def _text(values: NDArray[np.float64]) -> str:
    return ", ".join(f"{v:g}" for v in values)
