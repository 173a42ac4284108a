"""Text tables as programs and spreadsheets leave them: encoding, separator, decimal mark; not what columns mean."""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

from saranga.errors import UsageError

MOST_BYTES = 200_000_000
SEPARATORS = (",", ";", "\t")
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
COMMA_NUMBER = re.compile(r"[+-]?(\d+(,\d*)?|,\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class Row:
    """Cells of one line, without blanks around them; `line` counts from 1 as an editor does."""

    line: int
    cells: list[str]


def read_text(path: Path) -> str:
    """The file as text: UTF-8 (with or without BOM), UTF-16 with BOM, else Windows-1252.

    Raises:
        UsageError: it cannot be read, is empty, or holds binary data.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UsageError(f"{path}: {path.stat().st_size} bytes are more than {MOST_BYTES}: is it a sweep?")
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    if not data.strip():
        raise UsageError(f"{path}: is empty: give a CSV file of a thrust stand")
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if not text.strip():
        raise UsageError(f"{path}: is empty: give a CSV file of a thrust stand")
    if "\0" in text:
        raise UsageError(f"{path}: holds binary data (a zero at character {text.index(chr(0))}): give the CSV file")
    return text


def rows_of(path: Path, text: str, separator: str) -> list[Row]:
    """Lines that are not blank, cut at `separator`, quotes understood.

    Raises:
        UsageError: quotes that do not close.
    """
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows = []
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append(Row(reader.line_num, [cell.strip() for cell in cells]))
    except csv.Error as error:
        raise UsageError(f"{path}:{reader.line_num}: {error}: mend the quotes in this line") from error
    return rows


def separator_of(header: str) -> str:
    """The separator that cuts a header line into most pieces."""
    return max(SEPARATORS, key=header.count)


def uses_decimal_comma(path: Path, rows: list[Row], separator: str) -> bool:
    """Whether numbers are written 1,5. Only possible where the comma does not separate cells.

    Raises:
        UsageError: both 1,5 and 1.5 are there.
    """
    if separator == ",":
        return False
    commas = next(((r.line, c) for r in rows for c in r.cells if "," in c and COMMA_NUMBER.fullmatch(c)), None)
    points = next(((r.line, c) for r in rows for c in r.cells if "." in c and NUMBER.fullmatch(c)), None)
    if commas and points:
        raise UsageError(f"{path}: decimal comma in line {commas[0]} ({commas[1]}) and decimal point in line "
                         f"{points[0]} ({points[1]}): use one of them")
    return commas is not None


def number(cell: str, decimal_comma: bool) -> float | None:
    """The cell as a number, None where it is none. Only plain digits: no thousands, no nan, no inf."""
    if decimal_comma:
        return float(cell.replace(",", ".")) if COMMA_NUMBER.fullmatch(cell) else None
    return float(cell) if NUMBER.fullmatch(cell) else None
