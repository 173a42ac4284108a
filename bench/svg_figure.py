"""Figures of the pages: plain axes, and SVG that is the same bytes for the same data."""

import io
from collections.abc import Iterable
from typing import Any


def plain_axes(axes: Iterable[Any]) -> None:
    """A light grid, no frame at top and right, small numbers."""
    for one in axes:
        one.grid(alpha=0.25)
        one.spines[["top", "right"]].set_visible(False)
        one.tick_params(labelsize=9)


def svg_text(figure: Any) -> str:
    """The figure as SVG, from its <svg> tag on."""
    import matplotlib as mpl

    file = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "saranga-bench", "font.family": "sans-serif"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    return text[text.index("<svg"):]
