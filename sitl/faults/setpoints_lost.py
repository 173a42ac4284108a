"""The MAVLink connection from the companion to the autopilot is gone."""

from sitl.faults.base import PlantedFault

NAME = "setpoints_lost"
SUMMARY = "1: nothing of the companion reaches the autopilot any more"
UNIT = "(1 = lost)"
RANGE = (1.0, 1.0)


class SetpointsLost(PlantedFault):
    def setpoints(self, data: bytes, begun: bool) -> bytes:
        return b"" if begun else data


def build(value: float) -> PlantedFault:
    return SetpointsLost(value)
