"""What a planted fault may do to a simulated world; every hook does nothing unless a fault overrides it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sitl.world import World


@dataclass
class PlantedFault:
    """One thing that is wrong from a moment of the course on. `value` is in the unit its module states."""

    value: float

    def begin(self, world: "World") -> None:
        """The moment has come; called once."""

    def setpoints(self, data: bytes, begun: bool) -> bytes:
        """The companion's MAVLink bytes of one physics tick on their way to the autopilot; also called before."""
        return data

    def clock_offset_us(self) -> int:
        """By how much the companion's clock is wrong once the fault has begun."""
        return 0
