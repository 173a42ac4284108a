"""Faults to plant in a flight, one file each, found by name: `fly --fault NAME=VALUE[@SECONDS]`.

A module declares NAME, SUMMARY (one line), UNIT, RANGE (least and largest value) and `build(value)`, which makes a
`PlantedFault`; INSIDE_STACK = True where it acts inside the companion, which lockstep alone can reach. SECONDS counts
from the start of the course (0 when left out), so that a fault means the same on every autopilot.
"""

import math
import sys
from dataclasses import dataclass
from types import ModuleType

from saranga.errors import UsageError
from saranga.plugins import plugins
from sitl.faults.base import PlantedFault

__all__ = ["PlantedFault", "Planting", "build_fault", "fault_modules", "parse_planting"]


@dataclass(frozen=True)
class Planting:
    """Fault `name` with `value`, from `at_s` simulated seconds after the course began."""

    name: str
    value: float
    at_s: float = 0.0

    @property
    def text(self) -> str:
        """VALUE[@SECONDS], as `parse_planting` reads it."""
        return f"{self.value:g}" + (f"@{self.at_s:g}" if self.at_s else "")


def fault_modules() -> dict[str, ModuleType]:
    """Every fault's module by its name."""
    return plugins(sys.modules[__name__])


def parse_planting(name: str, text: str) -> Planting:
    """Read VALUE[@SECONDS] of a fault that is known.

    Raises:
        UsageError: not a number, or outside the fault's range.
    """
    module = fault_modules()[name]
    value_text, at, at_text = text.partition("@")
    value = _number(name, value_text, "its value")
    at_s = _number(name, at_text, "the time after @") if at else 0.0
    low, high = module.RANGE
    if not low <= value <= high:
        raise UsageError(f"fault {name}={value_text}: must be within {low:g} .. {high:g} {module.UNIT} "
                         f"({module.SUMMARY})")
    if at_s < 0:
        raise UsageError(f"fault {name}={text}: the time after @ counts from the start of the course, so not negative")
    return Planting(name, value, at_s)


def build_fault(planting: Planting) -> PlantedFault:
    """The fault itself."""
    fault: PlantedFault = fault_modules()[planting.name].build(planting.value)
    return fault


def _number(name: str, text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise UsageError(f"fault {name}: {what} {text!r} must be a number; write {name}=VALUE or "
                         f"{name}=VALUE@SECONDS") from None
    if not math.isfinite(value):
        raise UsageError(f"fault {name}: {what} {text!r} must be finite")
    return value
