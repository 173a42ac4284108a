"""Every setpoint of a flight on one strip: when it came, and how late it was. SVG in the colours of the page."""

import csv
from pathlib import Path
from typing import Any

from bench.hil.timing import TICK_MS
from saranga.errors import UsageError

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 1000.0, 190.0, 62.0, 14.0, 30.0
MOST_FLIGHTS = 6


def setpoint_figures(run_dir: Path, outcomes: list[dict[str, Any]]) -> list[dict[str, str]]:
    """Of the first flights that have their setpoints: the seed, the drawing, or why there is none."""
    shown = []
    for outcome in outcomes[:MOST_FLIGHTS]:
        name = (outcome.get("files") or {}).get("wire")
        try:
            rows = _read(run_dir / name) if name else []
            svg, missing = (_strip(rows), "") if rows else ("", "no setpoint came during the course")
        except UsageError as error:
            svg, missing = "", str(error)
        shown.append({"seed": str(outcome["seed"]), "svg": svg, "missing": missing})
    return shown


def _read(path: Path) -> list[tuple[float, float, bool]]:
    """(arrival s, response or else interval ms, whether it is a response)."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [(float(r["arrival_s"]), float(r["response_ms"] or r["interval_ms"]), bool(r["response_ms"]))
                    for r in csv.DictReader(file)]
    except (OSError, ValueError, KeyError) as error:
        raise UsageError(f"{path}: cannot be read ({error})") from error


def _strip(rows: list[tuple[float, float, bool]]) -> str:
    last_s = max(rows[-1][0], 1.0)
    top_ms = max(2.0 * TICK_MS, min(1.1 * max(ms for _, ms, _ in rows), 8.0 * TICK_MS))
    what = "response" if rows[0][2] else "interval"

    def x(at_s: float) -> float:
        return LEFT + (WIDTH - LEFT - 12.0) * at_s / last_s

    def y(ms: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (1.0 - min(max(ms, 0.0), top_ms) / top_ms)

    out = [f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img" aria-label="{what} of every setpoint">']
    for second in range(0, int(last_s) + 1, max(1, int(last_s) // 10)):
        out.append(f'<line x1="{x(second):.1f}" x2="{x(second):.1f}" y1="{TOP:.0f}" y2="{HEIGHT - BOTTOM:.0f}" '
                   f'class="grid"/><text x="{x(second):.1f}" y="{HEIGHT - 10:.0f}" text-anchor="middle" class="tick">'
                   f'{second} s</text>')
    for ms in (0.0, TICK_MS, top_ms):
        out.append(f'<text x="{LEFT - 8:.0f}" y="{y(ms) + 5:.1f}" text-anchor="end" class="tick">{ms:.4g} ms</text>')
    out.append(f'<line x1="{LEFT:.0f}" x2="{WIDTH - 12:.0f}" y1="{y(TICK_MS):.1f}" y2="{y(TICK_MS):.1f}" class="net"/>')
    for at_s, ms, _ in rows:
        late = ms > (TICK_MS if what == "response" else 1.1 * TICK_MS)
        out.append(f'<circle cx="{x(at_s):.1f}" cy="{y(ms):.1f}" r="3" fill="var(--{"fail" if late else "pass"})">'
                   f'<title>{at_s:.2f} s: {what} {ms:.1f} ms</title></circle>')
    return "".join([*out, "</svg>"])
