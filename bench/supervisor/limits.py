"""What a run may not exceed, and how a reading is held to it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from bench.thrust_stand.protocol import StandReading
from saranga.errors import UsageError
from saranga.plugins import nearest_hint

# limit -> (quantity of StandReading, unit, what is compared)
QUANTITIES = {
    "thrust_n": ("thrust_n", "N", "size"),
    "current_a": ("current_a", "A", "size"),
    "voltage_low_v": ("voltage_v", "V", "below"),
    "rpm": ("rpm", "1/min", "size"),
    "esc_temperature_c": ("esc_temperature_c", "C", "above"),
    "motor_temperature_c": ("motor_temperature_c", "C", "above"),
    "vibration_m_s2": ("vibration_m_s2", "m/s^2", "size"),
}


@dataclass(frozen=True)
class Limits:
    """Limits of one run; None: none set. `size` of thrust, current, rpm and vibration counts: a reversed propeller
    or a stand with the wrong sign trips as well. `voltage_low_v` is the only lower one; it counts while spinning.

    `throttle` caps what may be asked for (0..1), `slew_per_s` how fast throttle rises and falls in normal running.
    """

    thrust_n: float | None = None
    current_a: float | None = None
    voltage_low_v: float | None = None
    rpm: float | None = None
    esc_temperature_c: float | None = None
    motor_temperature_c: float | None = None
    vibration_m_s2: float | None = None
    throttle: float = 1.0
    slew_per_s: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value <= 0:
                raise UsageError(f"limit {field.name} = {value!r}: must be a positive finite number; leave it out for "
                                 "no limit")
        if self.throttle > 1:
            raise UsageError(f"limit throttle = {self.throttle:g}: at most 1")

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> "Limits":
        """From a plan's [limits] table.

        Raises:
            UsageError: an unknown name or a value that cannot be a limit.
        """
        known = [f.name for f in fields(cls)]
        for name in table:
            if name not in known:
                raise UsageError(f"limits: unknown {name!r}{nearest_hint(name, known)}: known are {', '.join(known)}")
        return cls(**table)

    def watched(self) -> dict[str, str]:
        """Limit -> quantity that has to be measured for it."""
        return {name: QUANTITIES[name][0] for name in QUANTITIES if getattr(self, name) is not None}


def quantity_of(limit: str, reading: StandReading) -> float:
    """The measured value that a limit is about."""
    return float(getattr(reading, QUANTITIES[limit][0]))


def exceeded(limits: Limits, limit: str, value: float) -> str | None:
    """Why `value` breaks the limit, or None. NaN breaks none here: silence is judged by its age."""
    bound = getattr(limits, limit)
    quantity, unit, how = QUANTITIES[limit]
    if bound is None or math.isnan(value):
        return None
    if how == "below":
        return f"{quantity} {value:.4g} {unit} is below {bound:g} {unit}" if value < bound else None
    size = abs(value) if how == "size" else value
    return f"{quantity} {value:.4g} {unit} is beyond {bound:g} {unit}" if size > bound else None
