"""CSV of the RCbenchmark application (Series 1520, 1580, 1780): name and unit in the header, units as the user chose.

Its quirks: UTF-8 BOM, micro sign and middle dot, a comma at the end of every line, blank cells for what is not
fitted, no torque and vibration on a 1520, thrust of either sign, columns that a user's script has added, free text in
"App message". Seen in the recordings in `fixtures/thrust` and in files of all three series.
"""

import re
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.thrust_stand.csv_cells import NUMBER, Row, number, uses_decimal_comma
from bench.thrust_stand.sweep_table import Column, SweepTable
from bench.thrust_stand.units import conversion, known_units, si_unit
from saranga.errors import UsageError

NAME = "rcbenchmark"
LOOKS = "a header such as Time (s),ESC signal (µs),...,Thrust (gf),..."
HEADING = re.compile(r"(.*?)\s*[(\[]([^()\[\]]*)[)\]]\s*")
ROTATION = ("electrical", "optical")


@dataclass(frozen=True)
class Role:
    """What a column is for us: field of a reading, dimension, and whether it is a measurement (then it is strict)."""

    quantity: str
    dimension: str
    strict: bool = True


ROLES: tuple[tuple[str, Role], ...] = (
    (r"time", Role("time_s", "time")),
    (r"esc( a)?( signal)?", Role("esc_s", "pulse")),
    (r"thrust( a)?", Role("thrust_n", "force")),
    (r"torque( a)?", Role("torque_n_m", "torque")),
    (r"voltage( a)?", Role("voltage_v", "voltage")),
    (r"current( a)?", Role("current_a", "current")),
    (r"(motor )?electrical speed( a)?", Role("rpm_electrical", "rotation")),
    (r"(motor )?optical speed( a)?", Role("rpm_optical", "rotation")),
    (r"(motor speed|rotation(al)? speed|rpm)( a)?", Role("rpm_other", "rotation")),
    (r"electrical power( a)?", Role("power_w", "power", strict=False)),
    (r"mechanical power( a)?", Role("mechanical_power_w", "power", strict=False)),
    (r"vibration( a)?", Role("vibration_m_s2", "acceleration")),
    (r"esc temp(erature)?", Role("esc_temperature_c", "temperature")),
    (r"motor temp(erature)?", Role("motor_temperature_c", "temperature")),
)
FREE_TEXT = "app message"


@dataclass(frozen=True)
class Heading:
    """One cell of the header."""

    index: int
    name: str
    unit: str
    role: Role | None


def recognises(cells: list[str]) -> bool:
    """Thrust with a unit, beside at least one other column with a unit."""
    headings = [_heading(k, cell) for k, cell in enumerate(cells)]
    units = [h for h in headings if h.unit]
    return len(units) >= 2 and any(h.role and h.role.quantity == "thrust_n" and h.unit for h in headings)


def build(rpm: str = "", thrust_sign: int = 1) -> object:
    """A reader of such files.

    Args:
        rpm: "electrical" or "optical" [the one that saw the motor turn in more rows; electrical where both did].
        thrust_sign: -1 turns all thrusts round [1].

    Raises:
        ValueError: a value that is none of these.
    """
    if rpm not in ("", *ROTATION):
        raise ValueError(f"rpm is {rpm!r}: it must be electrical or optical")
    if thrust_sign not in (1, -1):
        raise ValueError(f"thrust_sign is {thrust_sign!r}: it must be 1 or -1")

    def read(path: Path, rows: list[Row], header_at: int, separator: str) -> SweepTable:
        return _read(path, rows, header_at, separator, rpm, thrust_sign)

    return read


def _heading(index: int, cell: str) -> Heading:
    match = HEADING.fullmatch(cell)
    name, unit = (match[1], match[2].strip()) if match else (cell, "")
    plain = " ".join(name.lower().split())
    role = next((role for pattern, role in ROLES if re.fullmatch(pattern, plain)), None)
    return Heading(index, name, unit, role)


def _read(path: Path, rows: list[Row], header_at: int, separator: str, rpm: str, thrust_sign: int) -> SweepTable:
    header, body = rows[header_at], rows[header_at + 1:]
    headings = _headings(path, header)
    if not body:
        raise UsageError(f"{path}: a header in line {header.line} and no rows: the sweep is empty")
    decimal_comma = uses_decimal_comma(path, body, separator)
    notes = [f"{header_at} lines before the header are passed over"] if header_at else []
    body = _squared(path, header, body, headings, notes)
    columns = []
    found: dict[str, NDArray[np.float64]] = {}
    for heading in headings:
        values, blanks = _column(path, heading, body, decimal_comma)
        role = heading.role
        if role is not None:
            factor, offset = _conversion(path, header.line, heading, role)
            values = values * factor + offset
            if role.quantity == "thrust_n":
                values = values * thrust_sign
            found[role.quantity] = values
        if blanks:
            notes.append(f"column {heading.name!r}: {blanks} values that are not finite count as blank")
        columns.append(Column(heading.name, heading.unit, role.quantity if role else "",
                              si_unit(role.dimension) if role else "", values))
    if not np.isfinite(found["thrust_n"]).any():
        raise UsageError(f"{path}: column {_named(headings, 'thrust_n')!r} is blank in all {len(body)} rows: there is "
                         "nothing to import")
    return SweepTable(path, NAME, tuple(columns), _quantities(found, rpm, path, notes), tuple(notes))


def _headings(path: Path, header: Row) -> list[Heading]:
    headings = [_heading(k, cell) for k, cell in enumerate(header.cells)]
    while headings and not headings[-1].name and not headings[-1].unit:
        headings.pop()
    taken: dict[str, Heading] = {}
    for heading in headings:
        if not heading.name:
            raise UsageError(f"{path}:{header.line}: column {heading.index + 1} has no name: correct the header")
        if heading.role is None:
            continue
        if heading.role.quantity in taken:
            raise UsageError(f"{path}:{header.line}: columns {taken[heading.role.quantity].name!r} and "
                             f"{heading.name!r} are both {heading.role.quantity}: remove one of them")
        taken[heading.role.quantity] = heading
    return headings


def _conversion(path: Path, line: int, heading: Heading, role: Role) -> tuple[float, float]:
    factors = conversion(role.dimension, heading.unit)
    if factors is None:
        raise UsageError(f"{path}:{line}: column {heading.name!r} has unit {heading.unit!r}, which is no unit of "
                         f"{role.dimension}: known are {known_units(role.dimension)}")
    return factors


def _squared(path: Path, header: Row, body: list[Row], headings: list[Heading], notes: list[str]) -> list[Row]:
    """Rows as wide as the header. "App message" is free text, commas included, and what a script adds comes after it
    and may be missing or unnamed; all columns before it must be there.

    Raises:
        UsageError: a line that is cut off, or has more cells than its header explains.
    """
    wide = len(headings)
    free = next((h.index for h in headings if h.name.lower() == FREE_TEXT), None)
    needed = wide if free is None else max([free, *(h.index + 1 for h in headings if h.role)])
    squared, loose = [], 0
    for row in body:
        cells = row.cells
        if len(cells) < needed:
            raise UsageError(f"{path}:{row.line}: {len(cells)} cells, but the header in line {header.line} names "
                             f"{wide} columns: the line is cut off or its separator is another one")
        beyond = next((c for c in cells[wide:] if c), None)
        # A number where text should be, and a cell too many: a comma inside a number has shifted the row.
        shifted = free is not None and len(cells) > len(header.cells) and NUMBER.fullmatch(cells[free])
        if beyond is not None or shifted:
            if free is None or needed > free + 1 or NUMBER.fullmatch(cells[free]):
                raise UsageError(f"{path}:{row.line}: {len(cells)} cells, the header in line {header.line} names "
                                 f"{wide} columns, so that {beyond or cells[free or 0]!r} is in no place: is there a "
                                 "decimal comma, or a separator inside a text? Put it in quotes, or save with another "
                                 "separator")
            cells, loose = cells[:free], loose + 1
        squared.append(Row(row.line, [*cells[:wide], *([""] * (wide - len(cells)))]))
    if loose:
        notes.append(f"{loose} rows have more cells after {headings[free or 0].name!r} than the header names: what is "
                     "there is not imported")
    return squared


def _column(path: Path, heading: Heading, body: list[Row], decimal_comma: bool) -> tuple[NDArray[np.float64], int]:
    """Values as written, NaN where blank or free text, and how many were "NaN" or "Infinity" in a derived column."""
    values = np.full(len(body), nan)
    not_finite = 0
    for k, row in enumerate(body):
        cell = row.cells[heading.index]
        if not cell:
            continue
        value = number(cell, decimal_comma)
        role = heading.role
        if value is not None and np.isfinite(value):
            if value < 0.0 and role is not None and role.dimension == "rotation":
                raise UsageError(f"{path}:{row.line}: column {heading.name!r} is {cell!r}, below 0: a speed has no "
                                 "direction here; correct it")
            values[k] = value
            continue
        if role is not None and role.strict:
            raise UsageError(f"{path}:{row.line}: column {heading.name!r} is {cell!r}, not a finite number"
                             f"{_advice(cell)}; correct it, or leave the cell blank where nothing was measured")
        not_finite += cell.lstrip("+-").lower() in ("nan", "infinity", "inf")
    return values, not_finite


def _advice(cell: str) -> str:
    if "," in cell and "." in cell:
        return " (marks for thousands cannot be told from decimals)"
    if "," in cell:
        return " (a decimal comma beside decimal points, or in a file separated by commas)"
    return ""


def _named(headings: list[Heading], quantity: str) -> str:
    return next(h.name for h in headings if h.role and h.role.quantity == quantity)


def _quantities(found: dict[str, NDArray[np.float64]], rpm: str, path: Path,
                notes: list[str]) -> dict[str, NDArray[np.float64]]:
    """Readings by name, with one rotation speed out of those in the file. Wholly blank columns are not measured."""
    speeds = {name.removeprefix("rpm_"): values for name, values in found.items() if name.startswith("rpm_")}
    kept = {name: values for name, values in found.items()
            if not name.startswith("rpm_") and (name == "thrust_n" or np.isfinite(values).any())}
    if rpm and rpm not in speeds:
        raise UsageError(f"{path}: no {rpm} rotation speed in it: there is {', '.join(speeds) or 'none'}")
    if speeds:
        order = [name for name in (*ROTATION, "other") if name in speeds]
        best = rpm or max(order, key=lambda name: int((speeds[name] > 0.0).sum()))
        kept["rpm"] = speeds[best]
        notes.append(f"rotation speed is the {best} one")
        both = [values > 0.0 for values in speeds.values()]
        together = np.logical_and.reduce(both)
        if len(speeds) > 1 and together.any():
            first, second = list(speeds.values())[:2]
            ratio = float(np.median(first[together] / second[together]))
            if abs(ratio - 1.0) > 0.02:
                notes.append(f"electrical and optical speeds disagree by a factor of {ratio:.3f}: check the number of "
                             "motor poles and of reflecting marks")
    negative = kept["thrust_n"] < 0.0
    if negative.any():
        notes.append(f"thrust is negative in {int(negative.sum())} of {len(negative)} rows; signs are kept")
    return kept
