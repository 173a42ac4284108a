"""What two runs are compared by: figures of one flight, which way is worse, and how much of it matters."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Measure:
    """One figure of a flight.

    Attributes:
        name: key of the trial's result, or of its `measures`.
        sign: +1 where more is worse, -1 where less is.
        margin: the least worsening that matters, in `unit`; below it a difference that is certain is MARGINAL.
        clean_only: only flights that both runs flew clean have it.
        reason: why that margin.
    """

    name: str
    unit: str
    sign: int
    margin: float
    clean_only: bool
    reason: str


MEASURES = (
    Measure("min_clearance_m", "m", -1, 0.03, False, "a third of the airframe's half width; noise alone moves less"),
    Measure("duration_s", "s", +1, 0.5, True, "five percent of ten metres at 1 m/s"),
    Measure("path_excess", "1", +1, 0.02, True, "20 cm of detour on a ten metre course"),
    Measure("first_seen_m", "m", -1, 0.05, False, "50 ms less warning at 1 m/s"),
    Measure("dodge_from_m", "m", -1, 0.05, False, "50 ms later at 1 m/s"),
    Measure("echo_to_setpoint_ms", "ms", +1, 5.0, False, "a twelfth of the stack's tick of 62.5 ms"),
)
TESTS = len(MEASURES) + 1
"""Those and success: what the correction for many tests counts, whether or not each could be measured."""


def value_of(measure: Measure, result: Mapping[str, Any]) -> float:
    """The figure of one flight; NaN where it has none."""
    found = result.get(measure.name)
    if found is None:
        found = (result.get("measures") or {}).get(measure.name)
    return float(found) if isinstance(found, int | float) and not isinstance(found, bool) else math.nan
