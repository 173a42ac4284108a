"""The rig's own clock jumps, as after a brown-out or a wrong resynchronisation; its cycles keep their rhythm."""

from dataclasses import replace
from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "rig_clock_jump_ms"
SUMMARY = "by how much the times that the rig writes into its frames jump"
UNIT = "ms"
RANGE = (-3_600_000.0, 3_600_000.0)


class RigClockJump(PlantedFault):
    def begin(self, world: "World") -> None:
        world.rig.faults = replace(world.rig.faults, clock_offset_us=round(self.value * 1000))


def build(value: float) -> PlantedFault:
    return RigClockJump(value)
