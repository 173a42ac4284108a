"""The page of a beam pattern: level over azimuth and distance, as the paper's Fig. S3."""

from pathlib import Path
from typing import Any

import numpy as np

from bench.page import write_page_file
from bench.svg_figure import svg_text


def write_beam_page(folder: Path, result: dict[str, Any]) -> Path:
    """Write `report.html`.

    Raises:
        BenchError: it cannot be written.
    """
    return write_page_file(folder / "report.html", "beam_page.html.j2", {}, result=result, polar=polar(result))


def polar(result: dict[str, Any]) -> str:
    """Level re 20 000 over the half plane in front of the sensor, and the pattern by distance."""
    from matplotlib.figure import Figure

    points = result["points"]
    figure = Figure(figsize=(13.0, 5.2), layout="constrained")
    fan: Any = figure.add_subplot(1, 2, 1, projection="polar")
    fan.set_theta_zero_location("N")
    fan.set_theta_direction(-1)
    fan.set_thetamin(-90)
    fan.set_thetamax(90)
    shade = fan.scatter([np.deg2rad(p["azimuth_deg"]) for p in points], [p["distance_m"] for p in points],
                        c=[p["level_db"] for p in points], cmap="magma", s=[90 if p["seen"] else 25 for p in points],
                        edgecolors="#8a93a3", linewidths=0.4)
    fan.set_ylim(0.0, 1.15 * max(p["distance_m"] for p in points))
    fan.set_title("echo of the pole, dB re 20 000; small: not seen", fontsize=10)
    figure.colorbar(shade, ax=fan, shrink=0.7, pad=0.09)
    lines = figure.add_subplot(1, 2, 2)
    for distance, row in result["pattern_db"].items():
        lines.plot([float(a) for a in row], list(row.values()), marker="o", markersize=4, label=f"{distance} m")
    lines.axhline(-6.0, color="#8a93a3", linestyle="--", linewidth=1.0)
    lines.set_xlabel("azimuth, degrees (right positive)")
    lines.set_ylabel("dB re straight ahead, two way")
    lines.grid(alpha=0.25)
    lines.spines[["top", "right"]].set_visible(False)
    lines.legend(fontsize=9, frameon=False)
    return svg_text(figure)
