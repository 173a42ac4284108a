"""Figures of a campaign's page as inline SVG; colours come from the page's CSS, so light and dark pages share them."""

import json
import math
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from bench.drawing import DrawnScene, drawn_scene, kind_colour, outcome_colour

ROW_PX = 34.0
MAP_WIDTH = 300.0
NAME_PX = 19.0
"""Between rows that stand side by side because their traversability is the same."""
DASHES = {"clean": "", "net_hit": "7 4", "obstacle_hit": "2 3"}
"""Outcomes differ by the line as well as by colour."""


def rates_figure(rows: list[dict[str, Any]]) -> str:
    """The paper's rate and ours with 95 % intervals, a line a row."""
    left, right, top = 150.0, 24.0, 30.0
    width, height = 1000.0, top + ROW_PX * len(rows) + 34.0

    def x(rate: float) -> float:
        return left + rate * (width - left - right)

    out = [f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="success rates with intervals">']
    for percent in range(0, 101, 20):
        at = x(percent / 100)
        out.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{top - 8:.0f}" y2="{height - 28:.0f}" class="grid"/>'
                   f'<text x="{at:.1f}" y="{height - 8:.0f}" text-anchor="middle" class="tick">{percent} %</text>')
    for k, row in enumerate(rows):
        y = top + ROW_PX * (k + 0.5)
        out.append(f'<text x="{left - 12:.0f}" y="{y + 5:.1f}" text-anchor="end">{escape(row["name"])}</text>')
        for kind, rate, dy in (("paper", row["paper"], -7.0), ("lenient", row["lenient"], 7.0),
                               ("strict", row["strict"], 7.0)):
            if not rate or rate.get("rate") is None:
                continue
            low, high = rate["interval"]
            if kind != "lenient":
                out.append(f'<line x1="{x(low):.1f}" x2="{x(high):.1f}" y1="{y + dy:.1f}" y2="{y + dy:.1f}" '
                           f'class="{kind}-line"/>')
            out.append(f'<circle cx="{x(rate["rate"]):.1f}" cy="{y + dy:.1f}" r="5.5" class="{kind}-dot">'
                       f'<title>{kind} {100 * rate["rate"]:.0f} %</title></circle>')
    return "".join([*out, "</svg>"])


def two_rates_figure(rates: list[tuple[str, dict[str, Any]]]) -> str:
    """Success rates with their 95 % intervals under each other."""
    rows = [{"name": name, "paper": None, "lenient": None, "strict": rate} for name, rate in rates]
    return rates_figure(rows)


def against_traversability(rows: list[dict[str, Any]]) -> str:
    """Strict success rate against how far the course lets one fly; empty with fewer than two such rows."""
    known = [r for r in rows if r["traversability"] and r["strict"]["rate"] is not None]
    if len(known) < 2:
        return ""
    left, top, width, height = 60.0, 96.0, 1000.0, 410.0
    values = [float(r["traversability"]["mean"]) for r in known]
    least, most = 0.9 * min(values), 1.02 * max(values)

    def x(value: float) -> float:
        return left + (value - least) / (most - least) * (width - left - 70.0)

    def y(rate: float) -> float:
        return top + (1.0 - rate) * (height - top - 50.0)

    out = [f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="success against traversability">']
    for percent in range(0, 101, 25):
        out.append(f'<line x1="{left}" x2="{width - 70:.0f}" y1="{y(percent / 100):.1f}" y2="{y(percent / 100):.1f}" '
                   f'class="grid"/><text x="{left - 8}" y="{y(percent / 100) + 4:.1f}" text-anchor="end" '
                   f'class="tick">{percent} %</text>')
    for value in range(math.ceil(least), int(most) + 1, max(1, round((most - least) / 8.0))):
        out.append(f'<text x="{x(value):.1f}" y="{height - 28:.0f}" text-anchor="middle" class="tick">{value}</text>')
    out.append(f'<text x="{left}" y="{height - 6:.0f}" class="tick">traversability: mean free distance over the '
               "vehicle's size; further right is emptier</text>")
    at = -math.inf
    for row in sorted(known, key=lambda r: float(r["traversability"]["mean"])):
        at = max(x(row["traversability"]["mean"]), at + NAME_PX)  # names would cover each other any nearer
        rate = row["strict"]
        low, high = rate["interval"]
        out.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{top - 6:.0f}" y2="{y(high):.1f}" class="grid"/>'
                   f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{y(low):.1f}" y2="{y(high):.1f}" class="strict-line"/>'
                   f'<circle cx="{at:.1f}" cy="{y(rate["rate"]):.1f}" r="5.5" class="strict-dot">'
                   f'<title>{escape(row["name"])}: {row["traversability"]["mean"]:.1f}, {100 * rate["rate"]:.0f} %'
                   f'</title></circle><text transform="translate({at + 3:.1f} {top - 10:.0f}) rotate(-50)">'
                   f'{escape(row["name"])}</text>')
    return "".join([*out, "</svg>"])


def flight_map(folder: Path, outcome: dict[str, Any]) -> str:
    """One trial from above and, under it, from the side; a sentence where its file is missing."""
    name = outcome.get("files", {}).get("trial")
    try:
        data = json.loads((folder / str(name)).read_text(encoding="utf-8"))
        scene, track = drawn_scene(data["scene"]), np.array(data["track"], dtype=np.float64).reshape(-1, 4)
    except Exception as error:  # a damaged file must not cost the page
        return f'<p class="quiet">not drawn: {escape(type(error).__name__)}</p>'
    return _map(scene, track, str(outcome["outcome"]))


def _map(scene: DrawnScene, track: Any, outcome: str) -> str:
    (x0, x1), (y0, y1) = scene.x_m, scene.y_m
    scale = MAP_WIDTH / (x1 - x0)
    deep, high = (y1 - y0) * scale, 2.2 * scale
    colour, dash = outcome_colour(outcome), DASHES.get(outcome, "10 3 2 3")
    out = [f'<svg viewBox="0 0 {MAP_WIDTH:.0f} {deep + high + 8:.0f}" role="img" aria-label="{escape(outcome)}">']
    border = "net" if scene.netted else "outline"
    for axis, offset, low, tall in ((1, 0.0, y0, deep), (2, deep + 8, -2.2, high)):
        out.append(f'<svg y="{offset:.1f}" width="{MAP_WIDTH:.0f}" height="{tall:.1f}">'
                   f'<rect x="1" y="1" width="{MAP_WIDTH - 2:.0f}" height="{tall - 2:.1f}" class="{border}"/>')
        goal = (scene.goal_x_m - x0) * scale
        out.append(f'<line x1="{goal:.1f}" x2="{goal:.1f}" y1="0" y2="{tall:.1f}" class="goal"/>')
        for obstacle in scene.obstacles:
            points = " ".join(f"{(a - x0) * scale:.1f},{(b - low) * scale:.1f}"
                              for a, b in obstacle.footprint_m(0, axis))
            out.append(f'<polygon points="{points}" fill="{kind_colour(obstacle.kind)}" class="obstacle"/>')
        if len(track):
            path = " ".join(f"{(p[1] - x0) * scale:.1f},{(p[1 + axis] - low) * scale:.1f}" for p in track)
            end = track[-1]
            out.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2" '
                       f'stroke-dasharray="{dash}"/><circle cx="{(end[1] - x0) * scale:.1f}" '
                       f'cy="{(end[1 + axis] - low) * scale:.1f}" r="4" fill="{colour}"/>')
        out.append("</svg>")
    return "".join([*out, "</svg>"])
