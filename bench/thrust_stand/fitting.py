"""From real static sweeps to the parameters of an emulated motor and propeller.

What is fitted is in the formulas of `plant.py`; ESTIMATES are typical figures of 5-inch propellers on 22 mm motors,
which no static sweep without torque and vibration can tell. A sweep with torque replaces the figure of merit.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls

from bench.thrust_stand.formats import read_sweep
from bench.thrust_stand.sweep_table import fit_thrust
from saranga.errors import UsageError

PULSE_IDLE_S, PULSE_SPAN_S = 1e-3, 1e-3
SLOWEST_RPM = 2_500.0
LIMIT_SHARE = 0.93
LIMIT_DROP_V = 0.1
UNSEEN_LIMIT = 3.0
AIR_KG_M3 = 1.204
FIGURE_OF_MERIT = 0.60
ESTIMATES: dict[str, dict[str, float]] = {
    "motor": {"start_throttle": 0.03, "poles": 14, "rotor_inertia_kg_m2": 4.5e-6, "spin_up_s": 0.06,
              "spin_down_s": 0.15},
    "heat": {"motor_j_k": 22.0, "motor_still_w_k": 0.12, "motor_w_k_per_10000_rpm": 0.30, "esc_j_k": 9.0,
             "esc_w_k": 0.16, "esc_resistance_ohm": 0.02, "esc_share": 0.02},
    "vibration": {"floor_m_s2": 2.0, "m_s2_per_10000_rpm_squared": 2.5},
}
Array = NDArray[np.float64]


def fit_plant(files: list[Path], name: str, description: str, licence: str, diameter_m: float,
              blades: int) -> dict[str, Any]:
    """Tables of a plant file from sweeps of one motor and propeller, at one or more supply voltages.

    The supply is that of the sweep with the highest voltage; where no row shows its current limit, it is taken as three
    times the largest current.

    Raises:
        UsageError: a file that is no sweep, lacks a quantity, or too few rows that turn.
    """
    sweeps = [_needed(path) for path in files]
    columns = {key: np.concatenate([sweep[key] for sweep in sweeps]) for key in sweeps[0]}
    limited = np.concatenate([_limited(sweep) for sweep in sweeps])
    most_a = float(columns["current_a"].max())
    limit_a = float(np.median(columns["current_a"][limited])) if limited.any() else UNSEEN_LIMIT * most_a
    turning = columns["rpm"] > SLOWEST_RPM
    use = turning & ~limited
    if use.sum() < 6:
        raise UsageError(f"{', '.join(map(str, files))}: {int(use.sum())} rows above {SLOWEST_RPM:g} rpm: at least 6 "
                         "are needed for a fit")
    rpm, volts = columns["rpm"][use], columns["voltage_v"][use]
    throttle = columns["throttle"][use]
    curve, droop, rotation_rms = _fit_rotation(throttle, volts, rpm)
    watts, power_rms = _fit_power(columns["rpm"][turning], (columns["voltage_v"] * columns["current_a"])[turning])
    thrust = fit_thrust(np.abs(columns["thrust_n"][turning]), columns["rpm"][turning])
    open_v, ohm = _supply(max(sweeps, key=lambda s: float(s["voltage_v"].max())))
    resting = columns["rpm"] <= 1.0
    idle_w = float((columns["voltage_v"] * columns["current_a"])[resting].min()) if resting.any() else float(watts[0])
    return {
        "source": {"name": name, "description": description, "files": [path.name for path in files],
                   "licence": licence, "rotation_rms": rotation_rms, "thrust_rms_of_max": thrust.residual_of_max,
                   "power_rms": power_rms},
        "propeller": {"diameter_m": diameter_m, "blades": blades, "thrust_n_per_rpm2": thrust.k,
                      "torque_n_m_per_rpm2": _torque(columns, turning, thrust.k, diameter_m)},
        "motor": {"rpm_per_v": [float(c) for c in curve], "droop_per_rpm": droop, **ESTIMATES["motor"]},
        "power": {"w": [float(w) for w in watts], "idle_w": idle_w},
        "supply": {"voltage_v": open_v, "resistance_ohm": ohm, "current_limit_a": limit_a},
        "heat": ESTIMATES["heat"],
        "vibration": ESTIMATES["vibration"],
    }


def _needed(path: Path) -> dict[str, Array]:
    table = read_sweep(path)
    quantities = table.quantities
    for name in ("esc_s", "rpm", "voltage_v", "current_a"):
        if name not in quantities:
            raise UsageError(f"{path}: has no {name}: a fit needs ESC signal, rotation speed, voltage and current")
    picked = {key: quantities[key] for key in ("thrust_n", "rpm", "voltage_v", "current_a")}
    picked["throttle"] = (quantities["esc_s"] - PULSE_IDLE_S) / PULSE_SPAN_S
    picked["torque_n_m"] = quantities.get("torque_n_m", np.full(table.rows, np.nan))
    whole = np.logical_and.reduce([np.isfinite(v) for k, v in picked.items() if k != "torque_n_m"])
    return {key: values[whole] for key, values in picked.items()}


def _fit_rotation(throttle: Array, volts: Array, rpm: Array) -> tuple[Array, float, float]:
    """f(u) (cubic) and b of V f(u) = n + b n^2, with relative weights; RMS relative error of n."""
    terms = np.stack([volts * throttle**k for k in range(4)] + [-((rpm / 1e4) ** 2)], axis=1) / rpm[:, None]
    solution = lsq_linear(terms, np.ones_like(rpm), ([-np.inf] * 4 + [0.0], np.inf)).x
    curve, droop = solution[:4], float(solution[4]) * 1e-8
    drive = volts * np.polynomial.polynomial.polyval(throttle, curve)
    model = drive if droop == 0.0 else (np.sqrt(1.0 + 4.0 * droop * drive) - 1.0) / (2.0 * droop)
    return curve, droop, float(np.sqrt(np.mean((model / rpm - 1.0) ** 2)))


def _fit_power(rpm: Array, power: Array) -> tuple[Array, float]:
    terms = np.stack([(rpm / 1e4) ** k for k in range(5)], axis=1) / power[:, None]
    solution, _ = nnls(terms, np.ones_like(power))
    return solution, float(np.sqrt(np.mean((terms @ solution - 1.0) ** 2)))


def _supply(sweep: dict[str, Array]) -> tuple[float, float]:
    """Open-circuit voltage and resistance, from the rows that its current limit has not touched."""
    free = sweep["current_a"] <= LIMIT_SHARE * sweep["current_a"].max()
    slope, open_v = np.polyfit(sweep["current_a"][free], sweep["voltage_v"][free], 1)
    return float(open_v), max(-float(slope), 1e-3)


def _limited(sweep: dict[str, Array]) -> NDArray[np.bool_]:
    """Rows where the supply's current limit has pulled its voltage down."""
    open_v, ohm = _supply(sweep)
    return sweep["voltage_v"] < open_v - ohm * sweep["current_a"] - LIMIT_DROP_V


def _torque(columns: dict[str, Array], turning: NDArray[np.bool_], k: float, diameter_m: float) -> float:
    """Torque over rpm^2: measured where the sweep has it, else from ideal power over a figure of merit."""
    torque, rpm = np.abs(columns["torque_n_m"][turning]), columns["rpm"][turning]
    known = np.isfinite(torque)
    if known.sum() >= 2:
        return fit_thrust(torque[known], rpm[known]).k
    disc_m2 = math.pi * diameter_m**2 / 4.0
    return k**1.5 / math.sqrt(2.0 * AIR_KG_M3 * disc_m2) / FIGURE_OF_MERIT * 60.0 / (2.0 * math.pi)


def plant_text(tables: dict[str, Any]) -> str:
    """The tables as TOML, with five figures and what is estimated said to be so."""
    estimated = {("propeller", "diameter_m"): "given", ("propeller", "blades"): "assumed",
                 ("propeller", "torque_n_m_per_rpm2"): f"ideal power over a figure of merit of {FIGURE_OF_MERIT:g}, "
                 "unless the sweep has torque"}
    lines = ["# An emulated motor and propeller, fitted to real static sweeps (bench/thrust_stand/fitting.py).",
             '# "estimate": typical figures, which a static sweep cannot tell.']
    for table, entries in tables.items():
        lines += ["", f"[{table}]"]
        for key, value in entries.items():
            remark = estimated.get((table, key)) or ("estimate" if key in ESTIMATES.get(table, {}) else "")
            lines.append(f"{key} = {_toml(value)}" + (f"  # {remark}" if remark else ""))
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, int):
        return str(value)
    text = f"{value:.5g}"
    return text if any(mark in text for mark in ".en") else text + ".0"
