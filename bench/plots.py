"""A flight from above as a PNG or SVG file by matplotlib: the picture where no viewer can draw."""

from pathlib import Path

import numpy as np

from bench.drawing import (
    DETECTION_COLOUR,
    GOAL_COLOUR,
    OUTCOME_WORDS,
    PATH_COLOUR,
    Flight,
    kind_colour,
    outcome_colour,
)
from saranga.errors import UsageError
from sitl.trial_types import FlightLog, TrialResult


def plot_top_view(log: FlightLog, result: TrialResult, path: Path) -> Path:
    """Draw the flight from above, course to the right, vehicle's right hand downwards; 1600 pixels wide.

    Raises:
        UsageError: `path` ends in neither .png nor .svg.
        BenchError: a scene that cannot be drawn.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon, Rectangle

    if path.suffix not in (".png", ".svg"):
        raise UsageError(f"picture {path}: must end in .png or .svg")
    flight = Flight(log, result)
    scene = flight.scene
    (x0, x1), (y0, y1) = scene.x_m, scene.y_m
    figure = Figure(figsize=(16, 16 * (y1 - y0) / (x1 - x0) + 1.9), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="#7088a8", linewidth=1.5,
                             linestyle="--" if scene.netted else "-"))
    axes.axvline(scene.goal_x_m, color=GOAL_COLOUR, linewidth=3, alpha=0.8)
    axes.text(scene.goal_x_m, y0, " goal", color=GOAL_COLOUR, va="top", fontsize=13)
    axes.add_patch(Circle(scene.start_m[:2], 0.2, fill=False, edgecolor="#555555", linewidth=1.5))
    axes.text(scene.start_m[0], scene.start_m[1] + 0.24, "start", ha="center", va="top", fontsize=13)
    for obstacle in scene.obstacles:
        axes.add_patch(Polygon(obstacle.footprint_m(0, 1), facecolor=kind_colour(obstacle.kind), edgecolor="#33332a",
                               linewidth=0.8, zorder=3))
    seen = np.concatenate([*flight.detections_m, np.zeros((0, 3))])
    axes.scatter(seen[:, 0], seen[:, 1], s=6, color=DETECTION_COLOUR, alpha=0.5, linewidths=0,
                 label="located by the stack", zorder=2)
    axes.plot(log.pos_m[:, 0], log.pos_m[:, 1], color=PATH_COLOUR, linewidth=2.4, label="flown path", zorder=4)
    colour = outcome_colour(result.outcome)
    if len(log.pos_m):
        end = log.pos_m[flight.end_tick]
        axes.add_patch(Circle((float(end[0]), float(end[1])), 0.118, facecolor=colour, alpha=0.45, zorder=5))
    words = OUTCOME_WORDS.get(result.outcome, result.outcome)
    axes.set_title(f"{result.scene}, seed {result.seed}: {words}\n{result.cause}", color=colour, fontsize=16)
    axes.set_xlim(x0 - 0.15, x1 + 0.15)
    axes.set_ylim(y1 + 0.15, y0 - 0.15)
    axes.set_aspect("equal")
    axes.grid(alpha=0.25)
    axes.set_xlabel("along the course, m")
    axes.set_ylabel("right of the course, m")
    axes.legend(loc="lower right", fontsize=12)
    path.parent.mkdir(parents=True, exist_ok=True)
    # no creation date, so that the same flight gives the same bytes
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    return path
