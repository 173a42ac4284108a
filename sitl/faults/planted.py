"""The faults of one flight: each begins when its moment of the course has come."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sitl.faults import Planting, build_fault

if TYPE_CHECKING:
    from sitl.world import World


class PlantedFaults:
    """Built with the world; `step` at the stack's tick, `setpoints` and `clock_us` on what passes by."""

    def __init__(self, plantings: Sequence[Planting]) -> None:
        self._waiting = [(planting, build_fault(planting)) for planting in plantings]
        self._all = [fault for _, fault in self._waiting]
        self._begun: set[int] = set()

    def step(self, world: "World", course_s: float) -> None:
        """Begin what is due `course_s` seconds into the course."""
        for planting, fault in self._waiting:
            if course_s >= planting.at_s and id(fault) not in self._begun:
                self._begun.add(id(fault))
                fault.begin(world)

    def setpoints(self, data: bytes) -> bytes:
        """The companion's bytes as they reach the autopilot."""
        for fault in self._all:
            data = fault.setpoints(data, id(fault) in self._begun)
        return data

    def clock_us(self, t_us: int) -> int:
        """The companion's clock at simulated time `t_us`."""
        return t_us + sum(fault.clock_offset_us() for fault in self._all if id(fault) in self._begun)
