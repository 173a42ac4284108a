"""Whole echo cycles that never arrive: a host too slow for its USB port, a cable that comes loose."""

from dataclasses import replace
from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "cycles_dropped"
SUMMARY = "probability that an echo cycle of all sensors is lost"
UNIT = "(probability)"
RANGE = (0.0, 1.0)


class CyclesDropped(PlantedFault):
    def begin(self, world: "World") -> None:
        world.rig.faults = replace(world.rig.faults, cycle_drop_probability=self.value)


def build(value: float) -> PlantedFault:
    return CyclesDropped(value)
