"""Gusts that were not in the forecast, on top of the scene's mean wind."""

from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "gust_m_s"
SUMMARY = "standard deviation of each horizontal component of the gusts, in place of the scene's"
UNIT = "m/s"
RANGE = (0.0, 15.0)


class Gusts(PlantedFault):
    def begin(self, world: "World") -> None:
        world.physics.set_gusts(self.value)


def build(value: float) -> PlantedFault:
    return Gusts(value)
