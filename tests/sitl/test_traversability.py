"""Traversability against geometry that can be worked out by hand, and the courses that stand for the paper's."""

import math
from pathlib import Path

import numpy as np
import pytest

from saranga.errors import UsageError
from saranga.fixtures import fixture_names
from sitl.scene import build_scene, load_scene, scene_traversability
from sitl.scene_spec import Arena
from sitl.solids import cylinder_solid
from sitl.traversability import SIZE_M, traversability

ROOM = Arena(x_m=(0.0, 10.0), y_m=(-2.0, 2.0), height_m=3.0, netted=True)
NOTHING = np.zeros((0, 16))
WITHIN_10_PERCENT = {"paper-transparent": 15.2, "paper-fog": 15.8, "paper-low-light": 16.8, "paper-forest-sparse": 34.4,
                     "paper-forest-medium": 23.7, "paper-forest-dense": 19.7}


def pole(x: float, y: float, radius: float) -> list[float]:
    return cylinder_solid(np.array([x, y, 0.0]), np.array([x, y, -2.0]), radius)


def test_straight_ahead_in_an_empty_room_is_half_its_length() -> None:
    found = traversability(NOTHING, ROOM, 1.0, headings_rad=np.array([0.0]))
    # starts over the whole floor, the disc stops a radius before the net; where it does not fit it counts 0
    free = found.free_m[:, 0]
    x, y = found.starts_m.T
    fits = (x >= 0.085) & (x <= 9.915) & (np.abs(y) <= 1.915)
    edge = ~fits & (x >= 0.075) & (x <= 9.925) & (np.abs(y) <= 1.925)  # within the step at which a ray ends
    assert np.allclose(free[~edge], np.where(fits, 9.92 - x, 0.0)[~edge], atol=0.01)
    assert found.mean == pytest.approx(0.96 * 0.5 * 9.84**2 / 10.0 / SIZE_M, rel=0.02)


def test_a_pole_in_the_way_ends_the_ray_at_its_surface_less_the_radius() -> None:
    found = traversability(np.array([pole(6.0, 0.0, 0.25)]), ROOM, 1.0, headings_rad=np.array([0.0]))
    x, y = found.starts_m.T
    behind = (np.abs(y) < 0.32) & (x < 5.6) & (x > 0.1)
    expected = 6.0 - x[behind] - np.sqrt(0.33**2 - y[behind] ** 2)
    assert behind.sum() > 50 and np.allclose(found.free_m[behind, 0], expected, atol=0.03)
    inside = np.hypot(x - 6.0, y) < 0.25
    assert inside.any() and (found.free_m[inside] == 0.0).all()


def test_an_open_forest_has_the_mean_free_path_of_its_density() -> None:
    """1 / (n (d + D)) for trunks of diameter d at n a square metre and a robot of width D."""
    rng = np.random.default_rng(3)
    arena = Arena(x_m=(0.0, 20.0), y_m=(-10.0, 10.0), height_m=8.0, netted=False)
    n, d = 0.6, 0.25
    trunks = np.array([pole(*rng.uniform([0.0, -10.0], [20.0, 10.0]), d / 2) for _ in range(int(n * 400))])
    covered = n * math.pi * (d + SIZE_M) ** 2 / 4.0  # starts that do not fit count 0
    path_m = 1.0 / (n * (d + SIZE_M))
    assert traversability(trunks, arena, 1.0).mean == pytest.approx((1.0 - covered) * path_m / SIZE_M, rel=0.12)


def test_it_is_the_same_every_time_and_takes_as_many_trajectories_as_the_paper() -> None:
    scene = build_scene(load_scene("boxes"), 3)
    one, two = scene_traversability(scene), scene_traversability(scene)
    assert one.mean == two.mean and 1100 <= one.free_m.size < 1107


@pytest.mark.parametrize(("name", "paper"), WITHIN_10_PERCENT.items())
def test_courses_match_the_papers_traversability(name: str, paper: float) -> None:
    values = [scene_traversability(build_scene(load_scene(name), seed)).mean for seed in (1, 2)]
    assert all(0.9 * paper <= value <= 1.1 * paper for value in values), values


@pytest.mark.parametrize("name", [n for n in fixture_names("scenes") if n.startswith("paper-")])
def test_every_row_of_the_paper_draws_courses_that_must_be_dodged(name: str) -> None:
    spec = load_scene(name)
    assert spec.must_dodge and spec.head.paper_row
    assert spec.arena.netted == ("forest" not in name)
    one, other = build_scene(spec, 11), build_scene(spec, 12)
    assert one.to_dict()["obstacles"] != other.to_dict()["obstacles"]
    assert one.to_dict() == build_scene(spec, 11).to_dict()


def test_there_are_thirteen_rows_and_the_speeds_share_their_courses() -> None:
    assert len([n for n in fixture_names("scenes") if n.startswith("paper-")]) == 13
    courses = [build_scene(load_scene(f"paper-speed-{v}"), 5) for v in ("1", "1.5", "2")]
    assert courses[0].obstacles == courses[1].obstacles == courses[2].obstacles
    assert [c.course.speed_m_s for c in courses] == [1.0, 1.5, 2.0]


def test_a_course_that_cannot_have_the_asked_traversability_says_so(tmp_path: Path) -> None:
    text = load_scene("paper-fog").path.read_text().replace("[14.2, 17.4]", "[30.0, 31.0]")
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(UsageError, match=r"most often traversability was under 30 \.\. 31"):
        build_scene(load_scene(str(tmp_path / "x.toml")), 1)


def test_trees_stand_on_the_ground_and_their_leaves_are_soft() -> None:
    tree = build_scene(load_scene("paper-forest-dense"), 1).obstacles[0]
    lowered = tree.primitives()
    assert len(lowered.cylinders) == len(tree.solids()) == 5 and len(lowered.facets) == 24
    at = np.array([[tree.x_m, tree.y_m, -1.0], [tree.x_m + tree.diameter_m, tree.y_m, -1.0]])
    assert tree.signed_distance_m(at) == pytest.approx([-tree.diameter_m / 2, tree.diameter_m / 2], abs=1e-6)
    vertices, triangles = tree.mesh()
    assert triangles.max() == len(vertices) - 1
