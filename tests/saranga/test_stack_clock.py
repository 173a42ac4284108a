"""A clock that is set back in flight: silence is still noticed, and the policy's time never falls."""

import numpy as np

from saranga.denoise import load_denoiser
from saranga.echo import EchoCycle, EchoFrame
from saranga.navigate import VelocityCommand
from saranga.sonar_geometry import load_sonar
from saranga.stack import TICK_US, Stack

HOUR_US = 3_600_000_000


class Listener:
    """Notes what time it is told."""

    name = "listener"

    def __init__(self) -> None:
        self.told_us: list[int] = []

    def reset(self) -> None:
        self.told_us.clear()

    def decide(self, obstacles: object, t_us: int) -> VelocityCommand:
        self.told_us.append(t_us)
        return VelocityCommand(1.0, 0.0, 0.0)


def cycle(number: int) -> list[EchoCycle]:
    sonar = load_sonar("pair")
    iq = np.random.default_rng(number).normal(0.0, 300.0, (sonar.samples, 2)).astype(np.int16)
    frames = {role: EchoFrame(role, k, number, number, number * TICK_US, sonar.fop_hz, sonar.odr, 0, iq)
              for k, role in enumerate(sonar.roles)}
    return [EchoCycle(number, number * TICK_US, frames)]


def test_a_clock_set_back_by_an_hour() -> None:
    policy = Listener()
    stack = Stack(load_denoiser("gaussian"), policy, load_sonar("pair"))
    now_us = 2 * HOUR_US
    for k in range(5):
        assert stack.step(cycle(k), now_us + k * TICK_US).fault is None
    back_us = now_us + 5 * TICK_US - HOUR_US
    for k in range(5):
        decision = stack.step(cycle(5 + k), back_us + k * TICK_US)
        assert decision.fault is None and decision.t_us == back_us + k * TICK_US
    assert np.diff(policy.told_us).tolist() == [TICK_US] * 9
    silent = [stack.step([], back_us + k * TICK_US).fault for k in range(5, 12)]
    assert silent[0] is None and silent[-1] is not None and "echo source silent" in silent[-1]


def test_set_back_again_and_again_and_after_a_reset() -> None:
    policy = Listener()
    stack = Stack(load_denoiser("gaussian"), policy, load_sonar("pair"))
    for k, t_us in enumerate((1_000_000, 500_000, 0, 0, 62_500)):
        stack.step(cycle(k), t_us)
    assert policy.told_us == [1_000_000, 1_062_500, 1_125_000, 1_125_000, 1_187_500]
    stack.reset()
    stack.step(cycle(9), 7)
    assert policy.told_us == [7]
