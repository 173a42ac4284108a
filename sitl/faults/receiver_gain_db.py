"""A receiver with too much gain: strong echoes and noise are cut off at the converter's limit."""

from dataclasses import replace
from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "receiver_gain_db"
SUMMARY = "gain of every receiver over what it should be; what passes the converter's limit is cut off"
UNIT = "dB"
RANGE = (-60.0, 80.0)


class ReceiverGain(PlantedFault):
    def begin(self, world: "World") -> None:
        world.rig.faults = replace(world.rig.faults, gain_db=self.value)


def build(value: float) -> PlantedFault:
    return ReceiverGain(value)
