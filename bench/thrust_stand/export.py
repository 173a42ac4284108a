"""A sweep for people and for other programs: text, and CSV in SI that `file:` and `stand import` read again."""

import csv
import math
from pathlib import Path

import numpy as np

from bench.thrust_stand.sweep_table import READING_FIELDS, SweepTable
from saranga.errors import DeviceError, UsageError


def write_si_csv(table: SweepTable, out: Path) -> None:
    """Columns named quantity_unit, blank where nothing was measured.

    Raises:
        UsageError: the file exists, or its folder does not. DeviceError: the disk is full or gone.
    """
    first = [name for name in READING_FIELDS if name in table.quantities]
    names = first + [name for name in table.quantities if name not in first]
    if "time_s" not in names:
        raise UsageError(f"{table.path}: no column of time in it: a table in SI needs one; add it to the file")
    try:
        with out.open("x", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            for row in np.stack([table.quantities[name] for name in names], axis=1).tolist():
                writer.writerow(["" if math.isnan(value) else f"{value:.9g}" for value in row])
    except FileExistsError:
        raise UsageError(f"--out {out} exists: results are never overwritten; choose another name") from None
    except FileNotFoundError:
        raise UsageError(f"--out {out}: its folder does not exist: make it first") from None
    except OSError as error:
        raise DeviceError(f"--out {out} cannot be written: {error.strerror}") from error


def sweep_text(table: SweepTable) -> str:
    """What was imported, in a few lines."""
    thrust = table.quantities["thrust_n"]
    lines = [f"{table.path}: {table.rows} rows ({table.format}), thrust {np.nanmin(thrust):.3f} .. "
             f"{np.nanmax(thrust):.3f} N"]
    fit = table.fit()
    if isinstance(fit, str):
        lines.append(f"  no fit of thrust over speed: {fit}")
    else:
        lines.append(f"  T = {fit.k:.4g} N/rpm^2 x rpm^2, {fit.rows} rows: residual {100 * fit.residual_of_max:.2f} % "
                     f"of the largest thrust (RMS), {100 * fit.largest_of_max:.2f} % at most")
    for column in table.columns:
        measured = int(np.isfinite(column.values).sum())
        unit = column.unit or "-"
        use = f" -> {column.quantity} in {column.si_unit}" if column.quantity else ""
        lines.append(f"  {column.name} [{unit}]: {measured} of {table.rows} rows{use}")
    return "\n".join(lines + [f"  note: {note}" for note in table.notes])
