"""Figures of a sweep as SVG text: noise over thrust with fits and bands, losses, spectra, drift and mounting."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.procedures.hover import READINGS_KGF, STANDARD_GRAVITY_M_S2
from bench.svg_figure import plain_axes, svg_text

COLOURS = ("#00798c", "#d1495b", "#e0902f", "#6a4c93", "#6b8e23", "#30638e", "#9c6644", "#c77dff")
REFERENCE_COLOUR = "#3d4657"
BACKGROUND_COLOUR = "#9aa3b2"
BLOCK_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
NEED_DB = {"1 m to 2 m, flat": 9.5, "1 m to 2 m, 60 mm pole": 12.5}
"""acoustics.md, "Shield"."""


def colours(summary: dict[str, Any]) -> dict[str, str]:
    """A colour a condition, the reference dark."""
    others = iter(COLOURS * 4)
    return {c["name"]: REFERENCE_COLOUR if c["name"] == summary["reference"] else next(others)
            for c in summary["conditions"]}


def noise_over_thrust(summary: dict[str, Any]) -> str:
    """The paper's Fig. 6: RMS / 20 000 over thrust, the quadratic fit as the paper on the left, and the same points in
    dB with the power law on the right, bands from the blocks."""
    figure, (linear, log) = _figure(2, (13.4, 4.9))
    tint = colours(summary)
    for axes, kind, scale in ((linear, "quadratic", lambda v: v), (log, "power_law", _db)):
        for name, colour in tint.items():
            curve = summary["curves"].get(name, {})
            fit = curve.get(kind)
            kgf = np.asarray(curve.get("thrust_n", [])) / STANDARD_GRAVITY_M_S2
            if fit:
                axes.plot(kgf, scale(np.asarray(fit["rms"])), color=colour, linewidth=1.8)
                if fit["low"]:
                    axes.fill_between(kgf, scale(np.asarray(fit["low"])), scale(np.asarray(fit["high"])), color=colour,
                                      alpha=0.16, linewidth=0)
            _scatter(axes, summary, name, colour, scale)
            axes.plot([], [], color=colour, linewidth=2.2, label=name)
        _hover_marks(axes, summary)
        axes.set_xlabel("thrust of one motor, kgf")
    linear.set_ylabel("RMS |IQ| / 20 000")
    linear.set_title("quadratic fit, as the paper (Fig. 6)", fontsize=10.5)
    linear.set_ylim(bottom=0.0)
    linear.legend(fontsize=9, frameon=False, loc="upper left")
    log.set_ylabel("dB re 20 000")
    log.set_title("the same points in dB, power law", fontsize=10.5)
    return svg_text(figure)


def loss_over_thrust(summary: dict[str, Any]) -> str:
    """Insertion loss at equal thrust with its interval, and each shield's quoted value."""
    known = {n: x for n, x in summary["insertion_loss_db"].items() if x["value"] is not None}
    if not known:
        return ""
    figure, (curve, bars) = _figure(2, (13.4, 4.3), widths=(1.6, 1.0))
    tint = colours(summary)
    for name, loss in known.items():
        kgf = np.asarray(loss["thrust_n"]) / STANDARD_GRAVITY_M_S2
        curve.plot(kgf, loss["at"], color=tint[name], linewidth=2.0, label=name)
        if all(v is not None for v in loss["low"]):
            curve.fill_between(kgf, loss["low"], loss["high"], color=tint[name], alpha=0.14, linewidth=0)
    curve.axvline(summary["target_kgf"], color="#8a93a3", linewidth=1.0, linestyle=":")
    curve.set_xlabel("thrust of one motor, kgf")
    curve.set_ylabel("insertion loss, dB")
    curve.legend(fontsize=9, frameon=False)
    names = list(known)
    for k, name in enumerate(names):
        loss = known[name]
        low, high = loss["interval"] or (loss["value"], loss["value"])
        bars.errorbar(loss["value"], k, xerr=[[loss["value"] - low], [high - loss["value"]]], fmt="o", capsize=5,
                      color=tint[name], markersize=7, linewidth=2.0)
        for b, value in enumerate(loss["per_block"].values()):
            bars.plot(value, k + 0.22, marker=BLOCK_MARKERS[b % len(BLOCK_MARKERS)], color=tint[name], alpha=0.55,
                      markersize=4.5, linestyle="none")
    for text, need in NEED_DB.items():
        bars.axvline(need, color="#8a93a3", linewidth=1.0, linestyle="--")
        bars.text(need, 0.98, f"{text} ", transform=bars.get_xaxis_transform(), fontsize=7.5, color="#5a6678",
                  rotation=90, va="top", ha="right")
    bars.set_yticks(range(len(names)), names)
    bars.set_ylim(len(names) - 0.4, -0.6)
    bars.set_xlabel(f"dB at {summary['target_kgf']:g} kgf, 95 %; small: blocks")
    return svg_text(figure)


def differences(summary: dict[str, Any]) -> str:
    """Paired differences of every two conditions with intervals; the band of "equal within 1 dB" shaded."""
    pairs = summary["comparisons"]
    if not pairs:
        return ""
    figure, (axes,) = _figure(1, (9.5, 1.3 + 0.42 * len(pairs)))
    axes.axvspan(-1.0, 1.0, color="#2fae6b", alpha=0.12, linewidth=0)
    axes.axvline(0.0, color="#8a93a3", linewidth=1.0)
    shades = {"quieter": "#00798c", "louder": "#d1495b", "equal": "#2fae6b", "cannot distinguish": "#8a6d1a"}
    for k, pair in enumerate(pairs):
        low, high = pair["interval"] or (pair["value"], pair["value"])
        axes.errorbar(pair["value"], k, xerr=[[pair["value"] - low], [high - pair["value"]]], fmt="o", capsize=5,
                      color=shades[pair["answer"]], linewidth=2.0)
        axes.annotate(pair["answer"], (high, k), xytext=(8, 0), textcoords="offset points", fontsize=9, va="center",
                      color=shades[pair["answer"]])
    axes.set_yticks(range(len(pairs)), [f"{p['one']} over {p['other']}" for p in pairs])
    axes.set_ylim(len(pairs) - 0.5, -0.5)
    low, high = axes.get_xlim()
    axes.set_xlim(low, high + 0.28 * (high - low))
    axes.set_xlabel("dB quieter at equal thrust (95 %, paired within blocks)")
    return svg_text(figure)


def spectra(summary: dict[str, Any]) -> str:
    """Noise spectra around the carrier and the correlation of neighbouring samples."""
    found = summary["spectra"]
    if not found:
        return ""
    figure, (left, right) = _figure(2, (13.4, 3.9), widths=(1.7, 1.0))
    tint = {**colours(summary), "background": BACKGROUND_COLOUR}
    for name, s in found.items():
        power = np.asarray(s["power"])
        khz = (np.arange(power.size) / power.size - 0.5) * s["rate_hz"] / 1e3
        style = "--" if name == "background" else "-"
        left.plot(khz, 10.0 * np.log10(np.maximum(power / power.max(), 1e-6)), color=tint.get(name, "#555555"),
                  linewidth=1.8, linestyle=style, label=name)
        lags = [1.0, *s["correlation"]]
        right.plot(range(len(lags)), lags, color=tint.get(name, "#555555"), linewidth=1.8, linestyle=style, marker="o",
                   markersize=4)
    left.set_xlabel("kHz from the carrier")
    left.set_ylabel("dB re its peak")
    left.set_ylim(-45, 2)
    left.legend(fontsize=9, frameon=False, ncols=2)
    right.set_xlabel("lag, IQ samples")
    right.set_ylabel("|correlation| within a record")
    right.set_xticks(range(4))
    right.set_ylim(0.0, 1.05)
    return svg_text(figure)


def quality(summary: dict[str, Any]) -> str:
    """Over the steps in the order measured: margin over the background, clipping, and drift within blocks."""
    points = [p for p in summary["points"] if p["sensor"] == summary["sensor"]]
    if not points:
        return ""
    figure, (margin, clip, drift) = _figure(3, (13.4, 3.4))
    tint = colours(summary)
    for name, colour in tint.items():
        mine = [p for p in points if p["condition"] == name]
        at = [p["step"] for p in mine]
        margin.scatter(at, [p["margin_db"] if p["margin_db"] is not None else np.nan for p in mine], s=14, color=colour)
        clip.scatter(at, [100.0 * p["clipped_share"] for p in mine], s=14, color=colour)
    margin.axhspan(-5, 6, color="#d1495b", alpha=0.10, linewidth=0)
    margin.axhspan(6, 15, color="#e0902f", alpha=0.10, linewidth=0)
    margin.text(0.01, 6.2, "corrected", transform=margin.get_yaxis_transform(), fontsize=8, color="#9c6644",
                va="bottom")
    margin.text(0.01, 5.8, "only an upper bound", transform=margin.get_yaxis_transform(), fontsize=8, color="#a3303f",
                va="top")
    margin.set_ylim(bottom=min(0.0, *(p["margin_db"] for p in points if p["margin_db"] is not None), 0.0))
    margin.set_ylabel("dB over background")
    clip.set_ylabel("clipped samples, %")
    clip.set_ylim(bottom=-0.02)
    for axes in (margin, clip):
        axes.set_xlabel("step, as measured")
    blocks = list(summary["drift_db"])
    drift.bar([str(k + 1) for k in range(len(blocks))], [summary["drift_db"][b] for b in blocks],
              color=REFERENCE_COLOUR, width=0.5)
    drift.axhline(0.0, color="#8a93a3", linewidth=1.0)
    widest = max([0.6, *(abs(v) * 1.2 for v in summary["drift_db"].values())])
    drift.set_ylim(-widest, widest)
    drift.set_xlabel("block")
    drift.set_ylabel("drift of the reference, dB")
    return svg_text(figure)


def _scatter(axes: Any, summary: dict[str, Any], name: str, colour: str, scale: Any) -> None:
    """Usable points filled, bounds hollow; one marker a block."""
    blocks = sorted({p["block"] for p in summary["points"]})
    for k, block in enumerate(blocks):
        for usable in (True, False):
            mine = [p for p in summary["points"] if p["condition"] == name and p["block"] == block
                    and p["sensor"] == summary["sensor"] and p["usable"] == usable and p["noise_rms"] > 0.0
                    and p["phase"] != "drift"]
            if mine:
                axes.scatter([p["thrust_kgf"] for p in mine], scale(np.array([p["noise_rms"] for p in mine])), s=20,
                             marker=BLOCK_MARKERS[k % len(BLOCK_MARKERS)], zorder=3,
                             facecolors=colour if usable else "none", edgecolors=colour, linewidths=0.9)


def _hover_marks(axes: Any, summary: dict[str, Any]) -> None:
    most = max((p["thrust_kgf"] for p in summary["points"]), default=0.0)
    for reading, kgf in READINGS_KGF.items():
        if kgf <= 1.1 * most:
            axes.axvline(kgf, color="#8a93a3", linewidth=1.0, linestyle=":")
            axes.text(kgf, 0.98, f" hover, {reading.replace('_', ' ')}", transform=axes.get_xaxis_transform(),
                      fontsize=8, color="#5a6678", va="top", rotation=90, ha="right")


def _db(values: Any) -> Any:
    return 20.0 * np.log10(np.maximum(values, 1e-9))


def _figure(panels: int, size: tuple[float, float], widths: Sequence[float] | None = None) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(1, panels, squeeze=False, gridspec_kw={"width_ratios": widths} if widths else None)
    axes = list(grid.ravel())
    plain_axes(axes)
    return figure, axes


def finite(value: float | None) -> bool:
    """Whether it can be drawn."""
    return value is not None and math.isfinite(value)
