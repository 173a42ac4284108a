"""The acoustic shield comes off: the sensors hear the propellers bare."""

from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "shield_lost"
SUMMARY = "1: the shield is gone"
UNIT = "(1 = gone)"
RANGE = (1.0, 1.0)


class ShieldLost(PlantedFault):
    def begin(self, world: "World") -> None:
        world.change_shield("none")


def build(value: float) -> PlantedFault:
    return ShieldLost(value)
