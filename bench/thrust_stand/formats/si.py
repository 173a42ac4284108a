"""Our own tables: quantity and SI unit in the name, as `stand import --out` and a sweep's stand.csv have them."""

from math import isfinite, nan
from pathlib import Path

import numpy as np

from bench.thrust_stand.csv_cells import Row, number
from bench.thrust_stand.sweep_table import READING_FIELDS, Column, SweepTable
from saranga.errors import UsageError

NAME = "si"
LOOKS = "a header such as time_s,thrust_n,rpm,voltage_v,current_a"
EXTRA = ("esc_s", "power_w", "mechanical_power_w")
SI_UNITS = {"time_s": "s", "thrust_n": "N", "torque_n_m": "N·m", "rpm": "rpm", "voltage_v": "V", "current_a": "A",
            "esc_temperature_c": "°C", "motor_temperature_c": "°C", "vibration_m_s2": "m/s²", "throttle": "1",
            "token": "1", "esc_s": "s", "power_w": "W", "mechanical_power_w": "W"}


def recognises(cells: list[str]) -> bool:
    return {"time_s", "thrust_n"} <= set(cells)


def build(thrust_sign: int = 1) -> object:
    """A reader of such files. `thrust_sign`: -1 turns all thrusts round [1]."""
    if thrust_sign not in (1, -1):
        raise ValueError(f"thrust_sign is {thrust_sign!r}: it must be 1 or -1")

    def read(path: Path, rows: list[Row], header_at: int, separator: str) -> SweepTable:
        header, body = rows[header_at], rows[header_at + 1:]
        if not body:
            raise UsageError(f"{path}: a header in line {header.line} and no rows: the sweep is empty")
        twice = {name for name in header.cells if name and header.cells.count(name) > 1}
        if twice:
            raise UsageError(f"{path}:{header.line}: column {min(twice)!r} is there twice: remove one")
        known = {*READING_FIELDS, *EXTRA}
        columns, found = [], {}
        for k, name in enumerate(header.cells):
            if name not in known:
                continue
            values = np.array([_cell(path, row, k, name) for row in body])
            columns.append(Column(name, SI_UNITS[name], name, SI_UNITS[name], values))
            if name == "thrust_n":
                values = values * thrust_sign
            if name in ("time_s", "thrust_n") or np.isfinite(values).any():
                found[name] = values
        return SweepTable(path, NAME, tuple(columns), found, ())

    return read


def _cell(path: Path, row: Row, k: int, name: str) -> float:
    """Blank and nan are what we write for "not measured"; anything else must be a finite number."""
    if k >= len(row.cells):
        raise UsageError(f"{path}:{row.line}: ends before column {name!r}: the line is cut off")
    cell = row.cells[k]
    if cell in ("", "nan"):
        return nan
    value = number(cell, decimal_comma=False)
    if value is None or not isfinite(value):
        raise UsageError(f"{path}:{row.line}: column {name!r} is {cell!r}, not a finite number; correct it or leave it "
                         "blank")
    return value
