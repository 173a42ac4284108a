"""What a navigation policy is, and what it commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from saranga.echo import EchoImage
from saranga.localise import Obstacle


@dataclass(frozen=True)
class VelocityCommand:
    """Velocity asked of the autopilot, body FRD: x forward, y right, z down."""

    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    yaw_rate_rad_s: float = 0.0


@runtime_checkable
class Policy(Protocol):
    """Obstacles and the time in, a velocity out; whatever else it knows it has remembered itself."""

    name: str

    def reset(self) -> None:
        """Forget everything: a new flight starts."""
        ...

    def decide(self, obstacles: Sequence[Obstacle], t_us: int) -> VelocityCommand:
        """Velocity to command at `t_us` (microseconds, never falling) given the obstacles seen now."""
        ...


@runtime_checkable
class EchoPolicy(Policy, Protocol):
    """A policy that reads the echoes themselves: the stack then runs neither denoiser nor localisation."""

    def decide_echoes(self, images: Mapping[str, EchoImage], t_us: int) -> VelocityCommand:
        """Velocity to command at `t_us` given the echo images by sensor role."""
        ...
