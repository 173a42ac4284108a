"""The page of a sweep or of a comparison of shields: one HTML file that needs nothing else."""

import json
from pathlib import Path
from typing import Any

from bench.page import write_page_file
from bench.procedures import sweep_figures as figures
from bench.procedures.sweep_session import SUMMARY_FILE, rebuild_sweep
from bench.procedures.sweep_text import loss_text

PAGE = "report.html"
PANELS = {
    "material": "Fig. 6 D: material at constant width and height (the paper: hardly any difference)",
    "width_m": "Fig. 6 E and G: width",
    "height_m": "Fig. 6 F: height (the paper: 63.5 mm is the lowest with most of the reduction)",
    "propeller": "Fig. 6 C: propellers without a shield (the paper: larger ones are quieter at equal thrust)",
}
CLAIMS = {
    "material": "transmission through any of them is far below what goes around the edges",
    "height_m": "below 63.5 mm each step gains, above hardly any",
    "width_m": "wider than 88.9 mm gains hardly any",
    "propeller": "at equal thrust the larger propeller is quieter",
}


def write_sweep_page(folder: Path, summary: dict[str, Any] | None = None, name: str = PAGE) -> Path:
    """Write the page beside the journal; without a summary it is rebuilt from the journal first.

    Raises:
        UsageError: no sweep there. BenchError: the page cannot be written.
    """
    tree = summary if summary is not None else rebuild_sweep(folder)
    tree = json.loads(json.dumps(tree, default=str))
    return write_page_file(
        folder / name, "sweep_page.html.j2",
        {"number": _number, "span": _span, "percent": _percent, "loss": loss_text},
        tree=tree, colours=figures.colours(tree), noise=figures.noise_over_thrust(tree),
        losses=figures.loss_over_thrust(tree), differences=figures.differences(tree), spectra=figures.spectra(tree),
        quality=figures.quality(tree), paper=paper_panels(tree))


def paper_panels(tree: dict[str, Any]) -> list[dict[str, str]]:
    """Which panels of the paper's Fig. 6 this sweep covers, what the paper says there, and what was found here."""
    found = []
    conditions = [c for c in tree["conditions"] if not c["reference"]]
    for key, title in PANELS.items():
        values = {c[key] for c in conditions if c[key]}
        if len(values) < 2:
            continue
        if key == "height_m" and tree["optimum_height"]:
            ours = tree["optimum_height"]["sentence"]
        else:
            ours = "; ".join(c["sentence"] for c in tree["comparisons"]) or "nothing to compare"
        found.append({"title": title, "paper": CLAIMS[key], "ours": ours})
    return found


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _span(interval: list[float] | None, digits: int = 2) -> str:
    return "" if interval is None else f"{interval[0]:.{digits}f} to {interval[1]:.{digits}f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


__all__ = ["PAGE", "SUMMARY_FILE", "paper_panels", "write_sweep_page"]
