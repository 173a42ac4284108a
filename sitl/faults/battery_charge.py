"""An empty battery: its charge, and with it voltage and thrust, are suddenly those of a used pack."""

from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "battery_charge"
SUMMARY = "charge of the battery from then on (1 is full)"
UNIT = "(of full)"
RANGE = (0.0, 1.0)


class BatteryCharge(PlantedFault):
    def begin(self, world: "World") -> None:
        from sitl import rigid_body

        world.physics.state.flat[rigid_body.CHARGE] = self.value


def build(value: float) -> PlantedFault:
    return BatteryCharge(value)
