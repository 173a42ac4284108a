"""Courses of others: frames and notations against positions worked out by hand, and every fault a line with its key."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.fly import input_hashes, make_plan
from saranga.errors import UsageError
from saranga.fixtures import fixture_dir
from sitl.scene import Scene, build_scene
from sitl.scene_spec import load_scene
from sitl.trial_types import TrialRequest

BOX = {"size": {"l": 2.0, "w": 1.0, "h": 3.0}, "position": {"x": 1.0, "y": 6.0, "z": 0.0, "r": 30.0}}
FLAT = [2.0, 1.0, 3.0, 1.0, 6.0, 0.0, 30.0]
WORLD: dict[str, Any] = {"bounds": {"extents": [0, 12, -3, 3, 0, 4]},
                         "blocks": [{"extents": [5, 5.5, 0.5, 1.5, 0, 2], "color": [1, 0, 0]}],
                         "start": [1, 0, 1], "goal": [11, 0, 1]}


def written(folder: Path, data: Any, name: str = "course.yaml") -> str:
    path = folder / name
    path.write_text(data if isinstance(data, str) else json.dumps(data))  # JSON is YAML
    return str(path)


def loaded(folder: Path, data: Any, name: str = "course.yaml") -> Scene:
    return build_scene(load_scene(written(folder, data, name)), 1)


def test(obstacles: Any) -> dict[str, Any]:
    return {"drone": {"port": "sitl"}, "simulation": {"simulator": "ros", "obstacles": obstacles}}


test.__test__ = False  # type: ignore[attr-defined]


def inside(scene: Scene, x: float, y: float, z: float = -1.0) -> bool:
    return bool(scene.signed_distance_m(np.array([[x, y, z]]))[0] < 0.0)


@pytest.mark.parametrize("name", ["three-boxes.yaml", "flat-list.yaml", "blocks.json"])
def test_shipped_courses_are_scenes(name: str) -> None:
    path = str(fixture_dir() / "courses" / name)
    scene = build_scene(load_scene(path), 3)
    assert len(scene.obstacles) in (2, 3)
    plan = make_plan(TrialRequest(scene=path), 1)
    assert plan.limits == () and "scene" in input_hashes(plan.request)


def test_a_name_without_a_folder_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, WORLD, "world.json")
    monkeypatch.chdir(tmp_path)
    assert load_scene("world.json").name == "world"


@pytest.mark.parametrize("obstacles", [
    [BOX], BOX, FLAT, [FLAT], [*FLAT, *FLAT][:7],
    [{"size": BOX["size"], "position": {"x": 1, "y": 6, "angle": 30}, "shape": "BOX"}]])
def test_every_notation_gives_the_same_box(tmp_path: Path, obstacles: Any) -> None:
    scene = loaded(tmp_path, test(obstacles))
    (box,) = scene.obstacles
    # Home at (0, 0), course to the east (+y): north 1 is 1 m to the left, and 30 deg from north is -60 from east.
    table = box.to_table()
    assert (table["x_m"], table["y_m"]) == pytest.approx((6.0, -1.0))
    assert (table["length_m"], table["width_m"], table["height_m"]) == (2.0, 1.0, 3.0)
    # Its long axis points 30 deg from north towards east: the end of it, in the course's frame.
    assert inside(scene, 6.0 + 0.9 * math.sin(math.radians(30)), -1.0 - 0.9 * math.cos(math.radians(30)))
    assert not inside(scene, 6.0 + 0.9 * math.sin(math.radians(30)), -1.0 + 0.2 + 0.9 * math.cos(math.radians(30)) / 2)
    assert scene.course.start_m == (0.0, 0.0, 0.0) and scene.course.goal_x_m > 6.0 + 0.5


def test_yaml_with_comments_and_missing_optional_keys(tmp_path: Path) -> None:
    scene = loaded(tmp_path, "# by hand\nsimulation:\n  obstacles:\n  - size: {l: 1, w: 5e-1, h: 1e1} # m\n"
                             "    position: {x: 5, y: 0}\n")
    assert inside(scene, 5.0, 0.2) and not inside(scene, 5.6, 0.0) and inside(scene, 5.0, 0.0, -9.9)


def test_no_obstacles_is_an_open_course(tmp_path: Path) -> None:
    assert loaded(tmp_path, test([])).obstacles == ()
    assert loaded(tmp_path, {"drone": {"port": "ros"}, "simulation": {"speed": 1}}).obstacles == ()


def test_mission_gives_start_goal_and_direction(tmp_path: Path) -> None:
    north = 40.0 / (math.radians(1) * 6_371_000.0)
    items = [{"command": 22, "params": [0, 0, 0, None, 47.0, 8.0, 10]},
             {"command": 16, "params": [0, 0, 0, None, 47.0 - north, 8.0, 10]},
             {"command": 21, "params": [0, 0, 0, None, 47.0, 8.0, 0]}]
    (tmp_path / "m.plan").write_text(json.dumps({"mission": {"items": items, "plannedHomePosition": [47.0, 8.0, 1]}}))
    data = test([5, 2, 10, -20, 4, 0, 0])
    data["drone"]["mission_file"] = "case_studies/m.plan"  # found beside the test as well
    scene = loaded(tmp_path, data)
    assert scene.course.goal_x_m == pytest.approx(40.0, abs=1e-6)
    # South is ahead, so east is to the left.
    assert inside(scene, 20.0, -4.0) and inside(scene, 22.4, -4.0) and not inside(scene, 20.0, 4.0)


def test_rotorpy_along_x(tmp_path: Path) -> None:
    scene = loaded(tmp_path, WORLD, "w.json")
    # z up: +y is to the left of a course along +x.
    assert inside(scene, 4.25, -1.0) and not inside(scene, 4.25, 1.0)
    assert scene.arena.x_m == pytest.approx((-1.0, 11.0)) and scene.arena.y_m == pytest.approx((-3.0, 3.0))
    assert scene.course.goal_x_m == pytest.approx(10.0) and scene.course.height_m == 1.0 and scene.arena.netted


@pytest.mark.parametrize(("start", "goal"), [
    ([11, 0, 1], [1, 0, 1]), ([6, -2.5, 1], [6, 2.5, 1]), ([1, -2, 2], [11, 2, 2])])
def test_rotorpy_turns_any_course(tmp_path: Path, start: list[float], goal: list[float]) -> None:
    scene = loaded(tmp_path, {**WORLD, "start": start, "goal": goal}, "w.json")
    ahead = np.subtract(goal, start)[:2] / math.dist(goal[:2], start[:2])
    for px, py in ((5.25, 1.0), (5.05, 0.55), (5.45, 1.45), (5.25, -1.0), (6.0, 1.0), (4.5, 0.6)):
        dx, dy = px - start[0], py - start[1]
        x, right = ahead[0] * dx + ahead[1] * dy, ahead[1] * dx - ahead[0] * dy
        assert inside(scene, x, right) == (5 < px < 5.5 and 0.5 < py < 1.5)
    assert scene.course.goal_x_m == pytest.approx(math.dist(goal[:2], start[:2]))
    assert scene.course.height_m == start[2]


def test_rotorpy_floor_and_floating_blocks(tmp_path: Path) -> None:
    world = {"bounds": {"extents": [0, 12, -3, 3, -1, 3]}, "blocks": [{"extents": [5, 6, -1, 1, 1.5, 3]}]}
    scene = loaded(tmp_path, world, "w.json")
    assert inside(scene, 4.5, 0.0, -2.6) and not inside(scene, 4.5, 0.0, -2.4)


BAD_TESTS: list[tuple[Any, str]] = [
    ([{**BOX, "size": {"l": float("nan"), "w": 1, "h": 1}}], r"obstacles\[0\]\.size\.l = 'NaN'"),
    ([BOX, {**BOX, "size": {"l": 1, "w": -2, "h": 1}}], r"obstacles\[1\]\.size\.w = -2"),
    ([{**BOX, "size": {"l": 1, "h": 1}}], r"size\.w is missing"),
    ([{"size": BOX["size"]}], r"\[0\]\.position = None"),
    ([{**BOX, "shape": "TREE"}], "shape = 'TREE'"),
    (FLAT[:6], "has 6 numbers"), ([FLAT, FLAT[:5]], r"obstacles\[1\]"), ("none", "must be a list"),
    ([*FLAT[:6], "left"], "'left'"), ([7], "has 1 numbers"), ([*FLAT[:3], True, *FLAT[4:]], "True"),
]


@pytest.mark.parametrize(("obstacles", "names"), BAD_TESTS)
def test_faults_of_a_test_are_named(tmp_path: Path, obstacles: Any, names: str) -> None:
    with pytest.raises(UsageError, match=names) as caught:
        load_scene(written(tmp_path, test(obstacles)))
    assert "course.yaml" in str(caught.value) and "\n" not in str(caught.value)


BAD_WORLDS: list[tuple[dict[str, Any], str]] = [
    ({"bounds": None}, "bounds.extents"), ({"bounds": {"extents": [0, 1, 2]}}, "list of 6 numbers"),
    ({"bounds": {"extents": [5, 0, -3, 3, 0, 4]}}, "xmin = 5 is not below"),
    ({"blocks": [{"extents": [5, 4, 0, 1, 0, 2]}]}, r"blocks\[0\].*xmin"), ({"blocks": [{}]}, r"blocks\[0\]\.extents"),
    ({"blocks": [{"extents": [5, 6, 0, 1, 0, float("nan")]}]}, r"extents\[5\] = nan"),
    ({"goal": [20, 0, 1]}, r"goal\[0\] = 20"), ({"start": [1, 0]}, "start"), ({"goal": [1, 0, 3]}, "0.00 m apart"),
    ({"version": 7}, "version = 7"), ({"blocks": 3}, "blocks = 3"),
]


@pytest.mark.parametrize(("change", "names"), BAD_WORLDS)
def test_faults_of_a_world_are_named(tmp_path: Path, change: dict[str, Any], names: str) -> None:
    with pytest.raises(UsageError, match=names) as caught:
        load_scene(written(tmp_path, {**WORLD, **change}, "w.json"))
    assert "w.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(("text", "name"), [
    ("a: [1", "x.yaml"), ("{", "x.json"), ("", "x.yaml"), ("[1, 2]", "x.json"), ("hello: 1", "x.yaml"),
    ("!!python/object/apply:os.getcwd []", "x.yaml")])
def test_what_is_no_course_is_refused(tmp_path: Path, text: str, name: str) -> None:
    with pytest.raises(UsageError, match=name):
        load_scene(written(tmp_path, text, name))


def test_a_blocked_course_is_refused_at_once(tmp_path: Path) -> None:
    wall = {**WORLD, "blocks": [{"extents": [5, 6, -3, 3, 0, 4]}]}
    with pytest.raises(UsageError, match="no way through"):
        loaded(tmp_path, wall, "w.json")
