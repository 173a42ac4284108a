"""A scene file and a seed made into a place to fly: obstacles, start, and the arrays that physics and acoustics read.

World NED: x along the course, y right, z down, ground at z = 0.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from sitl.feasibility import MUST_FIT_RADIUS_M, dodges_needed, straight_flight_hits, way_through
from sitl.materials import load_material
from sitl.primitives import Primitives, facet_row
from sitl.scene_spec import Arena, SceneSpec, Weather, Wind, load_scene
from sitl.shapes import Shape
from sitl.solids import gaps_m, signed_distance_m, stack_solids
from sitl.traversability import Traversability, traversability

__all__ = ["Arena", "Course", "Scene", "SceneSpec", "Weather", "Wind", "build_scene", "load_scene"]

TRIES = 500
START_CLEARANCE_M = 0.8
GROUND_BEYOND_ARENA_M = 5.0
FLYABLE_HEIGHTS_M = (0.4, 2.4)
"""Of the way through a 3-D course: over the ground effect, under the ceiling with room to spare."""


@dataclass(frozen=True)
class Course:
    """From `start_m` (3,) world NED on the ground, at `height_m`, until x reaches `goal_x_m`."""

    start_m: tuple[float, float, float]
    goal_x_m: float
    height_m: float
    speed_m_s: float
    timeout_s: float


@dataclass(frozen=True)
class Scene:
    """One scene as flown. Obstacles are counted from 1 in texts.

    Attributes:
        tries: how many drawings it took to satisfy the rules of the scene.
    """

    name: str
    seed: int
    description: str
    obstacles: tuple[Shape, ...]
    arena: Arena
    weather: Weather
    wind: Wind
    course: Course
    tries: int = 1

    @cached_property
    def primitives(self) -> Primitives:
        """What the acoustics see: every obstacle and the ground. Nets are acoustically transparent."""
        return Primitives.concatenate([*(shape.primitives() for shape in self.obstacles), _ground(self.arena)])

    @cached_property
    def solids(self) -> NDArray[np.float64]:
        """(S, 16) rows for the signed distance, see `sitl.solids`; `solid_owner` tells whose they are."""
        return stack_solids([shape.solids() for shape in self.obstacles])

    @cached_property
    def solid_owner(self) -> NDArray[np.int64]:
        """(S,) index into `obstacles` of each row of `solids`."""
        return np.array([k for k, shape in enumerate(self.obstacles) for _ in shape.solids()], dtype=np.int64)

    def signed_distance_m(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance (K,) of points (K, 3) to the nearest obstacle; inf without obstacles."""
        return signed_distance_m(self.solids, points)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; obstacles as tables that `sitl.shapes.shape_from_table` reads again."""
        return {
            "name": self.name, "seed": self.seed, "description": self.description, "tries": self.tries,
            "arena": self.arena.model_dump(mode="json"), "weather": self.weather.model_dump(mode="json"),
            "wind": self.wind.model_dump(mode="json"),
            "course": {"start_m": list(self.course.start_m), "goal_x_m": self.course.goal_x_m,
                       "height_m": self.course.height_m, "speed_m_s": self.course.speed_m_s,
                       "timeout_s": self.course.timeout_s},
            "obstacles": [shape.to_table() for shape in self.obstacles]}


def build_scene(spec: SceneSpec, seed: int) -> Scene:
    """Draw start and obstacles until the rules of the scene hold: the same seed gives the same scene.

    Rules: obstacles of a generator keep its gap to each other and to the explicit ones; nothing near the start; a
    way through exists for the airframe with margin; and, where the course must be dodged, a straight flight
    collides and as many dodges are needed as the generator promises.

    Raises:
        UsageError: a negative seed, or no drawing of the bounded number satisfies the rules (names the rule that
            failed most often).
    """
    if seed < 0:
        raise UsageError(f"seed = {seed} must be 0 or larger; choose another")
    rng = np.random.default_rng(np.random.SeedSequence([seed, crc32((spec.head.family or spec.name).encode())]))
    broken: dict[str, int] = {}
    for attempt in range(1, TRIES + 1):
        scene = _draw(spec, seed, rng, attempt)
        fault = broken_rule(spec, scene)
        if fault is None:
            return scene
        broken[fault] = broken.get(fault, 0) + 1
        if spec.generator is None and not _start_is_drawn(spec):
            raise UsageError(f"{spec.path}: this course cannot be flown: {fault}; correct the file")
    worst = max(broken, key=lambda rule: broken[rule])
    raise UsageError(f"{spec.path}: seed {seed}: no course in {TRIES} drawings; most often {worst} ({broken[worst]}x): "
                     "widen the arena or thin the obstacles out")


def _start_is_drawn(spec: SceneSpec) -> bool:
    return any(low != high for low, high in (spec.course.start_x_m, spec.course.start_y_m))


def _draw(spec: SceneSpec, seed: int, rng: np.random.Generator, attempt: int) -> Scene:
    course, arena = spec.course, spec.arena
    start = (float(rng.uniform(*course.start_x_m)), float(rng.uniform(*course.start_y_m)), 0.0)
    drawn = spec.generator.draw(rng, arena.x_m, arena.y_m, start) if spec.generator is not None else []
    return Scene(
        name=spec.name, seed=seed, description=spec.head.description, obstacles=(*spec.obstacles, *drawn),
        arena=arena, weather=spec.weather, wind=spec.wind, tries=attempt,
        course=Course(start, course.goal_x_m, course.height_m, course.speed_m_s, course.timeout_s))


def broken_rule(spec: SceneSpec, scene: Scene) -> str | None:
    """The first rule this drawing breaks, or None."""
    course, solids = scene.course, scene.solids
    x, y, _ = course.start_m
    column = np.array([(x, y, -h) for h in np.linspace(0.0, course.height_m, 12)])
    if scene.signed_distance_m(column).min() < START_CLEARANCE_M:
        return f"an obstacle stood within {START_CLEARANCE_M:g} m of the start"
    if spec.must_dodge and not straight_flight_hits(solids, course.start_m, course.goal_x_m, course.height_m):
        return "a straight flight passed"
    if spec.generator is not None:
        dodges = spec.generator.dodges
        if dodges_needed(solids, course.start_m, course.goal_x_m, course.height_m) < dodges:
            return f"fewer than {dodges} dodges were needed"
        least = spec.generator.min_gap_m
        if least > 0.0:
            # Explicit obstacles may touch each other: somebody put them there.
            gaps = gaps_m([shape.solids() for shape in scene.obstacles])[len(spec.obstacles):]
            if gaps.size and gaps.min() < least:
                return f"two obstacles stood nearer than {least:g} m"
    if spec.course.traversability is not None:
        least, most = spec.course.traversability
        if not least <= (found := scene_traversability(scene).mean) <= most:
            return f"traversability was {'under' if found < least else 'over'} {least:g} .. {most:g}"
    arena = scene.arena
    heights_m = FLYABLE_HEIGHTS_M if spec.course.three_d else None
    if not way_through(solids, arena.x_m, arena.y_m, arena.netted, course.start_m, course.goal_x_m, course.height_m,
                       heights_m=heights_m):
        return f"no way through was {2 * MUST_FIT_RADIUS_M:g} m wide"
    return None


def scene_traversability(scene: Scene) -> Traversability:
    """Traversability of a course at its flight height; of an open one, of the part that obstacles stand in."""
    boxes = [shape.solids()[:, 1] for shape in scene.obstacles]
    x_m = (min(float(x.min()) for x in boxes), max(float(x.max()) for x in boxes)) if boxes else None
    return traversability(scene.solids, scene.arena, scene.course.height_m, x_m)


def _ground(arena: Arena) -> Primitives:
    """The floor as one facet that reaches beyond the arena."""
    (x0, x1), (y0, y1), more = arena.x_m, arena.y_m, GROUND_BEYOND_ARENA_M
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    x_axis, y_axis = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    # u x v points up, to where the vehicle is.
    return Primitives.of(facets=[facet_row(centre, y_axis, x_axis, (y1 - y0) / 2 + more, (x1 - x0) / 2 + more,
                                           load_material("floor").reflectivity, closed=True)])
