"""The page of a preflight: GO or NO-GO with the reason, every check, on one sheet of A4."""

import html
import math
from pathlib import Path
from typing import Any

from bench.page import write_page_file

PASSED = "PASS"
GROUPED_FROM = 4


def write_page(result: dict[str, Any], path: Path) -> Path:
    """Write the page.

    Raises:
        BenchError: it cannot be written.
    """
    rows = result["checks"]
    problems = grouped([row for row in rows if row["verdict"] != PASSED])
    passed = [row for row in rows if row["verdict"] == PASSED]
    half = math.ceil(len(passed) / 2)
    return write_page_file(path, "preflight_page.html.j2", {"figure": figure, "age": age}, tree=result,
                           problems=problems, columns=[passed[:half], passed[half:]],
                           made=result["provenance"], signature=result.get("signature"))


def grouped(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that are open for one and the same reason as one row: a missing cable is one problem, not forty."""
    reasons = [row["why"] for row in rows if row["verdict"] == "INCONCLUSIVE"]
    out: list[dict[str, Any]] = []
    for row in rows:
        if row["verdict"] != "INCONCLUSIVE" or reasons.count(row["why"]) < GROUPED_FROM:
            out.append(row)
            continue
        first = next((other for other in out if (other["why"], other["verdict"]) == (row["why"], row["verdict"])), None)
        if first is None:
            out.append({**row, "limit": "", "source": ""})
        else:
            first["name"] += f", {row['name']}"
    return out


def figure(row: dict[str, Any]) -> str:
    """Value and unit as a person reads them; a dash where there is none."""
    value = row["value"]
    if value is None:
        return "–"
    unit = row["unit"] if row["unit"] not in ("", "1", "year", "version") else ""
    text = f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{text} {html.unescape(unit)}".strip()


def age(row: dict[str, Any]) -> str:
    """"12 s", or a dash."""
    return "–" if row["age_s"] is None else f"{row['age_s']:.0f} s"
