"""No avoidance: straight ahead. The control of every comparison."""

from collections.abc import Sequence
from math import isfinite

from saranga.localise import Obstacle
from saranga.navigate.base import Policy, VelocityCommand

NAME = "none"


class StraightAhead:
    """Commands the desired speed whatever is in the way."""

    name = NAME

    def __init__(self, desired_speed_m_s: float) -> None:
        self.command = VelocityCommand(desired_speed_m_s, 0.0, 0.0)

    def reset(self) -> None:
        """Nothing is remembered."""

    def decide(self, obstacles: Sequence[Obstacle], t_us: int) -> VelocityCommand:
        """The same command always."""
        return self.command


def build(desired_speed_m_s: float = 1.0) -> Policy:
    """Straight ahead at `desired_speed_m_s`.

    Raises:
        ValueError: a speed that is not finite.
    """
    if not isfinite(desired_speed_m_s):
        raise ValueError(f"desired_speed_m_s is {desired_speed_m_s}; give a finite speed in m/s")
    return StraightAhead(desired_speed_m_s)
