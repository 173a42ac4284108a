"""The downward range finder falls silent: height comes from the barometer, flow loses its scale."""

from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "range_lost"
SUMMARY = "1: no downward range finder any more"
UNIT = "(1 = lost)"
RANGE = (1.0, 1.0)


class RangeLost(PlantedFault):
    def begin(self, world: "World") -> None:
        world.sensors.range_enabled = False


def build(value: float) -> PlantedFault:
    return RangeLost(value)
