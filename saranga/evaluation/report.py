"""The comparison as the JSON object of `python -m saranga evaluate --json`, and its files."""

import json
import math
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from saranga.evaluation import intervals
from saranga.evaluation.calibration import FALSE_A_FRAME
from saranga.evaluation.comparison import Comparison, MethodResult
from saranga.evaluation.detections import HIT_M, MATCH_COLUMNS
from saranga.evaluation.positions import EMPTY_RANGE_M
from saranga.evaluation.power import Energy
from saranga.evaluation.sets import QUADRATURE_DB

PRIMARY = "constant"
"""The set that the first keys of a method are of: the one behind the figures asked of the network."""
BASELINE = "nothing"
PACKAGES = ("numpy", "numba", "scipy", "onnxruntime", "openvino", "torch", "ai-edge-litert")
DEFINITIONS = {
    "hit": f"an edge of the newest row within {HIT_M:g} m of an obstacle's range",
    "hit_rate": "obstacles with an edge over the denoiser's own threshold: what flies",
    "hit_rate_strongest": "images whose strongest edge, whatever its strength, is at an obstacle",
    "hit_rate_equal_false_alarms": f"as hit_rate at the threshold with {FALSE_A_FRAME:g} false edges a frame in noise "
                                   "and clutter frames",
    "false_alarms_per_frame": f"edges over the own threshold farther than {HIT_M:g} m from every obstacle; at the top "
                              "level in frames of noise alone, in sets in frames with obstacles",
    "f1": f"edges and obstacles paired one to one within {MATCH_COLUMNS:g} columns (f1_within_5cm: {HIT_M:g} m), "
          "default recipe, PSNR -8 to 18 dB, own threshold",
    "median_error_m": f"of hits at the own threshold; at the top level pooled over all PSNRs of the set {PRIMARY!r}",
    "rmse_m": "conditional: of hits alone",
    "position_rmse_m": "two sensors, strongest left edge over the own threshold; an empty answer counts as an obstacle "
                       f"{EMPTY_RANGE_M:g} m straight ahead, the best that can be said without looking",
    "mse, ssim": "newest row against its label after the offset; a row of zeros scores well: see baseline.nothing",
    "azimuth": "of matched hits; true azimuth is what a horizontal pair can see, asin(cos(elevation) sin(azimuth))",
    "intervals": "95 %: Wilson for rates, Poisson for counts, order statistics for medians, bootstrap for the rest",
}


def comparison_json(comparison: Comparison, complete: bool, skipped: Mapping[str, str],
                    energy: Mapping[str, Energy] | None = None) -> dict[str, Any]:
    """Plain numbers, texts, lists and objects; null where nothing was measured."""
    methods = {name: _method(result, (energy or {}).get(name)) for name, result in comparison.results.items()}
    baseline = {BASELINE: methods.pop(BASELINE)} if BASELINE in methods else {}
    done = {(pairs.kind, pairs.psnr_db): pairs for pairs in comparison.finished}
    return plain({
        "methods": methods, "baseline": baseline, "skipped": dict(skipped), "complete": complete,
        "primary_set": PRIMARY, "definitions": DEFINITIONS, "psnr": _conventions(comparison),
        "sets": [{"kind": kind, "psnr_db": psnr, "images": pairs.count, "roles": list(pairs.roles),
                  "description": pairs.description, "recipe_sha256": pairs.recipe.sha256}
                 for (kind, psnr), pairs in done.items()],
        "provenance": {"seed": comparison.seed, "images": comparison.images, **machine(comparison.denoisers)},
    })


def machine(denoisers: Mapping[str, Any]) -> dict[str, Any]:
    """Where figures were taken, and with which weights."""
    return {"machine": platform.machine(), "processor": processor(), "cpus": os.cpu_count(),
            "python": platform.python_version(), "packages": _versions(),
            "weights_sha256": {name: d.weights_sha256 for name, d in denoisers.items()
                               if getattr(d, "weights_sha256", None)}}


def plain(value: Any) -> Any:
    """As JSON has it: numbers that are not finite become null, PSNR keys "-4.9", floats 6 significant digits."""
    if isinstance(value, Mapping):
        return {f"{k:g}" if isinstance(k, float) else str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.6g}") if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def write_json(path: Path, tree: dict[str, Any]) -> None:
    """Whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(tree, indent=1, allow_nan=False) + "\n")
    part.replace(path)


def write_examples(path: Path, comparison: Comparison) -> None:
    """Example images (E, 32, 512), `edges` (E, methods, 512), `truth_range_m` (E, 4) and what they are."""
    if not comparison.examples:
        return
    names = list(comparison.results)
    examples = comparison.examples
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        np.savez_compressed(
            file, images=np.stack([e["image"] for e in examples]), methods=np.array(names),
            edges=np.stack([[e["edges"][name] for name in names] for e in examples]),
            thresholds=np.array([comparison.results[name].threshold for name in names]),
            offsets_m=np.array([comparison.results[name].edge_offset_m for name in names]),
            truth_range_m=np.stack([e["truth_range_m"] for e in examples]),
            kind=np.array([e["kind"] for e in examples]), psnr_db=np.array([e["psnr_db"] for e in examples]))
    part.replace(path)


def _method(result: MethodResult, energy: Energy | None) -> dict[str, Any]:
    points = result.points.get(PRIMARY, {})
    errors = np.abs(np.concatenate(result.errors_m.get(PRIMARY, []) or [np.zeros(0)]))
    seconds = np.concatenate(result.seconds or [np.zeros(0)])
    named = ("hit_rate", "hit_rate_strongest", "hit_rate_equal_false_alarms")
    tree: dict[str, Any] = {key: {psnr: getattr(s, key) for psnr, s in points.items()}
                            for name in named for key in (name, f"{name}_interval")}
    tree |= {key: getattr(result, key) for key in (
        "false_alarms_per_frame", "false_alarms_interval", "f1", "f1_interval", "f1_within_5cm",
        "f1_within_5cm_interval", "threshold", "edge_offset_m", "equal_threshold", "equal_false_alarms_per_frame")}
    tree |= {
        "median_error_m": float(np.median(errors)) if errors.size else None,
        "median_error_interval_m": intervals.median(errors),
        "ms_per_image": 1e3 * float(np.median(seconds)) if seconds.size else None,
        "ms_p99": 1e3 * float(np.quantile(seconds, 0.99)) if seconds.size else None,
        "sets": {kind: {psnr: asdict(s) for psnr, s in by_psnr.items()} for kind, by_psnr in result.points.items()},
    }
    if energy is not None:
        tree["energy"] = asdict(energy)
        tree["energy_mj_per_image"] = energy.net_mj
    return tree


def _conventions(comparison: Comparison) -> dict[str, Any]:
    return {
        "used": "20 log10(peak of the strongest echo in the newest cycle / RMS |IQ| of the noise); the RMS of the "
                "amplitudes |IQ| is the same number",
        "over_one_quadrature_db": QUADRATURE_DB,
        "over_one_quadrature": "added to the PSNR when the noise is the RMS of one quadrature, or of a real record",
        "image_peak": "psnr_image_db: median over the scenes with the peak of all cycles in place of the newest",
        "psnr_image_db": comparison.psnr_image_db,
        "paper": "says 'RMS of the received signal amplitudes' and neither which amplitude nor whose peak: its -4.9 dB "
                 f"is -4.9 here if |IQ| was meant, {-4.9 - QUADRATURE_DB:.1f} if one quadrature",
    }


def _versions() -> dict[str, str]:
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def processor() -> str:
    """Model name of the processor, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
