"""The comparison and the recording as text for a person."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

LEGEND = """\
Cells: per cent of obstacles hit within 5 cm in the newest row, by
  an edge over the denoiser's own threshold / the strongest edge / an edge at 0.01 false edges a frame.
PSNR: peak of the strongest echo in the newest cycle over RMS |IQ|; over one quadrature add 3.01 dB."""
AT_DB = 5.0


def comparison_text(tree: Mapping[str, Any]) -> str:
    """Tables of `comparison_json`."""
    return "\n".join(_comparison_lines(tree))


def recording_text(tree: Mapping[str, Any]) -> str:
    """Table of `recording_json`."""
    recording, truth = tree["recording"], tree["truth"]
    lines = [f"{recording['file']}, sensor {recording['role']}: {recording['evaluated']} of {recording['frames']} "
             f"frames ({recording['repeated_left_out']} repeated and {recording['before_take_off_left_out']} from "
             "before take-off left out)",
             f"lost: {recording['losses']}",
             f"obstacle at {truth['range_m']:.3f} m ({truth['source']}), +-{truth['tolerance_m']:g} m; mean peak "
             f"{_number(truth['peak_over_noise_db'], 1)} dB over the noise at {truth['consensus_m']:.3f} m"]
    lines.append(f"nothing nearer than {truth['ring_down_m']:.3f} m is evaluated: ringing, or cancelled by the sensor")
    if recording["amplitude_only"]:
        lines.append("amplitudes without phase: nothing can be filtered coherently")
    head = ("", "hit %", "95 %", "strongest %", "at 10 dB %", "false/frame", "95 %", "in 1.66 m", "median error mm",
            "bias mm", "ms/frame")
    rows = [(name, _percent(m["hit_rate"]), _span(m["hit_rate_interval"], 100), _percent(m["hit_rate_strongest"]),
             f"{_percent(m['hit_rate_clear'])} of {m['clear_frames']}",
             _number(m["false_alarms_per_frame"], 2), _span(m["false_alarms_interval"], 1, 2),
             _number(m["false_alarms_per_window"], 2), _number(m["median_error_m"], 0, 1e3),
             _number(m["bias_m"], 0, 1e3), _number(m["ms_per_image"], 2)) for name, m in tree["methods"].items()]
    return "\n".join([*lines, "", *_aligned([head, *rows]), *_notes(tree)])


def _comparison_lines(tree: Mapping[str, Any]) -> Iterator[str]:
    every = {**tree["methods"], **tree["baseline"]}
    yield LEGEND
    for kind in dict.fromkeys(kind for m in every.values() for kind in m["sets"]):
        psnrs = list(dict.fromkeys(p for m in every.values() for p in m["sets"].get(kind, {})))
        about = next(s for s in tree["sets"] if s["kind"] == kind)
        half = 100 * 0.98 / math.sqrt(about["images"])
        yield ""
        yield f"{kind}: {about['description']}; {about['images']} images a point (95 %: +-{half:.0f} at most)"
        rows = [(name, *(_cell(m["sets"].get(kind, {}).get(p)) for p in psnrs)) for name, m in every.items()]
        yield from _aligned([("PSNR dB", *psnrs), *rows])
    yield ""
    yield "false alarms a frame of noise; F1 within 2 columns (5 cm), PSNR -8..18 dB; errors of hits, PSNR pooled"
    head = ("", "false/frame", "95 %", "F1", "95 %", "F1 5 cm", "median error mm", "ms/image", "p99", "mJ")
    yield from _aligned([head, *((
        name, _number(m["false_alarms_per_frame"], 3), _span(m["false_alarms_interval"], 1, 3), _number(m["f1"], 3),
        _span(m["f1_interval"], 1, 3), _number(m["f1_within_5cm"], 3), _number(m["median_error_m"], 1, 1e3),
        _number(m["ms_per_image"], 2), _number(m["ms_p99"], 2), _number(m.get("energy_mj_per_image"), 2))
        for name, m in every.items())])
    yield from _at_one_psnr(every)
    yield from _notes(tree)


def _at_one_psnr(every: Mapping[str, Any]) -> Iterator[str]:
    known = [float(p) for m in every.values() for p in m["sets"].get("single", {})]
    if not known:
        return
    at = min(known, key=lambda p: abs(p - AT_DB))
    yield ""
    yield (f"single at {at:g} dB: conditional RMSE of hits; position RMSE (an empty answer is 0.9 m ahead); azimuth of "
           "matched hits; newest row against label (nothing scores well)")
    head = ("", "RMSE mm", "position RMSE m", "azimuth deg", ">10 deg %", "MSE x1000", "SSIM", "false/frame")
    rows = []
    for name, m in every.items():
        s = m["sets"].get("single", {}).get(f"{at:g}")
        if s is not None:
            azimuth = s["azimuth"].get("one_to_one", {})
            rows.append((name, _number(s["rmse_m"], 1, 1e3), _number(s["position_rmse_m"], 3),
                         _number(azimuth.get("median_deg"), 1), _percent(azimuth.get("wide_share")),
                         _number(s["mse"], 2, 1e3), _number(s["ssim"], 3), _number(s["false_alarms_per_frame"], 3)))
    yield from _aligned([head, *rows])


def _notes(tree: Mapping[str, Any]) -> Iterator[str]:
    if tree["skipped"]:
        yield ""
    for name, reason in tree["skipped"].items():
        yield f"skipped {name}: {reason}"
    if not tree["complete"]:
        yield ""
        yield "INTERRUPTED: only what had been finished is shown"


def _cell(score: Mapping[str, Any] | None) -> str:
    if score is None:
        return "-"
    return "/".join(_percent(score[k]) for k in ("hit_rate", "hit_rate_strongest", "hit_rate_equal_false_alarms"))


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f}"


def _number(value: float | None, digits: int, times: float = 1.0) -> str:
    return "-" if value is None else f"{times * value:.{digits}f}"


def _span(interval: Sequence[float | None], times: float, digits: int = 0) -> str:
    low, high = interval
    return "-" if low is None or high is None else f"{times * low:.{digits}f}..{times * high:.{digits}f}"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(text.ljust(w) if k == 0 else text.rjust(w)
                      for k, (text, w) in enumerate(zip(row, widths, strict=True))).rstrip() for row in rows]
