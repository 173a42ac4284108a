"""Drawings of one flight as inline SVG: from above, from the side, and what both sonars heard before the end.

Colours of lines and text come from the page's CSS classes, so that one drawing serves a light and a dark page;
colours that carry a meaning (obstacle kind, outcome, detections) are the ones of `bench.drawing`.
"""

import base64
import io
from collections.abc import Iterable
from functools import cache
from html import escape

import numpy as np
from numpy.typing import NDArray

from bench.drawing import (
    DETECTION_COLOUR,
    GOAL_COLOUR,
    OUTCOME_WORDS,
    PATH_COLOUR,
    Flight,
    Floats,
    echo_shades,
    edge_columns,
    kind_colour,
    outcome_colour,
)
from saranga.echo import COLUMN_M, RANGE_COLUMNS

WIDTH = 1000.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 26.0, 12.0, 34.0
PATH_POINTS = 500
STRIP_BEFORE_S, STRIP_AFTER_S = 6.0, 1.0
STRIP_HEIGHT = 170.0


class _Canvas:
    """SVG text with a linear map from metres; `across` and `down` grow right and down the page."""

    def __init__(self, across: tuple[float, float], down: tuple[float, float], title: str) -> None:
        self.across, self.down = across, down
        self.scale = (WIDTH - _LEFT - _RIGHT) / (across[1] - across[0])
        self.height = (down[1] - down[0]) * self.scale + _TOP + _BOTTOM
        self.parts = [f'<svg viewBox="0 0 {WIDTH:.0f} {self.height:.0f}" role="img" aria-label="{escape(title)}">']

    def x(self, metres: float) -> float:
        return _LEFT + (metres - self.across[0]) * self.scale

    def y(self, metres: float) -> float:
        return _TOP + (metres - self.down[0]) * self.scale

    def add(self, text: str) -> None:
        self.parts.append(text)

    def points(self, points: Floats) -> str:
        return " ".join(f"{self.x(a):.1f},{self.y(b):.1f}" for a, b in points)

    def line(self, a: tuple[float, float], b: tuple[float, float], attributes: str) -> None:
        self.add(f'<line x1="{self.x(a[0]):.1f}" y1="{self.y(a[1]):.1f}" x2="{self.x(b[0]):.1f}" '
                 f'y2="{self.y(b[1]):.1f}" {attributes}/>')

    def dots(self, points: Floats, radius: float, attributes: str) -> None:
        """Many equal dots as one path of zero-length round strokes: small."""
        if len(points):
            marks = "".join(f"M{self.x(a):.1f} {self.y(b):.1f}h0" for a, b in points)
            self.add(f'<path d="{marks}" stroke-linecap="round" stroke-width="{2 * radius:.1f}" {attributes}/>')

    def circle(self, at: tuple[float, float], radius: float, attributes: str, title: str = "") -> None:
        inner = f"<title>{escape(title)}</title>" if title else ""
        self.add(f'<circle cx="{self.x(at[0]):.1f}" cy="{self.y(at[1]):.1f}" r="{radius:.1f}" {attributes}>'
                 f"{inner}</circle>")

    def text(self, at: tuple[float, float], words: str, attributes: str = "", dx: float = 0, dy: float = 0) -> None:
        self.add(f'<text x="{self.x(at[0]) + dx:.1f}" y="{self.y(at[1]) + dy:.1f}" {attributes}>'
                 f"{escape(words)}</text>")

    def metre_grid(self, across_label: str, down_sign: float) -> None:
        """A line a metre, numbered along the bottom and the left; `down_sign` -1 numbers upwards."""
        (a0, a1), (b0, b1) = self.across, self.down
        for a in np.arange(np.ceil(a0 - 1e-9), a1 + 1e-9):
            self.line((a, b0), (a, b1), 'class="grid"')
            unit = " m" if a + 1 > a1 else ""
            self.text((a, b1), f"{a + 0.0:g}{unit}", 'class="tick" text-anchor="middle"', dy=15)
        for b in np.arange(np.ceil(b0 - 1e-9), b1 + 1e-9):
            self.line((a0, b), (a1, b), 'class="grid"')
            self.text((a0, b), f"{down_sign * b + 0.0:g}", 'class="tick" text-anchor="end"', dx=-6, dy=4)
        self.text(((a0 + a1) / 2, b1), across_label, 'class="tick" text-anchor="middle"', dy=30)

    def finish(self) -> str:
        return "".join([*self.parts, "</svg>"])


def top_view(flight: Flight) -> str:
    """The flight from above: the course to the right, the vehicle's right hand down the page."""
    scene = flight.scene
    canvas = _Canvas(scene.x_m, scene.y_m, f"seed {flight.result.seed} from above")
    canvas.metre_grid("from above; metres along the course, right of it downwards", 1.0)
    canvas.line((scene.goal_x_m, scene.y_m[0]), (scene.goal_x_m, scene.y_m[1]),
                f'stroke="{GOAL_COLOUR}" stroke-width="4" opacity="0.8"')
    canvas.circle((scene.start_m[0], scene.start_m[1]), 0.2 * canvas.scale, 'class="start"', "start")
    _body(canvas, flight, 1)
    return canvas.finish()


def side_view(flight: Flight) -> str:
    """The flight from its right-hand side: the course to the right, height upwards."""
    scene = flight.scene
    tops = [-float(o.vertices_m[:, 2].min()) for o in scene.obstacles]
    highest = min(scene.height_m, max([1.5, *tops, float(-flight.log.pos_m[:, 2].min())]) + 0.3)
    canvas = _Canvas(scene.x_m, (-highest, 0.0), f"seed {flight.result.seed} from the side")
    canvas.metre_grid("from the side; metres along the course, height upwards", -1.0)
    canvas.line((scene.goal_x_m, -highest), (scene.goal_x_m, 0.0),
                f'stroke="{GOAL_COLOUR}" stroke-width="4" opacity="0.8"')
    _body(canvas, flight, 2)
    return canvas.finish()


def _body(canvas: _Canvas, flight: Flight, axis: int) -> None:
    """Obstacles, path, detections and the end; `axis` (1 = y, 2 = z) goes down the page, x across."""
    scene, log, result = flight.scene, flight.log, flight.result
    (a0, a1), (b0, b1) = canvas.across, canvas.down
    style = 'class="net"' if scene.netted else 'class="outline"'
    canvas.add(f'<rect x="{canvas.x(a0):.1f}" y="{canvas.y(b0):.1f}" width="{(a1 - a0) * canvas.scale:.1f}" '
               f'height="{(b1 - b0) * canvas.scale:.1f}" {style}/>')
    for obstacle in scene.obstacles:
        shape = obstacle.footprint_m(0, axis)
        shape[:, 1] = np.clip(shape[:, 1], b0, b1)
        canvas.add(f'<polygon points="{canvas.points(shape)}" fill="{kind_colour(obstacle.kind)}" class="obstacle">'
                   f"<title>{escape(obstacle.name)}</title></polygon>")
    seen = np.concatenate([*flight.detections_m, np.zeros((0, 3))])[:, [0, axis]]
    inside = (seen >= (a0, b0)).all(axis=1) & (seen <= (a1, b1)).all(axis=1)
    canvas.dots(np.unique(np.round(seen[inside], 2), axis=0), 1.6,
                f'stroke="{DETECTION_COLOUR}" opacity="0.55" fill="none"')
    if len(log.pos_m) == 0:
        return
    path = log.pos_m[:, [0, axis]]
    pick = np.unique(np.linspace(0, len(path) - 1, min(PATH_POINTS, len(path))).astype(int))
    canvas.add(f'<polyline points="{canvas.points(path[pick])}" fill="none" stroke="{PATH_COLOUR}" '
               'stroke-width="2.6" stroke-linejoin="round"/>')
    colour = outcome_colour(result.outcome)
    end = (float(path[flight.end_tick, 0]), float(path[flight.end_tick, 1]))
    canvas.circle(end, 0.118 * canvas.scale, f'fill="{colour}" fill-opacity="0.25" stroke="{colour}" '
                  'stroke-width="2.5"', f"{result.outcome}: {result.cause}")
    words = OUTCOME_WORDS.get(result.outcome, result.outcome) + (f", {result.part}" if result.part else "")
    if end[0] < a1 - 2.6:  # ahead of it, where it has not been
        canvas.text(end, words, f'class="mark" fill="{colour}"', dx=0.118 * canvas.scale + 8, dy=5)
    else:
        above = canvas.y(end[1]) > _TOP + 40
        canvas.text(end, words, f'class="mark" fill="{colour}" text-anchor="end"', dx=14, dy=-20 if above else 30)


def echo_strip(flight: Flight) -> str:
    """Both sonars' newest rows around the end of the course: time to the right, range upwards, edges marked.

    Empty when the log kept no echoes.
    """
    log, end = flight.log, flight.end_tick
    if log.envelope_left.size == 0 and log.envelope_right.size == 0:
        return ""
    time_s = flight.time_s
    ticks = np.flatnonzero((time_s >= time_s[end] - STRIP_BEFORE_S) & (time_s <= time_s[end] + STRIP_AFTER_S))
    first_s, tick_s = time_s[ticks[0]], float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0625
    span_s = tick_s * len(ticks)
    top, gap, parts = 18.0, 40.0, []
    plot_width = WIDTH - _LEFT - _RIGHT
    for number, (side, rows, edges) in enumerate((("left", log.envelope_left, log.edges_left),
                                                  ("right", log.envelope_right, log.edges_right))):
        if rows.size == 0:
            continue
        y0 = top + number * (STRIP_HEIGHT + gap)
        parts.append(f'<text x="{_LEFT:.0f}" y="{y0 - 5:.0f}" class="tick">{side} sonar: range in metres against '
                     "simulated seconds</text>")
        parts.append(f'<image x="{_LEFT:.1f}" y="{y0:.1f}" width="{plot_width:.1f}" height="{STRIP_HEIGHT:.1f}" '
                     f'preserveAspectRatio="none" href="{_picture(rows[ticks])}"/>')
        for metres in (0.0, 0.5, 1.0, 1.5):
            y = y0 + STRIP_HEIGHT * (1 - metres / (RANGE_COLUMNS * COLUMN_M))
            parts.append(f'<line x1="{_LEFT - 5:.0f}" x2="{_LEFT:.0f}" y1="{y:.1f}" y2="{y:.1f}" class="axis"/>'
                         f'<text x="{_LEFT - 8:.0f}" y="{y + 4:.1f}" class="tick" text-anchor="end">{metres:g}</text>')
        for second in np.arange(np.ceil(first_s), first_s + span_s):
            x = _LEFT + plot_width * (second - first_s) / span_s
            parts.append(f'<text x="{x:.1f}" y="{y0 + STRIP_HEIGHT + 14:.1f}" class="tick" '
                         f'text-anchor="middle">{second:g} s</text>')
        parts.append(_edge_marks(edges[ticks], y0, plot_width))
        x = _LEFT + plot_width * (time_s[end] - first_s + tick_s / 2) / span_s
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y0:.1f}" y2="{y0 + STRIP_HEIGHT:.1f}" '
                     f'stroke="{outcome_colour(flight.result.outcome)}" stroke-width="2.5" stroke-dasharray="7 4"/>')
    height = top + 2 * STRIP_HEIGHT + gap + 24
    return (f'<svg viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" aria-label="echoes of both sonars">'
            + "".join(parts) + "</svg>")


def _edge_marks(edges: NDArray[np.uint8], y0: float, plot_width: float) -> str:
    marks = []
    for tick, row in enumerate(edges):
        x = _LEFT + plot_width * (tick + 0.5) / len(edges)
        marks += [f"M{x:.1f} {y0 + STRIP_HEIGHT * (1 - column / RANGE_COLUMNS):.1f}h0" for column in edge_columns(row)]
    return f'<path d="{"".join(marks)}" stroke="#50ffdc" stroke-width="4" stroke-linecap="round" fill="none"/>'


def _picture(rows: NDArray[np.uint8]) -> str:
    """Echo rows (T, N) as a palette PNG data URI: time to the right, range upwards, noise dark."""
    from PIL import Image

    paired = rows[:, :rows.shape[1] // 2 * 2].reshape(len(rows), -1, 2).max(axis=2)
    low, high = echo_shades(rows)
    shade = np.clip((paired.astype(np.float64) - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    picture = Image.fromarray(np.ascontiguousarray(shade.T[::-1]))
    picture.putpalette(_inferno())
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


@cache
def _inferno() -> bytes:
    from matplotlib import colormaps

    return bytes((np.asarray(colormaps["inferno"](np.arange(256)))[:, :3] * 255).round().astype(np.uint8).ravel())


def legend(kinds: Iterable[str]) -> list[tuple[str, str]]:
    """(colour, meaning) of what the views show."""
    shown = [(kind_colour(kind), kind) for kind in sorted(set(kinds))]
    return [(PATH_COLOUR, "flown path"), *shown, (DETECTION_COLOUR, "located by the stack"), (GOAL_COLOUR, "goal")]
