"""The planner against arenas whose answer is known."""

import numpy as np
import pytest

from sitl.feasibility import dodges_needed, straight_flight_hits, way_through
from sitl.shapes import shape_from_table
from sitl.solids import stack_solids

ARENA = ((0.0, 11.0), (-2.25, 2.25))
START = (0.8, 0.0, 0.0)


def wall(y0, y1, x=4.0, height=3.0):
    return {"kind": "wall", "from_m": [x, y0], "to_m": [x, y1], "height_m": height}


def pole(x, y, diameter=0.06, height=1.8):
    return {"kind": "cylinder", "x_m": x, "y_m": y, "diameter_m": diameter, "height_m": height}


def solids(*tables):
    return stack_solids([shape_from_table(table).solids() for table in tables])


def through(*tables, netted=True, height=1.0, arena=ARENA):
    return way_through(solids(*tables), *arena, netted, START, 9.5, height)


def test_an_empty_arena_is_open_and_a_full_wall_closes_it():
    assert through()
    assert not through(wall(-2.25, 2.25))


def test_the_gap_must_be_as_wide_as_the_airframe_and_its_margin():
    # 2 x (0.12 + 0.20) = 0.64 m
    assert through(wall(-2.25, 0.5), wall(1.22, 2.25))
    assert not through(wall(-2.25, 0.5), wall(1.10, 2.25))


def test_the_passage_beside_a_net_counts_the_net():
    assert through(wall(-2.25, 1.53))
    assert not through(wall(-2.25, 1.70))
    assert through(wall(-2.25, 1.70), netted=False)


def test_a_low_wall_is_flown_over():
    assert through(wall(-2.25, 2.25, height=0.6))
    assert not through(wall(-2.25, 2.25, height=0.8))


def test_a_maze_is_solved_and_a_sealed_pocket_is_not():
    walls = [wall(-2.25, 1.3, x=3.0), wall(-1.3, 2.25, x=5.0), wall(-2.25, 1.3, x=7.0)]
    assert through(*walls)
    lid = {"kind": "wall", "from_m": [3.0, 1.3], "to_m": [5.0, 1.3], "height_m": 3.0}
    assert not through(*walls, lid)


@pytest.mark.parametrize(("y_m", "hits"), [(0.0, True), (0.11, True), (-0.11, True), (0.14, False), (-0.14, False)])
def test_straight_flight_sweeps_the_airframes_width(y_m, hits):
    # half of the width over both propellers 94.7 mm + pole radius 30 mm = 124.7 mm
    assert straight_flight_hits(solids(pole(5.013, y_m)), START, 9.5, 1.0) is hits


def test_straight_flight_passes_over_and_short_of_obstacles():
    assert not straight_flight_hits(solids(pole(5.0, 0.0, height=0.8)), START, 9.5, 1.0)
    assert not straight_flight_hits(solids(pole(9.9, 0.0)), START, 9.5, 1.0)


def test_dodges_are_counted():
    assert dodges_needed(solids(pole(5.0, 1.0)), START, 9.5, 1.0) == 0
    assert dodges_needed(solids(pole(5.0, 0.0)), START, 9.5, 1.0) == 1
    comb = [pole(2.5 + 1.3 * k, 0.22 * offset) for k, offset in enumerate((0, 2, -1, 1, -2))]
    assert dodges_needed(solids(*comb), START, 9.5, 1.0) == 2
    assert dodges_needed(solids(*comb[:4]), START, 9.5, 1.0) == 1


def test_no_obstacles_at_all():
    assert not straight_flight_hits(np.zeros((0, 16)), START, 9.5, 1.0)
