"""From a checkpoint to what ships in `fixtures/models`: weights, and the metadata they are never used without.

The threshold is calibrated on frames of noise and of clutter, the edge offset on loud single obstacles; both on the
int8 network as it flies, on other scenes than any it was trained on or is compared on.
"""

import hashlib
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from saranga.denoise import load_denoiser
from saranga.errors import UsageError
from saranga.evaluation.answering import answers
from saranga.evaluation.calibration import equal_rate_threshold
from saranga.evaluation.detections import strongest_range, truth_of
from saranga.evaluation.measures import score_rows
from saranga.evaluation.report import processor
from saranga.evaluation.sets import pair_set
from saranga.input_kinds import MADE

CALIBRATION_SEED = 4_001
METRICS_SEED = 4_002
FALSE_A_FRAME = 0.008
"""Of noise and clutter together, under the 0.01 that all methods are compared at."""
PSNRS_DB = (15.0, 10.0, 5.0, 0.0, -4.9)
_LOUD_DB = 15.0
_FAR_M = 0.1


def publish(checkpoint: Path, folder: Path, images: int, say: Callable[[str], None],
            tflite: Path | None = None) -> Path:
    """Write NAME.onnx, NAME-int8.onnx and NAME.json to `folder`; returns the metadata's path.

    Args:
        images: scenes a point of the metrics; the calibration takes four times as many frames.
        tflite: a full-integer network exported from the same checkpoint, to be listed with the others.

    Raises:
        UsageError: no checkpoint of the training, or a file that exists.
    """
    from saranga.export import onnx_from_module, source_kind
    from saranga.network import load_checkpoint, parameter_count, read_checkpoint
    from saranga.quantise import calibration_inputs, quantised

    content = read_checkpoint(checkpoint)
    recipe = content["recipe"]
    name = recipe["network"]["name"]
    files = {"fp32": folder / f"{name}.onnx", "int8": folder / f"{name}-int8.onnx"}
    if tflite is not None:
        files["tflite"] = folder / f"{name}.tflite"
    target = folder / f"{name}.json"
    for path in (*files.values(), target):
        if path.exists():
            raise UsageError(f"{path} exists: networks are never overwritten; choose another folder")
    say("exporting and quantising")
    network = load_checkpoint(checkpoint)
    fp32 = onnx_from_module(network)
    data = {"fp32": fp32, "int8": quantised(fp32, calibration_inputs(source_kind(fp32, checkpoint)))}
    if tflite is not None:
        data["tflite"] = tflite.read_bytes()
    metadata: dict[str, Any] = {
        "name": name, "architecture": content["architecture"], "parameters": parameter_count(network),
        "threshold": 0.5, "edge_offset_m": 0.0, "input": MADE[source_kind(fp32, checkpoint)],
        "files": {k: {"file": files[k].name, "sha256": hashlib.sha256(d).hexdigest(), "bytes": len(d)}
                  for k, d in data.items()},
    }
    with tempfile.TemporaryDirectory(prefix="saranga-publish-") as scratch:
        draft = _write(Path(scratch), target.name, metadata, files, data)
        metadata |= _calibrated(str(draft), images, say)
        draft = _write(Path(scratch), target.name, metadata, files, data)
        metadata["metrics"] = {p: _metrics(str(draft), p, images, say) for p in ("fp32", "int8")}
    metadata["training"] = {
        "recipe": recipe, "recipe_sha256": content["recipe_sha256"], "seed": recipe["data"]["seed"],
        "images_seen": content["state"]["images"], "started_from": content["state"].get("started_from"),
        "seconds": round(content["state"]["elapsed_s"]),
        "last_loss": content["state"]["loss"], "made_by": content["made_by"], "hardware": hardware(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    return _write(folder, target.name, metadata, files, data)


def hardware() -> str:
    """Processor, count and architecture of this machine."""
    return f"{os.cpu_count()} CPUs, {processor() or platform.processor()} ({platform.machine()})"


def _write(folder: Path, name: str, metadata: dict[str, Any], files: dict[str, Path], data: dict[str, bytes]) -> Path:
    for kind, content in data.items():
        (folder / files[kind].name).write_bytes(content)
    path = folder / name
    path.write_text(json.dumps(metadata, indent=1) + "\n", encoding="utf-8")
    return path


def _calibrated(draft: str, images: int, say: Callable[[str], None]) -> dict[str, float]:
    denoiser = load_denoiser("saranga", weights=draft)
    say("calibrating the edge offset")
    loud = pair_set("single", images, _LOUD_DB, CALIBRATION_SEED)
    found = answers({"saranga": denoiser}, loud)["saranga"]
    error_m = (np.array([strongest_range(row, 0.0) for row in found.rows[:, 0]])
               - truth_of(found.truth, -np.inf).range_m[:, 0])
    offset_m = float(np.median(error_m[np.abs(error_m) < _FAR_M]))
    say("calibrating the threshold")
    frames = 4 * images
    parts = []
    for kind in ("noise", "clutter"):
        one = answers({"saranga": denoiser}, pair_set(kind, frames, seed=CALIBRATION_SEED))["saranga"]
        parts.append((one.rows[:, 0], truth_of(one.truth, -np.inf)))
    return {"threshold": round(equal_rate_threshold(parts, offset_m, FALSE_A_FRAME), 4),
            "edge_offset_m": round(offset_m, 5)}


def _metrics(draft: str, precision: str, images: int, say: Callable[[str], None]) -> dict[str, Any]:
    denoiser = load_denoiser("saranga", weights=draft, precision=precision)
    out: dict[str, Any] = {"images_a_point": images, "set_seed": METRICS_SEED}
    for kind in ("constant", "single"):
        for psnr_db in PSNRS_DB:
            say(f"measuring {precision}: {kind} {psnr_db:g} dB")
            pairs = pair_set(kind, images, psnr_db, METRICS_SEED)
            score = score_rows(answers({"saranga": denoiser}, pairs)["saranga"], pairs, denoiser.threshold,
                               denoiser.edge_offset_m)
            out.setdefault(kind, {})[f"{psnr_db:g}"] = {
                "hit_rate": round(score.hit_rate, 4), "hit_rate_strongest": round(score.hit_rate_strongest, 4),
                "false_alarms_per_frame": round(score.false_alarms_per_frame, 4)}
    return out


def say_on_stderr(line: str) -> None:
    """Progress for a person."""
    print(line, file=sys.stderr, flush=True)
