"""Echo cycles that arrive late: the rig or its host queues them."""

from dataclasses import replace
from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "cycles_late_ms"
SUMMARY = "by how much every echo cycle is late"
UNIT = "ms"
RANGE = (0.0, 5000.0)


class CyclesLate(PlantedFault):
    def begin(self, world: "World") -> None:
        world.rig.faults = replace(world.rig.faults, delay_us=round(self.value * 1000))


def build(value: float) -> PlantedFault:
    return CyclesLate(value)
