"""Scene files: reading, refusing, and building the same place from the same seed."""

import json

import numpy as np
import pytest

from saranga.errors import UsageError
from saranga.fixtures import fixture_names
from sitl.physics import WindLike
from sitl.scene import build_scene, load_scene
from sitl.shapes import shape_from_table

SHIPPED = ["boxes", "open", "poles", "poles-windy", "tunnels", "wall"]
PLAIN = """
[scene]
name = "mine"
description = "a test"
[arena]
[course]
start_x_m = 1.0
start_y_m = 0.0
goal_x_m = 9.0
"""
POLE = """
[[obstacle]]
kind = "cylinder"
x_m = 4.0
y_m = 0.02
diameter_m = 0.06
height_m = 1.8
"""


def written(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def built(tmp_path, text, seed=0):
    return build_scene(load_scene(written(tmp_path, text)), seed)


def test_every_agreed_scene_ships_and_builds():
    assert set(SHIPPED) <= set(fixture_names("scenes"))
    for name in fixture_names("scenes"):
        scene = build_scene(load_scene(name), 3)
        assert scene.name == name
        assert scene.course.goal_x_m > scene.course.start_m[0]


@pytest.mark.parametrize("name", ["poles", "boxes", "tunnels"])
def test_same_seed_same_scene_other_seed_other(name):
    spec = load_scene(name)
    one, again, other = (build_scene(spec, seed) for seed in (7, 7, 8))
    assert one.to_dict() == again.to_dict()
    assert one.primitives.cylinders.tobytes() == again.primitives.cylinders.tobytes()
    assert one.primitives.facets.tobytes() == again.primitives.facets.tobytes()
    assert one.to_dict()["obstacles"] != other.to_dict()["obstacles"]
    assert one.course.start_m != other.course.start_m


def test_another_name_is_another_course_for_the_same_seed():
    calm, windy = (build_scene(load_scene(name), 1) for name in ("poles", "poles-windy"))
    assert calm.course.start_m != windy.course.start_m
    assert (windy.wind.mean_m_s, windy.wind.gust_m_s) == (3.0, 1.5)


def test_the_poles_are_the_papers():
    scene = build_scene(load_scene("poles"), 1)
    assert len(scene.obstacles) == 6
    assert np.all(scene.primitives.cylinders[:, 6] == 0.03)
    assert np.allclose(scene.primitives.cylinders[:, [2, 5]], [0.0, -1.8])
    assert (scene.arena.x_m, scene.arena.y_m, scene.arena.height_m) == ((0.0, 11.0), (-2.25, 2.25), 3.65)


def test_dict_is_json_and_gives_the_obstacles_back():
    scene = build_scene(load_scene("wall"), 2)
    again = json.loads(json.dumps(scene.to_dict()))
    assert [shape_from_table(table) for table in again["obstacles"]] == list(scene.obstacles)
    assert again["course"]["start_m"] == list(scene.course.start_m)
    assert again["weather"]["humidity_percent"] == 50.0


def test_ground_is_heard_and_nets_are_not():
    parts = build_scene(load_scene("open"), 0).primitives
    assert len(parts) == len(parts.facets) == 1
    ground = parts.facets[0]
    assert np.cross(ground[3:6], ground[6:9]) == pytest.approx([0.0, 0.0, -1.0])
    assert ground[2] == 0.0
    assert ground[11] == pytest.approx(0.9)
    reach = np.abs(ground[3:6]) * ground[9] + np.abs(ground[6:9]) * ground[10]
    assert np.all(ground[:2] - reach[:2] < [0.0, -2.25])
    assert np.all(ground[:2] + reach[:2] > [11.0, 2.25])


def test_fog_snow_and_light_change_nothing_that_is_heard(tmp_path):
    text = PLAIN + POLE
    clear = built(tmp_path, text)
    thick = built(tmp_path, text + "[weather]\nfog_extinction_per_m = 2.0\nsnow_rate_mm_h = 20.0\nlight_lux = 0.0\n")
    for name in ("facets", "cylinders", "edges"):
        assert getattr(clear.primitives, name).tobytes() == getattr(thick.primitives, name).tobytes()
    for name in ("temperature_c", "humidity_percent", "pressure_pa"):
        assert getattr(clear.weather, name) == getattr(thick.weather, name)
    assert thick.to_dict()["weather"]["fog_extinction_per_m"] == 2.0


def test_wind_is_what_the_physics_takes():
    wind: WindLike = build_scene(load_scene("poles-windy"), 0).wind
    assert wind.direction_deg == 90.0
    assert wind.gust_s == 1.5


def test_distance_and_owner_of_the_scene():
    scene = build_scene(load_scene("wall"), 0)
    assert scene.signed_distance_m(np.array([[3.0, 0.0, -1.0]]))[0] == pytest.approx(0.6 - 0.0025)
    assert list(scene.solid_owner) == [0, 1, 2, 3]
    empty = build_scene(load_scene("open"), 0)
    assert empty.signed_distance_m(np.zeros((1, 3)))[0] == np.inf
    assert empty.solids.shape == (0, 16)


def test_must_dodge_holds_for_written_out_courses_too(tmp_path):
    assert len(built(tmp_path, PLAIN + POLE).obstacles) == 1
    dodge = PLAIN + "must_dodge = true\n"
    assert len(built(tmp_path, dodge + POLE).obstacles) == 1
    with pytest.raises(UsageError, match="a straight flight passed"):
        built(tmp_path, dodge + POLE.replace("y_m = 0.02", "y_m = 0.14"))


def test_a_start_range_is_drawn_until_the_flight_must_dodge(tmp_path):
    text = PLAIN.replace("start_y_m = 0.0", "start_y_m = [-0.6, 0.6]") + "must_dodge = true\n" + POLE
    scenes = [built(tmp_path, text, seed) for seed in range(40)]
    starts = np.array([scene.course.start_m[1] for scene in scenes])
    # pole radius 30 mm + half the airframe's width of 95 mm
    assert np.abs(starts - 0.02).max() < 0.125
    assert np.ptp(starts) > 0.15
    assert max(scene.tries for scene in scenes) > 1


def test_an_obstacle_on_the_start_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"within 0\.8 m of the start"):
        built(tmp_path, PLAIN + POLE.replace("x_m = 4.0", "x_m = 1.5"))


def test_impossible_course_names_the_rule(tmp_path):
    text = PLAIN + '[generator]\nkind = "poles"\ncount = 6\nmin_gap_m = 2.0\n'
    with pytest.raises(UsageError) as caught:
        built(tmp_path, text)
    assert "no course in 500 drawings" in str(caught.value)
    assert "nearer than 2 m" in str(caught.value)
    assert "mine.toml" in str(caught.value)


def test_negative_seed_is_refused():
    with pytest.raises(UsageError, match="seed = -1"):
        build_scene(load_scene("open"), -1)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("[arena]", "[arenas]", ["'arenas'", "did you mean 'arena'"]),
    ("[arena]", "", ["[arena] is missing"]),
    ("[arena]", "[arena]\nx_m = [11.0, 0.0]", ["[arena] x_m", "[smallest, largest]"]),
    ("[arena]", "[arena]\nx_m = 11.0", ["[arena] x_m = 11.0", "tuple"]),
    ("[arena]", "[arena]\nnetted = 1", ["[arena] netted = 1", "boolean"]),
    ("goal_x_m = 9.0", "", ["[course]", "'goal_x_m' is missing"]),
    ("goal_x_m = 9.0", "goal_x_m = 0.5", ["goal_x_m = 0.5 must lie beyond start_x_m = 1"]),
    ("goal_x_m = 9.0", "goal_x_m = 12.0", ["[course] goal_x_m = 12", "arena.x_m = 0 .. 11"]),
    ("goal_x_m = 9.0", "goal_x_m = nan", ["[course] goal_x_m = nan", "finite"]),
    ("goal_x_m = 9.0", "goal_x_m = 9.0\nspeed_mps = 2.0", ["'speed_mps'", "did you mean 'speed_m_s'"]),
    ("start_y_m = 0.0", "start_y_m = 2.5", ["[course] start_y_m = 2.5", "-2.25 .. 2.25"]),
    ("start_y_m = 0.0", "start_y_m = [0.5, -0.5]", ["[course] start_y_m", "[smallest, largest]"]),
    ("[course]", "[weather]\nhumidity_percent = 140\n[course]", ["[weather] humidity_percent = 140", "100"]),
    ("[course]", "[wind]\ngust_s = 0\n[course]", ["[wind] gust_s = 0", "greater than 0"]),
    ("[course]", '[generator]\nkind = "trees"\n[course]', ["'trees'", "boxes, forest, mixed, poles"]),
    ("[course]", "[generator]\ncount = 3\n[course]", ["[generator]", "'kind' is missing"]),
    ("[course]", '[generator]\nkind = "poles"\ncount = 0\n[course]', ["count = 0", "greater than or equal to 1"]),
    ("[course]", '[generator]\nkind = "poles"\nx_m = [3.0, 5.0]\n[course]', ["too short for 5 obstacles"]),
    ("[course]", '[obstacle]\nkind = "box"\n[course]', ["[[obstacle]]", "one table each"]),
    ("[course]", '[[obstacle]]\nkind = "cone"\n[course]', ["[[obstacle]] 1", "'cone'"]),
    ("[course]", "[course", ["not valid TOML", "line"]),
    ('description = "a test"', "description = 3", ["[scene] description = 3", "string"]),
    ('[scene]\nname = "mine"\ndescription = "a test"', 'scene = "mine"', ["[scene] must be a table"]),
])
def test_bad_files_get_one_clear_line(tmp_path, old, new, words):
    assert old in PLAIN
    with pytest.raises(UsageError) as caught:
        built(tmp_path, PLAIN.replace(old, new))
    text = str(caught.value)
    assert "mine.toml" in text
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_unknown_scene_lists_the_known_ones():
    with pytest.raises(UsageError, match=r"did you mean 'poles'.*boxes, hall, open, paper-3d"):
        load_scene("pole")
