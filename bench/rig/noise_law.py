"""How loud one propeller is in a sensor of the bench: what an emulated sweep is given, and has to find again."""

import math
from dataclasses import dataclass, field

from saranga.errors import UsageError
from saranga.fixtures import fixture_names
from sitl.acoustics.atmosphere import StandardAir, atmosphere
from sitl.acoustics.rotor_noise import THRUST_EXPONENT, anchor_rms_counts, anchor_thrust_n
from sitl.acoustics.shield import load_shield

HUB_DISTANCE_M = 0.12
"""Hub to sensor on the emulated bench, the hub behind the sensor and 20 mm above it."""
HUB_ABOVE_M = 0.02
COUNTS_AT_1M = 12_000.0
"""Of the shipped sonars (fixtures/sonars/pair.toml)."""
FOP_HZ = 53_000.0


@dataclass(frozen=True)
class NoiseLaw:
    """RMS |IQ| of one propeller in counts: `rms = hover_rms_counts (T / hover_thrust_n)^exponent`, less the shield.

    Attributes:
        hover_rms_counts: without a shield, at `hover_thrust_n` of one motor.
        insertion_loss_db: by shield name; `loss_slope_db_per_n` is added for each newton above hover.
        mounting_sd_db: how much each mounting of a shield differs from the last.
    """

    hover_rms_counts: float = anchor_rms_counts(COUNTS_AT_1M) / 2.0
    hover_thrust_n: float = anchor_thrust_n()
    exponent: float = THRUST_EXPONENT
    insertion_loss_db: dict[str, float] = field(default_factory=lambda: {"none": 0.0})
    loss_slope_db_per_n: float = 0.0
    mounting_sd_db: float = 0.0

    def noise_rms_counts(self, thrust_n: float, shield: str) -> float:
        """Counts at the sensor; 0 where the thrust is not positive.

        Raises:
            UsageError: a shield that the law was not given.
        """
        if not thrust_n > 0.0:
            return 0.0
        if shield not in self.insertion_loss_db:
            raise UsageError(f"emulated rig: shield {shield!r} is not one it was given: "
                             f"{', '.join(self.insertion_loss_db)}; name it with --shield")
        loss = self.insertion_loss_db[shield]
        if loss != 0.0:
            loss += self.loss_slope_db_per_n * (thrust_n - self.hover_thrust_n)
        return self.hover_rms_counts * (thrust_n / self.hover_thrust_n) ** self.exponent * 10.0 ** (-loss / 20.0)


def shield_loss_db(name: str) -> float:
    """What the diffraction law gives a shipped shield on the emulated bench, dB.

    Raises:
        UsageError: no such shield.
    """
    air = atmosphere(FOP_HZ, StandardAir())
    behind = math.sqrt(HUB_DISTANCE_M**2 - HUB_ABOVE_M**2)
    return load_shield(name).insertion_loss_db((-behind, 0.0, -HUB_ABOVE_M), (0.0, 0.0, 0.0), FOP_HZ, air.c_m_s,
                                               air.impedance_pa_s_m)


def parse_shields(texts: list[str]) -> dict[str, float]:
    """Insertion losses from `NAME` (a shipped shield) or `NAME=dB`; "none" and all shipped shields are always there.

    Raises:
        UsageError: an unknown shield, or a loss outside -10..60 dB.
    """
    losses = {name: shield_loss_db(name) for name in fixture_names("shields") if _is_panel(name)}
    losses["none"] = 0.0
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            losses[name] = losses[name] if name in losses else shield_loss_db(name)
            continue
        try:
            loss = float(value)
        except ValueError:
            loss = math.nan
        if not name or not -10.0 <= loss <= 60.0:
            raise UsageError(f"--shield {text!r}: expected NAME or NAME=dB with dB in -10..60")
        losses[name] = loss
    return losses


def _is_panel(name: str) -> bool:
    try:
        load_shield(name)
    except UsageError:
        return False
    return True
