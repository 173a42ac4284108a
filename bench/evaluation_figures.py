"""Figures of a comparison of denoisers (`python -m saranga evaluate`), as SVG text: curves and example images."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.svg_figure import plain_axes, svg_text

RANGE_M = 1.66
FIRST = ("saranga", "tbd", "tv-l1", "tv-l1-sg", "gaussian", "tdlms")
COLOURS = {"saranga": "#d1495b", "tbd": "#00798c", "tv-l1": "#6a4c93", "tv-l1-sg": "#b08cf0", "gaussian": "#e0902f",
           "tdlms": "#6b8e23", "nothing": "#8a8f98"}
OTHER_COLOURS = ("#30638e", "#9c6644", "#3d405b", "#2a9d8f", "#c77dff", "#577590")
KIND_TITLES = {"constant": "one obstacle of constant strength", "single": "one obstacle",
               "multiple": "two to four obstacles"}


def ordered(names: Sequence[str]) -> list[str]:
    """Methods in the order they are shown in."""
    return sorted(names, key=lambda n: (FIRST.index(n) if n in FIRST else len(FIRST), n))


def colours(names: Sequence[str]) -> dict[str, str]:
    """A colour a method, the same in every figure."""
    others = iter(OTHER_COLOURS * (1 + len(names) // len(OTHER_COLOURS)))
    return {name: COLOURS.get(name) or next(others) for name in ordered(names)}


def rate_curves(tree: Mapping[str, Any], key: str) -> str:
    """Hit rate (`key` of a set's scores) against PSNR, a panel a set, with 95 % bands."""
    kinds = _kinds(tree)
    figure, panels = _figure(len(kinds), (4.6 * len(kinds), 3.9))
    tint = colours(list(tree["methods"]))
    for axes, kind in zip(panels, kinds, strict=True):
        for name in ordered(list(tree["methods"])):
            psnr, rate, low, high = _curve(tree["methods"][name]["sets"].get(kind, {}), key)
            axes.fill_between(psnr, low, high, color=tint[name], alpha=0.13, linewidth=0)
            axes.plot(psnr, rate, color=tint[name], label=name, linewidth=2.6 if name == "saranga" else 1.6,
                      marker="o", markersize=3.5)
        axes.set_title(KIND_TITLES.get(kind, kind), fontsize=11)
        axes.set_xlabel("PSNR, dB")
        axes.set_ylim(-0.02, 1.03)
    panels[0].set_ylabel("hits within 5 cm")
    panels[0].legend(fontsize=8.5, frameon=False, loc="lower right")
    return svg_text(figure)


def paper_curves(tree: Mapping[str, Any], kind: str) -> str:
    """The paper's Fig. 8: MSE, SSIM and position RMSE against PSNR, with the row of nothing beside them."""
    every = {**tree["methods"], **tree["baseline"]}
    measures = (("mse", "MSE of the newest row", 1e3, "x 10⁻³"), ("ssim", "SSIM of the newest row", 1.0, ""),
                ("position_rmse_m", "position RMSE", 1.0, "m"))
    figure, panels = _figure(3, (13.8, 3.7))
    tint = colours(list(every))
    for axes, (key, title, times, unit) in zip(panels, measures, strict=True):
        for name in ordered(list(every)):
            points = {p: s for p, s in every[name]["sets"].get(kind, {}).items() if s.get(key) is not None}
            psnr = sorted(points, key=float)
            axes.plot([float(p) for p in psnr], [times * points[p][key] for p in psnr], color=tint[name], label=name,
                      linestyle="--" if name in tree["baseline"] else "-", linewidth=1.8)
        axes.set_title(f"{title}{f', {unit}' if unit else ''}", fontsize=11)
        axes.set_xlabel("PSNR, dB")
    panels[1].legend(fontsize=8.5, frameon=False)
    return svg_text(figure)


def cost(tree: Mapping[str, Any], kind: str, psnr: str) -> str:
    """Time an image against hit rate at equal false alarms at one PSNR."""
    figure, (axes,) = _figure(1, (6.4, 3.9))
    tint = colours(list(tree["methods"]))
    for name in ordered(list(tree["methods"])):
        method = tree["methods"][name]
        score = method["sets"].get(kind, {}).get(psnr)
        if score is None or method["ms_per_image"] is None:
            continue
        rate, (low, high) = score["hit_rate_equal_false_alarms"], score["hit_rate_equal_false_alarms_interval"]
        axes.errorbar(method["ms_per_image"], rate, yerr=[[rate - low], [high - rate]], fmt="o", color=tint[name],
                      capsize=3)
        axes.annotate(f" {name}", (method["ms_per_image"], rate), fontsize=9, va="center", color=tint[name],
                      xytext=(5, 0), textcoords="offset points")
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.set_xlim(low, high * 2.2)
    axes.set_ylim(-0.02, 1.03)
    axes.set_xlabel("ms an image, one thread, median")
    axes.set_ylabel(f"hits within 5 cm at {psnr} dB")
    return svg_text(figure)


def example(image: NDArray[np.float32], edges: NDArray[np.float32], methods: Sequence[str],
            thresholds: NDArray[np.float64], offsets_m: NDArray[np.float64], truth_m: NDArray[np.float64]) -> str:
    """One image with its true ranges, and under it every method's edge row: over its threshold bright, else pale."""
    shown = ordered([m for m in methods if m != "nothing"])
    figure, panels = _figure(1 + len(shown), (9.4, 2.0 + 0.36 * len(shown)), rows=True,
                             heights=[4.2, *[0.62] * len(shown)])
    tint = colours(shown)
    top = float(np.quantile(image, 0.998)) or 1.0
    panels[0].imshow(image, aspect="auto", cmap="magma", vmin=0.0, vmax=top, extent=(0.0, RANGE_M, 0.0, len(image)),
                     interpolation="nearest", origin="upper")
    panels[0].set_yticks([0.5, len(image) - 0.5], ["newest", "oldest"], fontsize=8)
    for range_m in truth_m[~np.isnan(truth_m)]:
        panels[0].axvline(range_m, color="#7fffd4", linewidth=1.0, linestyle=":")
    columns_m = np.arange(edges.shape[1]) * RANGE_M / edges.shape[1]
    for axes, name in zip(panels[1:], shown, strict=True):
        k = list(methods).index(name)
        row, over = edges[k], edges[k] > thresholds[k]
        at = columns_m - offsets_m[k]
        weak = (row > 0.02) & ~over
        axes.vlines(at[weak], 0.0, row[weak], color=tint[name], alpha=0.3, linewidth=1.2)
        axes.vlines(at[over], 0.0, row[over], color=tint[name], linewidth=2.4)
        for range_m in truth_m[~np.isnan(truth_m)]:
            axes.axvspan(range_m - 0.05, range_m + 0.05, color="#2fae6b", alpha=0.16, linewidth=0)
        axes.set_ylim(0.0, 1.05)
        axes.set_yticks([0.5], [name], fontsize=8.5)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False)
    for axes in panels:
        axes.set_xlim(0.0, RANGE_M)
    for axes in panels[:-1]:
        axes.set_xticklabels([])
    panels[-1].set_xlabel("range, m")
    return svg_text(figure)


def _kinds(tree: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys(kind for m in tree["methods"].values() for kind in m["sets"]))


def _curve(points: Mapping[str, Any], key: str) -> tuple[list[float], ...]:
    psnr = sorted((p for p, s in points.items() if s.get(key) is not None), key=float)
    scores = [points[p] for p in psnr]
    bands = [s[f"{key}_interval"] for s in scores]
    return ([float(p) for p in psnr], [s[key] for s in scores],
            [s[key] if b[0] is None else b[0] for s, b in zip(scores, bands, strict=True)],
            [s[key] if b[1] is None else b[1] for s, b in zip(scores, bands, strict=True)])


def _figure(panels: int, size: tuple[float, float], rows: bool = False,
            heights: Sequence[float] | None = None) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(panels if rows else 1, 1 if rows else panels, squeeze=False,
                           gridspec_kw={"height_ratios": heights} if heights else None)
    axes = list(grid.ravel())
    plain_axes(axes)
    return figure, axes
