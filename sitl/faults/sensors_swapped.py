"""The left and the right sensor plugged into each other's socket: every obstacle appears on the wrong side."""

from dataclasses import replace
from typing import TYPE_CHECKING

from saranga.errors import UsageError
from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "sensors_swapped"
SUMMARY = "1: the echoes of the left and the right sensor change places"
UNIT = "(1 = swapped)"
RANGE = (1.0, 1.0)


class SensorsSwapped(PlantedFault):
    def begin(self, world: "World") -> None:
        if not {"left", "right"} <= set(world.geometry.roles):
            raise UsageError(f"fault {NAME}: sonar {world.sonar!r} has only {', '.join(world.geometry.roles)}; choose "
                             "one with left and right by --sonar")
        world.rig.faults = replace(world.rig.faults, swapped=True)


def build(value: float) -> PlantedFault:
    return SensorsSwapped(value)
