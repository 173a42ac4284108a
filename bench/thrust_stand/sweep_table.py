"""A static sweep read from a file: columns in SI, what the file called them, and the fit T = k rpm^2."""

from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.thrust_stand.protocol import StandReading

READING_FIELDS = tuple(StandReading.__dataclass_fields__)


@dataclass(frozen=True)
class Column:
    """One column: `name` and `unit` as the file has them, `quantity` as we call it ("" where nothing uses it)."""

    name: str
    unit: str
    quantity: str
    si_unit: str
    values: NDArray[np.float64] = field(repr=False)


@dataclass(frozen=True)
class ThrustFit:
    """T = k rpm^2, least squares on |T| through zero. Residuals as a share of the largest |T|: RMS and the largest."""

    k: float
    residual_of_max: float
    largest_of_max: float
    rows: int


@dataclass(frozen=True)
class SweepTable:
    """Rows of a file. `quantities` has SI arrays by the names of StandReading, and esc_s, power_w, time_s."""

    path: Path
    format: str
    columns: tuple[Column, ...]
    quantities: dict[str, NDArray[np.float64]]
    notes: tuple[str, ...]

    @property
    def rows(self) -> int:
        return len(self.quantities["thrust_n"])

    @property
    def thrust_sign(self) -> int:
        """+1, or -1 where the largest thrust in the file is negative (load cell or propeller the other way round)."""
        thrust = self.quantities["thrust_n"]
        finite = thrust[np.isfinite(thrust)]
        return -1 if finite.size and finite[np.argmax(np.abs(finite))] < 0.0 else 1

    def fit(self) -> ThrustFit | str:
        """The fit, or why there is none. Rows with rpm 0 carry thrust that no speed was measured for: left out."""
        if "rpm" not in self.quantities:
            return "no column of rotation speed"
        thrust, rpm = np.abs(self.quantities["thrust_n"]), self.quantities["rpm"]
        use = np.isfinite(thrust) & (rpm > 0.0)
        if use.sum() < 2:
            return f"{int(use.sum())} rows with thrust and a rotation speed above 0: at least 2 are needed"
        return fit_thrust(thrust[use], rpm[use])

    def json(self) -> dict[str, Any]:
        """The contract of `stand import`: rows, columns, thrust_n, rpm, thrust_fit; blank cells are null."""
        fit = self.fit()
        return {
            "file": str(self.path), "format": self.format, "origin": "recorded", "rows": self.rows,
            "columns": [{"name": c.name, "unit": c.unit, "quantity": c.quantity or None, "si_unit": c.si_unit or None}
                        for c in self.columns],
            "thrust_n": _plain(self.quantities["thrust_n"]),
            "rpm": _plain(self.quantities.get("rpm", np.full(self.rows, np.nan))),
            "quantities": {name: _plain(values) for name, values in self.quantities.items()},
            "thrust_sign": self.thrust_sign,
            "thrust_fit": fit_json(fit),
            "notes": list(self.notes),
        }


def fit_thrust(thrust_n: NDArray[np.float64], rpm: NDArray[np.float64]) -> ThrustFit:
    """k and residuals of T = k rpm^2 (both finite, T not negative, rpm above 0)."""
    square = rpm**2
    k = float((thrust_n * square).sum() / (square**2).sum())
    residual = thrust_n - k * square
    most = float(thrust_n.max())
    share = 1.0 / most if most > 0.0 else float("nan")
    return ThrustFit(k, float(np.sqrt((residual**2).mean())) * share, float(np.abs(residual).max()) * share,
                     len(thrust_n))


def fit_json(fit: ThrustFit | str) -> dict[str, Any]:
    if isinstance(fit, str):
        return {"k": None, "residual_of_max": None, "largest_residual_of_max": None, "rows": 0, "why": fit}
    return {"k": fit.k, "residual_of_max": _number(fit.residual_of_max),
            "largest_residual_of_max": _number(fit.largest_of_max), "rows": fit.rows}


def _plain(values: NDArray[np.float64]) -> list[float | None]:
    return [_number(float(v)) for v in values]


def _number(value: float) -> float | None:
    return value if isfinite(value) else None
