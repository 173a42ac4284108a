"""The companion's clock jumps, as when a time server sets it in flight."""

from sitl.faults.base import PlantedFault

NAME = "stack_clock_jump_ms"
SUMMARY = "by how much the companion's clock jumps"
UNIT = "ms"
RANGE = (-3_600_000.0, 3_600_000.0)
INSIDE_STACK = True


class StackClockJump(PlantedFault):
    def clock_offset_us(self) -> int:
        return round(self.value * 1000)


def build(value: float) -> PlantedFault:
    return StackClockJump(value)
