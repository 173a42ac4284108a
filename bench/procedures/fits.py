"""Curves of noise against thrust: the paper's quadratic, and a power law that physics asks for.

The paper fits RMS / 20 000 by a quadratic in thrust (MATLAB's polyfit). Broadband propeller noise follows
p ~ T^1.25 (acoustics.md, "Propeller noise"), so a power law has two numbers instead of three and cannot turn down or go
negative at the ends. Which predicts better is measured: each block is predicted from the others.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Points:
    """Noise of one condition in one block: thrust in N and RMS / 20 000, both positive, sorted by thrust."""

    thrust_n: Floats
    rms: Floats

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, float]]) -> "Points":
        """From (thrust, rms) pairs in any order; those that are not finite and positive are left out."""
        good = sorted((t, r) for t, r in pairs if math.isfinite(t) and math.isfinite(r) and t > 0.0 and r > 0.0)
        table = np.asarray(good, dtype=np.float64).reshape(-1, 2)
        return cls(table[:, 0], table[:, 1])

    def __len__(self) -> int:
        return len(self.thrust_n)


def joined(blocks: Sequence[Points]) -> Points:
    """All blocks' points in one."""
    return Points.of([(float(t), float(r)) for b in blocks for t, r in zip(b.thrust_n, b.rms, strict=True)])


@dataclass(frozen=True)
class Fit:
    """A curve: `kind` "quadratic" (a2, a1, a0 as polyfit gives them) or "power_law" (scale, exponent), T in N."""

    kind: str
    coefficients: tuple[float, ...]

    def __call__(self, thrust_n: Floats | float) -> Floats:
        """RMS / 20 000 at a thrust."""
        thrust = np.asarray(thrust_n, dtype=np.float64)
        if self.kind == "quadratic":
            return np.asarray(np.polyval(self.coefficients, thrust), dtype=np.float64)
        scale, exponent = self.coefficients
        return np.asarray(scale * np.power(np.maximum(thrust, 1e-12), exponent), dtype=np.float64)


def fit_quadratic(points: Points) -> Fit:
    """As the paper: least squares of RMS on thrust.

    Raises:
        ValueError: fewer than three different thrusts.
    """
    if len(np.unique(points.thrust_n)) < 3:
        raise ValueError(f"{len(points)} points: a quadratic needs three different thrusts")
    return Fit("quadratic", tuple(np.polyfit(points.thrust_n, points.rms, 2).tolist()))


def fit_power_law(points: Points) -> Fit:
    """Least squares of log RMS on log thrust.

    Raises:
        ValueError: fewer than two different thrusts.
    """
    if len(np.unique(points.thrust_n)) < 2:
        raise ValueError(f"{len(points)} points: a power law needs two different thrusts")
    exponent, offset = np.polyfit(np.log(points.thrust_n), np.log(points.rms), 1).tolist()
    return Fit("power_law", (math.exp(offset), exponent))


FITS: dict[str, Callable[[Points], Fit]] = {"quadratic": fit_quadratic, "power_law": fit_power_law}


def residual_db(fit: Fit, points: Points) -> float:
    """RMS of the difference of curve and points, dB; infinite where the curve is not positive."""
    curve = fit(points.thrust_n)
    if len(points) == 0 or not (curve > 0.0).all():
        return math.inf
    return float(np.sqrt(np.mean((20.0 * np.log10(curve / points.rms)) ** 2)))


def prediction_error_db(kind: str, blocks: Sequence[Points]) -> float | None:
    """RMS error, dB, of each block predicted from the others; None with one block or too few points."""
    errors, weights = [], []
    for k, held in enumerate(blocks):
        others = joined([b for j, b in enumerate(blocks) if j != k])
        try:
            error = residual_db(FITS[kind](others), held)
        except ValueError:
            continue
        errors.append(error**2)
        weights.append(len(held))
    if not errors or sum(weights) == 0:
        return None
    return math.sqrt(float(np.average(errors, weights=weights)))


def interpolated_db(points: Points, thrust_n: Floats) -> Floats:
    """20 log10 RMS at thrusts, straight between neighbours in log thrust; NaN outside the points' range."""
    if len(points) < 2:
        return np.full(np.shape(thrust_n), np.nan)
    level = 20.0 * np.log10(points.rms)
    at = np.interp(np.log(thrust_n), np.log(points.thrust_n), level)
    inside = (thrust_n >= points.thrust_n[0] * (1 - 1e-9)) & (thrust_n <= points.thrust_n[-1] * (1 + 1e-9))
    return np.where(inside, at, np.nan)
