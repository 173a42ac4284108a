"""Taking the motor-off background from a noise level (hardware.md, "Noise experiment").

15 dB or more above it: nothing is taken. 6 to 15 dB: powers are subtracted. Below 6 dB the difference is too
uncertain: the reading is an upper bound of the propeller's noise and is used as nothing else.
"""

import math
from dataclasses import dataclass

CLEAR_MARGIN_DB = 15.0
LEAST_MARGIN_DB = 6.0


@dataclass(frozen=True)
class Level:
    """A noise level with its background taken into account.

    Attributes:
        rms: of the propeller alone, unit of the input.
        margin_db: reading over background; infinite without background noise.
        treatment: "clear", "subtracted" or "upper_bound".
    """

    rms: float
    margin_db: float
    treatment: str

    @property
    def usable(self) -> bool:
        """False for an upper bound."""
        return self.treatment != "upper_bound"


def without_background(rms: float, background_rms: float) -> Level:
    """The level of the propeller alone.

    Raises:
        ValueError: a level that is negative or not finite.
    """
    if not (math.isfinite(rms) and math.isfinite(background_rms)) or rms < 0.0 or background_rms < 0.0:
        raise ValueError(f"levels {rms}, {background_rms}: must be finite and not negative")
    if rms == 0.0:
        return Level(0.0, -math.inf if background_rms else 0.0, "upper_bound")
    margin = 20.0 * math.log10(rms / background_rms) if background_rms > 0.0 else math.inf
    if margin >= CLEAR_MARGIN_DB:
        return Level(rms, margin, "clear")
    if margin >= LEAST_MARGIN_DB:
        return Level(math.sqrt(rms**2 - background_rms**2), margin, "subtracted")
    return Level(rms, margin, "upper_bound")
