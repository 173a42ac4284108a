"""Figures of one flight, from logs whose answer is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from saranga.localise import Obstacle
from sitl.measures import measures_of
from sitl.scene import build_scene, load_scene
from sitl.trial_types import FlightLog

SCENE = build_scene(load_scene("poles"), 1).to_dict()
POLE = SCENE["obstacles"][0]
TICKS = 80


def log(seen_from: int = 40, blind: int = -1, sideways_from: int = 60, turned: bool = False) -> FlightLog:
    """Towards the first pole at 1 m/s from 6 m before it; reported where it is from a tick on, but for one."""
    x, y = float(POLE["x_m"]), float(POLE["y_m"])
    way = np.arange(TICKS) / 16.0
    pos = np.stack([x - 6.0 + way, np.full(TICKS, y), np.full(TICKS, -1.0)], axis=1)
    vel = np.tile([1.0, 0.0, 0.0], (TICKS, 1))
    vel[sideways_from:, 1] = 0.3
    half = math.sqrt(0.5)
    quat = np.tile([half, 0.0, 0.0, half] if turned else [1.0, 0, 0, 0], (TICKS, 1))
    found: list[list[Obstacle]] = [[] for _ in range(TICKS)]
    for tick in range(seen_from, TICKS):
        if tick != blind:
            ahead = x - pos[tick, 0]
            bx, by = (0.0, -ahead) if turned else (ahead, 0.0)  # a vehicle turned to the right has it on its left
            found[tick] = [Obstacle(range_m=ahead, azimuth_rad=0.0, elevation_rad=0.0, x_m=bx, y_m=by, z_m=0.0,
                                    score=1.0)]
    pixels = np.zeros((TICKS, 0), np.uint8)
    return FlightLog(
        t_us=np.arange(TICKS, dtype=np.int64) * 62_500, pos_m=pos, vel_m_s=vel, quat=quat, thrust_n=np.ones((TICKS, 4)),
        phase=["takeoff"] * 10 + ["course"] * (TICKS - 10), command=np.zeros((TICKS, 4)), envelope_left=pixels,
        envelope_right=pixels, edges_left=pixels, edges_right=pixels, obstacles=found,
        scene={**SCENE, "obstacles": [POLE]})


def radius_m() -> float:
    return float(POLE.get("diameter_m", 2 * POLE.get("radius_m", 0.0))) / 2


def far(flight: FlightLog) -> FlightLog:
    return replace(flight, pos_m=flight.pos_m + np.array([0.0, 3.0, 0.0]))


@pytest.mark.parametrize("turned", [False, True])
def test_where_it_was_first_seen_twice_in_a_row(turned: bool) -> None:
    at_m = 6.0 - 41 / 16.0 - radius_m()
    assert measures_of(log(40, turned=turned))["first_seen_m"] == pytest.approx(at_m, abs=1e-6)
    later = measures_of(log(40, blind=41, turned=turned))["first_seen_m"]
    assert later == pytest.approx(6.0 - 43 / 16.0 - radius_m(), abs=1e-6), "one tick alone is chance"


def test_what_was_never_seen_counts_as_zero_and_what_was_never_near_not_at_all() -> None:
    near = log(TICKS)
    assert measures_of(near)["first_seen_m"] == 0.0, "1.06 m from it, and never reported"
    before = replace(near, pos_m=near.pos_m - np.array([0.5, 0.0, 0.0]))
    assert math.isnan(measures_of(before)["first_seen_m"]), "it was not near yet"
    passed = replace(near, pos_m=near.pos_m + np.array([1.5, 0.0, 0.0]))
    assert math.isnan(measures_of(far(passed))["first_seen_m"])


def test_where_it_began_to_move_sideways() -> None:
    assert measures_of(log(sideways_from=60))["dodge_from_m"] == pytest.approx(6.0 - 60 / 16.0 - radius_m(), abs=1e-6)
    assert math.isnan(measures_of(log(sideways_from=TICKS))["dodge_from_m"])
    early = measures_of(log(sideways_from=0))["dodge_from_m"]
    assert early == pytest.approx(6.0 - 10 / 16.0 - radius_m(), abs=1e-6), "only the course counts"


def test_without_a_log_only_what_is_given_is_known() -> None:
    found = measures_of(None, 41.5)
    assert found.pop("echo_to_setpoint_ms") == 41.5 and all(math.isnan(v) for v in found.values())
    assert measures_of(log())["end_speed_m_s"] == pytest.approx(math.hypot(1.0, 0.3))
