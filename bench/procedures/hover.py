"""The hover point. The paper's thrust axis is ambiguous: 0.46 kgf is the whole vehicle, 0.115 kgf one of its motors,
and its rig had one motor. Both readings are always reported."""

from dataclasses import dataclass

import numpy as np

from bench.procedures.blocks import Estimate, mean_of_blocks
from bench.procedures.fits import interpolated_db
from bench.procedures.insertion_loss import Blocks

STANDARD_GRAVITY_M_S2 = 9.80665
READINGS_KGF = {"one_motor": 0.115, "whole_vehicle": 0.46}


def newton(kgf: float) -> float:
    """Kilogram-force as newton."""
    return kgf * STANDARD_GRAVITY_M_S2


@dataclass(frozen=True)
class HoverLevel:
    """Noise at one reading of the hover point: RMS / 20 000 with its interval, or why there is none."""

    thrust_kgf: float
    rms: float | None
    interval: list[float] | None
    why: str = ""


def hover_level(blocks: Blocks, thrust_kgf: float) -> HoverLevel:
    """Interpolated within each block, averaged in dB over blocks; never extrapolated."""
    at = np.array([newton(thrust_kgf)])
    values = [float(interpolated_db(p, at)[0]) for p in blocks.values()]
    finite = [v for v in values if np.isfinite(v)]
    if not finite:
        tops = [float(p.thrust_n[-1]) for p in blocks.values() if len(p)]
        lows = [float(p.thrust_n[0]) for p in blocks.values() if len(p)]
        span = f"{min(lows) / newton(1):.3f} to {max(tops) / newton(1):.3f} kgf" if tops else "nothing"
        return HoverLevel(thrust_kgf, None, None, f"the sweep covers {span}: {thrust_kgf:g} kgf lies outside")
    level: Estimate = mean_of_blocks(finite)
    interval = None if level.low is None or level.high is None else [10 ** (level.low / 20), 10 ** (level.high / 20)]
    return HoverLevel(thrust_kgf, float(10 ** (level.value / 20)), interval)
