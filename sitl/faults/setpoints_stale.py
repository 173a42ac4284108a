"""A MAVLink router that is stuck: the autopilot gets the last setpoint again and again."""

from sitl.faults.base import PlantedFault

NAME = "setpoints_stale"
SUMMARY = "1: instead of new setpoints the last one is sent again and again"
UNIT = "(1 = stale)"
RANGE = (1.0, 1.0)


class SetpointsStale(PlantedFault):
    _last = b""

    def setpoints(self, data: bytes, begun: bool) -> bytes:
        if not data:
            return data
        if not begun:
            self._last = data
            return data
        return self._last


def build(value: float) -> PlantedFault:
    return SetpointsStale(value)
