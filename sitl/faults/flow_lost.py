"""The optical-flow sensor falls silent: the autopilot has no horizontal velocity any more."""

from typing import TYPE_CHECKING

from sitl.faults.base import PlantedFault

if TYPE_CHECKING:
    from sitl.world import World

NAME = "flow_lost"
SUMMARY = "1: no optical flow any more"
UNIT = "(1 = lost)"
RANGE = (1.0, 1.0)


class FlowLost(PlantedFault):
    def begin(self, world: "World") -> None:
        world.sensors.flow_enabled = False


def build(value: float) -> PlantedFault:
    return FlowLost(value)
