"""First flight: the stack flies a course that cannot be flown blind, the same way each time.

Unmarked flights are on the embedded autopilot, or on what --bench-autopilot says; marked ones are on the real
firmware. A course drawn by a seed that is flown straight ends in an obstacle, so a stack that does nothing fails.
"""

from collections.abc import Callable
from typing import Any

import pytest

SEEDS = (1, 2, 3)
Flight = Any
Accept = Callable[..., Any]


@pytest.mark.parametrize("seed", SEEDS)
def test_poles_are_flown_clean(flight: Flight, accept: Accept, seed: int) -> None:
    result = flight("poles", seed=seed)
    accept(result)
    assert result.landed
    assert result.min_clearance_m > 0
    assert result.link_counters["bad_crc"] == 0
    assert result.link_counters["sequence_gaps"] == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_without_avoidance_the_same_courses_end_in_an_obstacle(flight: Flight, seed: int) -> None:
    result = flight("poles", seed=seed, stack="none")
    assert result.outcome == "obstacle_hit", result.cause
    assert not result.success_lenient


def test_same_seed_same_flight_other_seed_another(flight: Flight) -> None:
    one, again, other = (flight("poles", seed=seed, denoiser="gaussian") for seed in (4, 4, 5))
    assert one.determinism_hash == again.determinism_hash
    assert one.determinism_hash != other.determinism_hash
    assert (one.log.pos_m == again.log.pos_m).all()
    assert (one.log.envelope_left == again.log.envelope_left).all()


@pytest.mark.slow
def test_poles_hold_the_limit(flight: Flight, accept: Accept) -> None:
    accept(flight.many("poles", 20))


@pytest.mark.real_arducopter
def test_real_arducopter_flies_the_poles(flight: Flight, accept: Accept) -> None:
    # one that succeeds, with all that it leaves behind; how many do is a campaign's matter
    result = flight("poles", seed=2)
    accept(result)
    assert result.autopilot["kind"] == "arducopter"
    assert result.landed
    assert "dataflash" in result.files


@pytest.mark.real_arducopter
def test_real_arducopter_without_avoidance_hits(flight: Flight) -> None:
    assert flight("poles", seed=1, stack="none").outcome == "obstacle_hit"


@pytest.mark.real_arducopter
def test_real_arducopter_is_repeatable(flight: Flight) -> None:
    one, again, other = (flight("poles", seed=seed, denoiser="gaussian") for seed in (1, 1, 2))
    assert one.determinism_hash == again.determinism_hash
    assert one.determinism_hash != other.determinism_hash
