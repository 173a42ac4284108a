"""The contract of a policy (`saranga.navigate.base.Policy`): obstacles (or echo images) and time in, a velocity out."""

import copy
from collections.abc import Callable, Sequence
from math import atan2, cos, isfinite, nan, sin
from typing import Any

import numpy as np
import pytest

from bench.contract import echoes
from bench.contract.latency import TICK_MS, latency_check, latency_text
from bench.contract.subject import Subject, is_echo_policy
from saranga.denoise import load_denoiser
from saranga.echo import EchoImage, SonarGeometry, load_sonar
from saranga.localise import Obstacle
from saranga.navigate import Policy, VelocityCommand
from saranga.stack import HOLD, MAX_SPEED_M_S, Stack

TICK_US = 62_500


def at(range_m: float, azimuth_rad: float) -> Obstacle:
    return Obstacle(range_m, azimuth_rad, 0.0, range_m * cos(azimuth_rad), range_m * sin(azimuth_rad), 0.0, 0.9)


SCENES: dict[str, tuple[Obstacle, ...]] = {
    "nothing": (), "far": (at(1.5, 0.0),), "near": (at(0.4, 0.1),), "touching": (at(0.02, 0.0),),
    "at the sensor": (Obstacle(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.9),), "behind": (at(0.8, atan2(0.1, -1.0)),),
    "a wall": tuple(at(0.9, 0.05 * k) for k in range(-10, 11)),
    "hundreds": tuple(at(0.3 + 0.004 * k, 0.01 * k) for k in range(300)),
}


@pytest.fixture
def policy(policy_subject: Subject) -> Policy:
    return policy_subject.make()


@pytest.fixture
def geometry(policy_subject: Subject) -> SonarGeometry:
    return load_sonar(policy_subject.sonar)


def usable(command: Any) -> None:
    assert isinstance(command, VelocityCommand), f"a {type(command).__name__} came back, not a VelocityCommand"
    values = (command.vx_m_s, command.vy_m_s, command.vz_m_s, command.yaw_rate_rad_s)
    assert all(isfinite(v) for v in values), f"not finite: {command}"
    speed = sum(v * v for v in values[:3]) ** 0.5
    assert speed <= MAX_SPEED_M_S, f"{speed:.1f} m/s: the stack takes at most {MAX_SPEED_M_S:g}"


def test_it_is_a_policy(policy: Policy) -> None:
    assert isinstance(policy.name, str) and policy.name
    assert isinstance(policy, Policy)


@pytest.mark.parametrize("scene", SCENES)
def test_it_returns_a_usable_command(policy: Policy, scene: str) -> None:
    for tick in range(10):
        usable(policy.decide(list(SCENES[scene]), tick * TICK_US))


def test_it_survives_an_obstacle_that_is_not_a_number(policy: Policy) -> None:
    usable(policy.decide([Obstacle(nan, nan, nan, nan, nan, nan, nan)], 0))
    usable(policy.decide([at(1.0, 0.2)], TICK_US))


def test_it_survives_time_that_stands_still_or_leaps(policy: Policy) -> None:
    for t_us in (0, 0, TICK_US, 30_000_000, 30_000_000):
        usable(policy.decide([at(0.9, 0.1)], t_us))


def course(policy: Policy, scenes: Sequence[Sequence[Obstacle]]) -> list[VelocityCommand]:
    return [policy.decide(list(seen), tick * TICK_US) for tick, seen in enumerate(scenes)]


APPROACH = [(at(1.6 - 0.05 * k, 0.15), at(1.2, -0.6)) if k % 5 else () for k in range(24)]


def test_it_is_deterministic(policy_subject: Subject) -> None:
    one, two = policy_subject.make(), policy_subject.make()
    one.reset()
    two.reset()
    assert course(one, APPROACH) == course(two, APPROACH), "two of it differ on the same course"


def test_reset_forgets_everything(policy: Policy) -> None:
    policy.reset()
    first = course(policy, APPROACH)
    course(policy, [SCENES["a wall"]] * 10)
    policy.reset()
    assert course(policy, APPROACH) == first, "a course flown before shows in the next"


def test_it_leaves_its_input_alone(policy: Policy) -> None:
    for scene in SCENES.values():
        given = list(scene)
        before = copy.deepcopy(given)
        policy.decide(given, 0)
        assert given == before, "the list of obstacles was changed"


def test_without_echoes_it_commands_nothing(policy: Policy, geometry: SonarGeometry) -> None:
    """No data, no command: before the first echo, and when they stop."""
    if is_echo_policy(policy):
        command = policy.decide_echoes({role: EchoImage() for role in geometry.roles}, 0)  # type: ignore[attr-defined]
        assert command == HOLD, f"{command} from images in which nothing ever was"
    stack = Stack(load_denoiser("gaussian"), policy, geometry)
    for tick in range(8):
        assert stack.step([], tick * TICK_US).command == HOLD
    stack.step(echoes.pole_cycles(geometry, 4), 8 * TICK_US)
    for tick in range(14, 20):
        decision = stack.step([], tick * TICK_US)
        assert decision.command == HOLD and decision.fault is not None


def test_a_stack_with_it_flies_through_lost_cycles(policy: Policy, geometry: SonarGeometry) -> None:
    stack = Stack(load_denoiser("gaussian"), policy, geometry)
    cycles = echoes.pole_cycles(geometry, 64, lost=[k for k in range(64) if k % 4 == 1])
    for tick in range(26):
        now = tick * TICK_US
        decision = stack.step([c for c in cycles if now - TICK_US < c.t_us <= now], now)
        assert decision.fault is None, decision.fault
        usable(decision.command)


def test_it_leaves_the_images_alone(policy: Policy, geometry: SonarGeometry) -> None:
    if not is_echo_policy(policy):
        pytest.skip("it decides by obstacles, not by images")
    images = echoes.images(geometry, echoes.pole_cycles(geometry))
    before = {role: image.iq.copy() for role, image in images.items()}
    usable(policy.decide_echoes(images, 0))  # type: ignore[attr-defined]
    assert all(np.array_equal(image.iq, before[role]) for role, image in images.items()), "an image was changed"


def test_it_is_quick_enough(
    policy_subject: Subject, policy: Policy, geometry: SonarGeometry, report_latency: Callable[[str], None]
) -> None:
    """The whole tick with the cheapest denoiser: images, localisation and the policy."""
    stack = Stack(load_denoiser("gaussian"), policy, geometry)
    cycles = iter(echoes.pole_cycles(geometry, 200))
    ticks = iter(range(1000))

    def tick() -> None:
        decision = stack.step([next(cycles), next(cycles)], next(ticks) * TICK_US)
        assert decision.fault is None, decision.fault

    found = latency_check("one tick", tick, TICK_MS, "the next tick begins then")
    report_latency(latency_text(policy_subject.spec, found))
    assert found.verdict.accepted, found.why
