"""The page of a preflight: GO or NO-GO with the reason, every check, on one sheet of A4."""

import html
import math
from pathlib import Path
from typing import Any

from bench.page import write_page_file

PASSED = "PASS"


def write_page(result: dict[str, Any], path: Path) -> Path:
    """Write the page.

    Raises:
        BenchError: it cannot be written.
    """
    rows = result["checks"]
    problems = [row for row in rows if row["verdict"] != PASSED]
    passed = [row for row in rows if row["verdict"] == PASSED]
    half = math.ceil(len(passed) / 2)
    return write_page_file(path, "preflight_page.html.j2", {"figure": figure, "age": age}, tree=result,
                           problems=problems, columns=[passed[:half], passed[half:]],
                           made=result["provenance"], signature=result.get("signature"))


def figure(row: dict[str, Any]) -> str:
    """Value and unit as a person reads them; a dash where there is none."""
    value = row["value"]
    if value is None:
        return "–"
    unit = row["unit"] if row["unit"] not in ("", "1", "year", "version") else ""
    return f"{value:.3g} {html.unescape(unit)}".strip()


def age(row: dict[str, Any]) -> str:
    """"12 s", or a dash."""
    return "–" if row["age_s"] is None else f"{row['age_s']:.0f} s"
