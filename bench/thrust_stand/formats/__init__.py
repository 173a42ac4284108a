"""Files of thrust stands, one format a file, found by its `NAME`.

A format is a module with `NAME`, `LOOKS` (for people), `recognises(cells)` of a header line, and `build(**options)`,
which returns `read(path, rows, header_at, separator) -> SweepTable`.
"""

import sys
from pathlib import Path
from typing import Any

from bench.thrust_stand.csv_cells import read_text, rows_of, separator_of
from bench.thrust_stand.sweep_table import SweepTable
from saranga.errors import UsageError
from saranga.plugins import call_with_options, plugins

HEADER_WITHIN = 20


def format_names() -> list[str]:
    """Formats that `read_sweep` knows."""
    return list(plugins(sys.modules[__name__]))


def read_sweep(path: Path, **options: Any) -> SweepTable:
    """Read a sweep, whatever known format it is in.

    Args:
        options: of the format, see its `build`.

    Raises:
        UsageError: not a known format, or a fault in it: file, line, column and value are named.
    """
    text = read_text(path)
    known = plugins(sys.modules[__name__])
    lines = text.splitlines()
    for at, line in enumerate([line for line in lines if line.strip()][:HEADER_WITHIN]):
        separator = separator_of(line)
        cells = [cell.strip().strip('"').strip() for cell in line.split(separator)]
        for name, module in known.items():
            if module.recognises(cells):
                rows = rows_of(path, text, separator)
                read = call_with_options("stand file format", name, module.build, options)
                table: SweepTable = read(path, rows, at, separator)
                return table
    first = next(line for line in lines if line.strip()).strip()
    looks = "; ".join(f"{name}: {module.LOOKS}" for name, module in known.items())
    raise UsageError(f"{path}: no header of a thrust stand in its first {HEADER_WITHIN} lines, which begin with "
                     f"{first[:60]!r}; known are {looks}")
