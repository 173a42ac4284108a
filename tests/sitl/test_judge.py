"""The judge: geometry of the airframe worked out by hand, and every end of a flight."""

import math
from pathlib import Path

import numpy as np
import pytest

from sitl.judge import Judge
from sitl.scene import Scene, build_scene, load_scene
from sitl.swept_volume import AirframeVolume, Spheres

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
# 160 mm across the diagonal: motors 56.57 mm off both axes, propeller radius 38.1 mm.
MOTOR_M, PROP_M = 0.16 / 2 / math.sqrt(2), 0.0381
HALF_WIDTH_M = MOTOR_M + PROP_M
TIP_M = 0.08 + PROP_M
# The spheres stay inside the outline by at most this much.
OUTLINE_M = 0.0025


def scene_of(tmp_path: Path, obstacles: str = "", netted: bool = True, timeout_s: float = 60.0) -> Scene:
    path = tmp_path / "judged.toml"
    path.write_text(f"""
[scene]
name = "judged"
description = "for the judge"
[arena]
netted = {str(netted).lower()}
[course]
start_x_m = 1.0
start_y_m = 0.0
goal_x_m = 9.0
timeout_s = {timeout_s}
{obstacles}
""", encoding="utf-8")
    return build_scene(load_scene(str(path)), 0)


def pole(x=4.0, y=0.0, diameter=0.06, height=1.8) -> str:
    return (f'[[obstacle]]\nkind = "cylinder"\nx_m = {x}\ny_m = {y}\ndiameter_m = {diameter}\nheight_m = {height}\n')


def wall(x=4.0, y0=-1.2, y1=1.2, height=3.0) -> str:
    return f'[[obstacle]]\nkind = "wall"\nfrom_m = [{x}, {y0}]\nto_m = [{x}, {y1}]\nheight_m = {height}\n'


def roll(degrees: float) -> np.ndarray:
    return np.array([math.cos(math.radians(degrees) / 2), math.sin(math.radians(degrees) / 2), 0.0, 0.0])


def yaw(degrees: float) -> np.ndarray:
    return np.array([math.cos(math.radians(degrees) / 2), 0.0, 0.0, math.sin(math.radians(degrees) / 2)])


def fly(scene: Scene, start=(1.0, 0.0, -1.0), velocity=(1.0, 0.0, 0.0), quat=LEVEL, dt_us=2500, seconds=20.0,
        airframe=None) -> Judge:
    """Straight from `start`, until the judge ends it or the time is over."""
    judge = Judge(scene, airframe)
    judge.update(0, np.array(start), quat)
    judge.start_course(0)
    for k in range(1, round(seconds * 1e6 / dt_us) + 1):
        judge.update(k * dt_us, np.array(start) + np.array(velocity) * (k * dt_us * 1e-6), quat)
        if judge.finished:
            break
    return judge


# ---- geometry ------------------------------------------------------------------------------------
@pytest.mark.parametrize("diameter", [0.02, 0.06, 0.46])
def test_passing_a_pole_measures_the_true_clearance(tmp_path, diameter):
    for gap_m in (0.004, 0.05, 0.4):
        scene = scene_of(tmp_path, pole(y=HALF_WIDTH_M + diameter / 2 + gap_m, diameter=diameter))
        result = fly(scene).result()
        assert result.outcome == "clean"
        assert result.min_clearance_m == pytest.approx(gap_m, abs=OUTLINE_M)


@pytest.mark.parametrize("diameter", [0.02, 0.06, 0.46])
def test_grazing_deeper_than_the_outlines_error_is_a_hit(tmp_path, diameter):
    scene = scene_of(tmp_path, pole(y=HALF_WIDTH_M + diameter / 2 - OUTLINE_M, diameter=diameter))
    assert fly(scene).result().outcome == "obstacle_hit"


def test_head_on_hits_where_the_airframe_touches(tmp_path):
    result = fly(scene_of(tmp_path, wall())).result()
    # wall half thickness 2.5 mm; the front propellers reach HALF_WIDTH_M forward
    assert result.t_us == pytest.approx((3.0 - 0.0025 - HALF_WIDTH_M) * 1e6, abs=6000)
    assert result.min_clearance_m == 0.0
    assert result.duration_s == pytest.approx(result.t_us / 1e6)
    assert result.path_length_m == pytest.approx(result.t_us / 1e6, abs=1e-6)


@pytest.mark.parametrize("dt_us", [2500, 20_000, 100_000, 500_000])
def test_nothing_is_jumped_over_at_3_m_s(tmp_path, dt_us):
    # At 0.1 s a pose lies 16 cm before the pole and the next 14 cm beyond it: neither touches.
    scene = scene_of(tmp_path, pole(x=4.763, y=0.01, diameter=0.02))
    result = fly(scene, velocity=(3.0, 0.0, 0.0), dt_us=dt_us).result()
    assert result.outcome == "obstacle_hit"
    assert "at 3.00 m/s" in result.cause
    # between the motor arms of the two propellers the arms or the body's front touch first
    assert 3.763 - TIP_M - 0.01 <= 3.0 * result.t_us / 1e6 <= 3.763


def test_a_fast_turn_between_two_updates_is_swept_too(tmp_path):
    # Flying along with a pole beside it: level at 0 and at 90 degrees of yaw it clears, at 45 a propeller reaches out.
    scene = scene_of(tmp_path, pole(x=5.0, y=TIP_M + 0.01 - 0.006, diameter=0.02))
    for quat in (LEVEL, yaw(90)):
        still = Judge(scene)
        still.update(0, np.array([5.0, 0.0, -1.0]), quat)
        assert not still.finished
    judge = Judge(scene)
    judge.update(0, np.array([5.0, 0.0, -1.0]), LEVEL)
    judge.update(2500, np.array([5.0, 0.0, -1.0]), yaw(90))
    assert judge.result().outcome == "obstacle_hit"
    assert judge.result().part == "propeller"


def test_sign_of_the_quaternion_does_not_matter(tmp_path):
    # q and -q are one attitude: going from one to nearly the other must not turn the airframe round on the way.
    scene = scene_of(tmp_path, pole(x=5.0, y=TIP_M + 0.01 - 0.006, diameter=0.02))
    judge = Judge(scene)
    judge.update(0, np.array([4.97, 0.0, -1.0]), LEVEL)
    judge.update(2500, np.array([5.0, 0.0, -1.0]), -yaw(20))
    assert not judge.finished
    assert judge.result().min_clearance_m > 0.005


def test_tilt_lowers_the_rim_into_what_lies_below(tmp_path):
    # Level, the lowest part is the body's underside at 22.5 mm; rolled by 30 degrees the right rim drops by
    # 94.7 mm x sin 30 - 25 mm x cos 30 = 25.7 mm.
    lid = ('[[obstacle]]\nkind = "box"\nx_m = 5.0\ny_m = 0.11\nlength_m = 2.0\nwidth_m = 0.1\nheight_m = 0.976\n')
    scene = scene_of(tmp_path, lid)
    assert fly(scene).result().outcome == "clean"
    tilted = fly(scene, quat=roll(30)).result()
    assert tilted.outcome == "obstacle_hit"
    assert tilted.part == "propeller"
    assert "right propeller" in tilted.cause
    assert fly(scene, quat=roll(-30)).result().outcome == "clean"


def test_tilt_narrows_the_width(tmp_path):
    # Rolled by 40 degrees away from the pole the rim comes in: 94.7 cos 40 + 25 sin 40 = 88.6 mm.
    scene = scene_of(tmp_path, pole(y=0.03 + 0.0925))
    assert fly(scene).result().outcome == "obstacle_hit"
    assert fly(scene, quat=roll(-40)).result().outcome == "clean"


def test_spheres_fill_the_outline():
    spheres = Spheres(AirframeVolume())
    low = (spheres.table[:, :3] - spheres.table[:, 3:]).min(axis=0)
    high = (spheres.table[:, :3] + spheres.table[:, 3:]).max(axis=0)
    assert high == pytest.approx([HALF_WIDTH_M, HALF_WIDTH_M, 0.0225], abs=0.001)
    assert low == pytest.approx([-HALF_WIDTH_M, -HALF_WIDTH_M, -0.030], abs=0.001)
    assert spheres.reach_m == pytest.approx(math.hypot(TIP_M, 0.025), abs=0.002)


def test_a_bigger_airframe_hits_what_the_small_one_passes(tmp_path):
    scene = scene_of(tmp_path, pole(y=0.2))
    assert fly(scene).result().outcome == "clean"
    big = AirframeVolume(wheelbase_m=0.32, prop_diameter_m=0.127)
    assert fly(scene, airframe=big).result().outcome == "obstacle_hit"


# ---- what was hit --------------------------------------------------------------------------------
@pytest.mark.parametrize(("start", "velocity", "obstacle", "part", "words"), [
    ((3.0, 0.0, -1.0), (1.0, 0.0, 0.0), pole(y=0.0, diameter=0.02), "front", "front of the body"),
    ((5.0, 0.0, -1.0), (-1.0, 0.0, 0.0), pole(y=0.0, diameter=0.02), "rear", "rear of the body"),
    ((4.0, 1.0, -1.0), (0.0, -1.0, 0.0), pole(y=0.0, diameter=0.02), "side", "side of the body"),
    ((3.0, 0.0, -1.0), (1.0, 0.0, 0.0), pole(y=0.08), "propeller", "front right propeller"),
    ((3.0, 0.0, -1.0), (1.0, 0.0, 0.0), pole(y=-0.08), "propeller", "front left propeller"),
    ((5.0, 0.0, -1.0), (-1.0, 0.0, 0.0), pole(y=0.08), "propeller", "rear right propeller"),
    ((5.0, 0.0, -1.0), (-1.0, 0.0, 0.0), pole(y=-0.08), "propeller", "rear left propeller"),
])
def test_the_part_that_was_hit(tmp_path, start, velocity, obstacle, part, words):
    result = fly(scene_of(tmp_path, pole(x=8.0, y=-1.0) + obstacle), start, velocity).result()
    assert result.outcome == "obstacle_hit"
    assert result.part == part
    assert words in result.cause
    assert result.obstacle_index == 1


def test_the_part_is_told_in_the_bodys_own_axes(tmp_path):
    scene = scene_of(tmp_path, pole(diameter=0.02))
    assert fly(scene, (3.0, 0.0, -1.0), quat=yaw(90)).result().part == "side"
    assert fly(scene, (3.0, 0.0, -1.0), quat=yaw(180)).result().part == "rear"


def test_the_cause_reads_as_a_sentence(tmp_path):
    scene = scene_of(tmp_path, pole(x=2.0, y=1.5) + pole(x=4.2, y=-0.31))
    result = fly(scene, (3.0, -0.25, -1.0), (0.94, 0.0, 0.0)).result()
    assert result.cause == ("front left propeller hit obstacle 2 (cylinder at x 4.20 m, y -0.31 m) at 0.94 m/s")


@pytest.mark.parametrize(("start", "velocity", "words"), [
    ((1.0, 0.0, -1.0), (0.0, 1.0, 0.0), "right net"),
    ((1.0, 0.0, -1.0), (0.0, -1.0, 0.0), "left net"),
    ((1.0, 0.0, -1.0), (-1.0, 0.0, 0.0), "rear net"),
    ((1.0, 0.0, -1.0), (0.0, 0.0, -1.0), "ceiling net"),
])
def test_nets_end_a_flight_only_where_there_are_any(tmp_path, start, velocity, words):
    result = fly(scene_of(tmp_path), start, velocity, seconds=3.5).result()
    assert result.outcome == "net_hit"
    assert words in result.cause
    assert result.part is not None
    assert result.net_clearance_m == 0.0
    assert (result.success_strict, result.success_lenient) == (False, True)
    free = fly(scene_of(tmp_path, netted=False), start, velocity, seconds=3.5)
    assert not free.finished
    assert math.isnan(free.result().net_clearance_m)


def test_net_clearance_is_measured_apart_from_obstacles(tmp_path):
    result = fly(scene_of(tmp_path, pole(y=-1.0)), (1.0, 1.5, -1.0)).result()
    assert result.outcome == "clean"
    assert result.net_clearance_m == pytest.approx(0.75 - HALF_WIDTH_M, abs=OUTLINE_M)
    assert result.min_clearance_m == pytest.approx(2.5 - 0.03 - HALF_WIDTH_M, abs=OUTLINE_M)


def test_the_ground_is_never_a_hit(tmp_path):
    judge = fly(scene_of(tmp_path, pole(y=-1.0)), (1.0, 0.0, -0.5), (0.0, 0.0, 1.0), seconds=1.0)
    assert not judge.finished


# ---- how flights end -----------------------------------------------------------------------------
def test_a_clean_flight(tmp_path):
    judge = fly(scene_of(tmp_path))
    result = judge.result()
    assert judge.reached_goal
    assert result.outcome == "clean"
    assert result.t_us == pytest.approx(8.0e6, abs=2501)
    assert result.duration_s == result.t_us / 1e6
    assert result.path_length_m == pytest.approx(8.0, abs=0.003)
    assert math.isnan(result.min_clearance_m)
    assert (result.part, result.obstacle_index) == (None, None)
    assert result.success_strict
    assert result.success_lenient


def test_obstacles_count_before_the_course_but_the_goal_does_not(tmp_path):
    scene = scene_of(tmp_path, pole(x=2.0))
    judge = Judge(scene)
    judge.update(0, np.array([9.5, 1.0, -1.0]), LEVEL)
    judge.update(2500, np.array([9.5, 1.0, -1.0]), LEVEL)
    assert not judge.finished
    judge = Judge(scene)
    judge.update(0, np.array([1.5, 0.0, -1.0]), LEVEL)
    judge.update(500_000, np.array([2.0, 0.0, -1.0]), LEVEL)
    result = judge.result()
    assert result.outcome == "obstacle_hit"
    assert math.isnan(result.duration_s)
    assert result.path_length_m == 0.0


def test_timeout_counts_from_the_start_of_the_course(tmp_path):
    scene = scene_of(tmp_path, timeout_s=20.0)
    judge = Judge(scene)
    for k in range(100):
        judge.update(k * 100_000, np.array([1.0, 0.0, -1.0]), LEVEL)
    judge.start_course(9_900_000)
    k = 100
    while not judge.finished:
        judge.update(k * 100_000, np.array([1.0 + 0.01 * (k - 99), 0.0, -1.0]), LEVEL)
        k += 1
    result = judge.result()
    assert result.outcome == "timeout"
    assert result.t_us == 29_900_000
    assert result.duration_s == 20.0
    assert "20 s" in result.cause
    assert not result.success_lenient


@pytest.mark.parametrize(("speed", "outcome"), [(0.0, "stuck"), (0.03, "stuck"), (0.05, "timeout")])
def test_stuck_is_less_than_a_third_of_a_metre_in_eight_seconds(tmp_path, speed, outcome):
    result = fly(scene_of(tmp_path), velocity=(speed, 0.0, 0.0), dt_us=50_000, seconds=70.0).result()
    assert result.outcome == outcome
    if speed == 0.0:
        assert result.t_us == 8_000_000


def test_flying_to_and_fro_is_stuck(tmp_path):
    judge = Judge(scene_of(tmp_path))
    judge.start_course(0)
    t_us = 0
    while not judge.finished and t_us < 30_000_000:
        t_us += 50_000
        judge.update(t_us, np.array([3.0, math.sin(t_us / 1e6), -1.0]), LEVEL)
    assert judge.result().outcome == "stuck"


def test_an_unfinished_flight_is_never_clean(tmp_path):
    result = fly(scene_of(tmp_path), seconds=2.0).result()
    assert result.outcome == "infrastructure"
    assert "not finished" in result.cause
    assert Judge(scene_of(tmp_path)).result().outcome == "infrastructure"


@pytest.mark.parametrize("pose", [
    (np.array([np.nan, 0.0, -1.0]), LEVEL), (np.array([1.0, np.inf, -1.0]), LEVEL),
    (np.array([1.0, 0.0, -1.0]), np.array([1.0, np.nan, 0.0, 0.0])), (np.array([1.0, 0.0, -1.0]), np.zeros(4)),
])
def test_a_pose_that_is_no_number_is_infrastructure(tmp_path, pose):
    judge = Judge(scene_of(tmp_path))
    judge.update(0, np.array([1.0, 0.0, -1.0]), LEVEL)
    judge.start_course(0)
    judge.update(2500, *pose)
    judge.update(5000, np.array([9.5, 0.0, -1.0]), LEVEL)
    result = judge.result()
    assert result.outcome == "infrastructure"
    assert "not a number" in result.cause


def test_time_running_backwards_is_infrastructure(tmp_path):
    judge = Judge(scene_of(tmp_path))
    judge.update(5000, np.array([1.0, 0.0, -1.0]), LEVEL)
    judge.update(2500, np.array([1.0, 0.0, -1.0]), LEVEL)
    assert judge.result().outcome == "infrastructure"
    assert "backwards" in judge.result().cause


def test_what_the_trial_declares_is_never_turned_into_clean(tmp_path):
    judge = fly(scene_of(tmp_path), seconds=2.0)
    judge.fail("estimator_failure", "EKF lost its position")
    judge.update(9_000_000, np.array([9.5, 0.0, -1.0]), LEVEL)
    result = judge.result()
    assert (result.outcome, result.cause) == ("estimator_failure", "EKF lost its position")
    assert not judge.reached_goal


def test_a_failure_after_the_goal_replaces_clean_but_not_a_hit(tmp_path):
    judge = fly(scene_of(tmp_path))
    judge.fail("infrastructure", "autopilot died")
    assert judge.result().outcome == "infrastructure"
    assert "autopilot died" in judge.result().cause
    judge = fly(scene_of(tmp_path, wall()))
    judge.fail("infrastructure", "autopilot died")
    assert judge.result().outcome == "obstacle_hit"


def test_only_what_the_judge_cannot_see_can_be_declared(tmp_path):
    with pytest.raises(ValueError, match="'clean' cannot be declared"):
        Judge(scene_of(tmp_path)).fail("clean", "trust me")


def test_a_net_touched_after_the_goal_is_said_and_does_not_count(tmp_path):
    scene = scene_of(tmp_path)
    judge = fly(scene)
    before = judge.result()
    judge.update(11_000_000, np.array([10.95, 0.0, -1.0]), LEVEL)
    judge.update(11_100_000, np.array([10.96, 0.0, -1.0]), LEVEL)
    result = judge.result()
    assert judge.reached_goal and result.outcome == "clean" and result.part is None
    assert result.cause.startswith(before.cause) and result.cause.count("after the goal") == 1
    assert result.path_length_m == pytest.approx(8.0, abs=0.003)
    assert result.duration_s == before.duration_s


def test_same_flight_same_judgement_to_the_bit(tmp_path):
    scene = scene_of(tmp_path, pole(y=0.4))
    assert fly(scene).result() == fly(scene).result()
