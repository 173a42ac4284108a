"""A worn motor or a chipped propeller: the front right one gives less thrust than asked."""

from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "motor_thrust"
SUMMARY = "thrust of the front right motor over what it should be"
UNIT = "(of nominal)"
RANGE = (0.0, 1.0)


class MotorThrust(PlantedFault):
    def begin(self, world: "World") -> None:
        world.physics.motor_scale[0] = self.value


def build(value: float) -> PlantedFault:
    return MotorThrust(value)
