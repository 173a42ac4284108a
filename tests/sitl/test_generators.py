"""Drawn courses: the rules hold for 200 seeds, by other means than those that drew them."""

from functools import cache

import numpy as np
import pytest

from sitl.generators import generator_kinds
from sitl.generators.base import stagger
from sitl.judge import Judge
from sitl.scene import Scene, build_scene, load_scene
from sitl.solids import surface_points

GENERATED = ["poles", "poles-windy", "boxes", "tunnels"]
SEEDS = 200

# The simplest reactive flyer: proof that a course can be flown by looking only at what is near.
SPEED_M_S, LATERAL_M_S = 1.0, 0.4
BRAKING_M3_S = 0.1
REACH_M, HALF_LANE_M = 1.2, 0.45
LAG_S, STEP_S = 0.25, 0.02
RADIUS_M = 0.12


@cache
def scenes(name: str) -> list[Scene]:
    spec = load_scene(name)
    return [build_scene(spec, seed) for seed in range(SEEDS)]


def footprint(shape) -> np.ndarray:
    """Corners (K, 2) of the outline seen from above, in order."""
    if shape.kind == "box":
        turn = np.radians(shape.yaw_deg)
        local = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (shape.length_m / 2, shape.width_m / 2)
        return local @ np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))]) + (shape.x_m, shape.y_m)
    turn = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    return np.stack([np.cos(turn), np.sin(turn)], axis=1) * shape.diameter_m / 2 + (shape.x_m, shape.y_m)


def gap_m(one, other) -> float:
    """Least distance: of two circles, or of two separate polygons (a corner of one to a side of the other)."""
    if one.kind == other.kind == "cylinder":
        return float(np.hypot(one.x_m - other.x_m, one.y_m - other.y_m) - (one.diameter_m + other.diameter_m) / 2)

    def corners_to_sides(points, polygon):
        a, b = polygon[None], np.roll(polygon, -1, axis=0)[None]
        p = points[:, None]
        share = np.clip(((p - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)
        return np.linalg.norm(p - a - share[..., None] * (b - a), axis=-1).min()

    a, b = footprint(one), footprint(other)
    return min(corners_to_sides(a, b), corners_to_sides(b, a))


def straight(scene: Scene, offset_m: float = 0.0):
    """The judgement on a level, straight flight beside the start's line."""
    judge = Judge(scene)
    pos = np.array([scene.course.start_m[0], scene.course.start_m[1] + offset_m, -scene.course.height_m])
    level = np.array([1.0, 0.0, 0.0, 0.0])
    judge.update(0, pos, level)
    judge.start_course(0)
    t_us = 0
    while not judge.finished:
        t_us += 50_000
        pos[0] += 0.05 * scene.course.speed_m_s
        judge.update(t_us, pos, level)
    return judge.result()


def fly_locally(scene: Scene) -> str:
    """Brakes for and moves away from the nearest point ahead within the half lane; clean, hit, net or timeout."""
    height_m = scene.course.height_m
    skin = np.concatenate([surface_points(row, 0.03) for row in scene.solids])
    skin = skin[np.abs(skin[:, 2] + height_m) < 0.06][:, :2]
    x, y, _ = scene.course.start_m
    speed = side = 0.0
    for _ in range(round(scene.course.timeout_s / STEP_S)):
        to = skin - (x, y)
        seen = to[(to[:, 0] > -0.05) & (np.abs(to[:, 1]) < HALF_LANE_M) & (np.hypot(*to.T) < REACH_M)]
        ahead = SPEED_M_S
        if len(seen):
            nearest = seen[np.argmin(np.hypot(*seen.T))]
            if side == 0.0 or abs(nearest[1]) > 0.06:
                side = -1.0 if nearest[1] > 0 else 1.0
            ahead = max(0.1, SPEED_M_S - BRAKING_M3_S * nearest[0] / np.hypot(*nearest) ** 3)
        else:
            side = 0.0
        speed += (side * LATERAL_M_S - speed) * STEP_S / LAG_S
        x, y = x + ahead * STEP_S, y + speed * STEP_S
        if scene.signed_distance_m(np.array([[x, y, -height_m]]))[0] < RADIUS_M:
            return "hit"
        if abs(y) > scene.arena.y_m[1] - RADIUS_M:
            return "net"
        if x >= scene.course.goal_x_m:
            return "clean"
    return "timeout"


@pytest.mark.parametrize("name", GENERATED)
def test_no_course_can_be_flown_straight(name):
    assert {straight(scene).outcome for scene in scenes(name)} == {"obstacle_hit"}


@pytest.mark.parametrize("name", GENERATED)
def test_one_dodge_of_half_a_metre_is_not_enough(name):
    for scene in scenes(name)[:60]:
        for offset_m in (-0.5, -0.35, -0.2, 0.2, 0.35, 0.5):
            assert straight(scene, offset_m).outcome == "obstacle_hit", (scene.seed, offset_m)


@pytest.mark.parametrize("name", GENERATED)
def test_obstacles_leave_each_other_room(name):
    for scene in scenes(name):
        gaps = [gap_m(a, b) for k, a in enumerate(scene.obstacles) for b in scene.obstacles[:k]]
        assert min(gaps) >= 0.9 - 0.002, scene.seed


@pytest.mark.parametrize("name", GENERATED)
def test_start_and_arena_are_respected(name):
    for scene in scenes(name):
        x, y, z = scene.course.start_m
        assert 0.7 <= x <= 0.9
        assert abs(y) <= 0.6
        assert z == 0.0
        for shape in scene.obstacles:
            outline = footprint(shape)
            assert np.abs(outline[:, 1]).max() < 2.25
            assert outline[:, 0].max() < scene.course.goal_x_m
            assert np.linalg.norm(outline - (x, y), axis=1).min() > 0.8


@pytest.mark.parametrize("name", GENERATED)
def test_one_side_of_every_obstacle_is_wide_open_to_the_net(name):
    for scene in scenes(name):
        for shape in scene.obstacles:
            outline = footprint(shape)
            assert max(2.25 - outline[:, 1].max(), outline[:, 1].min() + 2.25) >= 0.9


@pytest.mark.parametrize("name", ["poles", "poles-windy"])
def test_poles_in_the_way_follow_each_other_with_room_to_react(name):
    for scene in scenes(name):
        near = sorted(p.x_m for p in scene.obstacles if abs(p.y_m - scene.course.start_m[1]) < 0.6)
        assert len(near) == 5
        assert np.diff(near).min() >= 1.2
        assert near[0] - scene.course.start_m[0] >= 1.3


def test_boxes_have_the_papers_sizes_and_every_yaw():
    boxes = [shape for scene in scenes("boxes") for shape in scene.obstacles]
    assert {len(scene.obstacles) for scene in scenes("boxes")} == {4, 5}
    for key, low, high in (("length_m", 0.46, 0.67), ("height_m", 1.15, 1.38), ("width_m", 0.19, 0.25)):
        sizes = np.array([getattr(box, key) for box in boxes])
        assert low <= sizes.min() < low + 0.02
        assert high - 0.02 < sizes.max() <= high
    quarters, _ = np.histogram([box.yaw_deg for box in boxes], bins=[-90, -45, 0, 45, 90])
    assert quarters.min() > 0.15 * len(boxes)


@pytest.mark.parametrize("name", [*GENERATED, "wall"])
def test_looking_only_at_what_is_near_gets_through(name):
    spec = load_scene(name)
    outcomes = [fly_locally(build_scene(spec, seed)) for seed in range(50)]
    assert outcomes.count("clean") >= 48, outcomes


def test_drawing_is_quick():
    # The rate matters for campaigns; 10 drawings of the commonest scene are a fraction of one flight.
    assert np.mean([scene.tries for scene in scenes("poles")]) < 3


def test_staggering_keeps_spacing_and_order():
    rng = np.random.default_rng(3)
    for _ in range(50):
        places = np.array(stagger(rng, (2.0, 8.0), 1.4, (0.0, 0.3, -0.3, 0.6), 0.05))
        assert np.diff(places[:, 0]).min() >= 1.4 - 1e-12
        assert places[0, 0] >= 2.0
        assert places[-1, 0] <= 8.0
        assert abs(places[0, 1]) <= 0.05
        assert np.abs(np.sort(places[:, 1]) - (-0.3, 0.0, 0.3, 0.6)).max() <= 0.05


def test_generators_are_found_by_their_files():
    assert generator_kinds() == ("boxes", "forest", "mixed", "poles")
