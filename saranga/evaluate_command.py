"""`python -m saranga evaluate`: denoisers side by side, on common synthetic sets or on a recording."""

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from saranga.errors import DeviceError, UsageError

HELP = """\
Compare denoisers (the paper's Fig. 8, mended): hit rate within 5 cm, false alarms, F1, errors, azimuth, MSE and SSIM,
run time, against PSNR, every one on the same images; or on a recording with an obstacle at a known range.

  python -m saranga evaluate
  python -m saranga evaluate --denoisers saranga,tbd --images 1000 --psnr 10,5,0 --json --out runs/compared
  python -m saranga evaluate --recording wall.mcap --truth-m 2.54 --tolerance-m 0.1
  python -m saranga evaluate --recording flight.csv --truth-m consensus --columns-m 0.0132

Recordings are .mcap of the rig, or logs that "saranga-bench rig import" knows. Ctrl-C keeps the sets that are
finished: they are printed, and written to --out, marked "complete": false. Exit codes: 0 done, 2 bad input, 4 a
denoiser, power source or disk failed, 130 interrupted.
"""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
CONSENSUS = "consensus"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--denoisers", metavar="A,B", help="by name or MODULE:NAME (default: all that can be loaded)")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout in place of tables")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="write evaluation.json and examples.npz there; they must not exist yet")
    common = parser.add_argument_group("common sets")
    common.add_argument("--images", type=int, metavar="N", help="scenes a point (default: 200)")
    common.add_argument("--psnr", metavar="DB,DB", help="points (default: 15,10,5,0,-4.9,-5,-10); --psnr=-5,0 where "
                        "the first is negative")
    common.add_argument("--sets", metavar="A,B", help="of constant, single, multiple (default: all)")
    common.add_argument("--seed", type=int, metavar="S", help="(default: 20260)")
    common.add_argument("--power", metavar="NAME", help="power source for energy an inference, such as rapl")
    recording = parser.add_argument_group("recording")
    recording.add_argument("--recording", type=Path, metavar="FILE", help=".mcap, or a log that can be imported")
    recording.add_argument("--truth-m", default=None, metavar="R|consensus",
                           help="range of the obstacle, or the peak of the mean envelope (default: consensus)")
    recording.add_argument("--tolerance-m", type=float, metavar="T", help="(default: 0.1)")
    recording.add_argument("--columns-m", type=float, metavar="S",
                           help="range from sample to sample, where the recording does not know it")
    recording.add_argument("--ring-down-m", type=float, metavar="B",
                           help="nothing nearer is evaluated (default: as seen in the recording, 0.135 at least)")
    recording.add_argument("--role", choices=("left", "right", "down"), help="sensor (default: the first there is)")
    recording.add_argument("--temperature", type=float, metavar="C", help="air, for the speed of sound (default: 20)")


def run(arguments: argparse.Namespace) -> int:
    """Compare; returns the exit code.

    Raises:
        UsageError: a bad option or recording. BenchError: a denoiser answers rubbish. DeviceError: no power source, or
        the disk is full or gone.
    """
    for name in THREADS:  # times are of one thread; must be said before the libraries are loaded
        os.environ.setdefault(name, "1")
    _check_pairing(arguments)
    files = _new_files(arguments.out, ["evaluation.json", *([] if arguments.recording else ["examples.npz"])])
    try:
        if arguments.recording is not None:
            return _on_recording(arguments, files)
        return _on_sets(arguments, files)
    except OSError as error:
        raise DeviceError(f"{arguments.out} cannot be written: {error.strerror or error}; free some space") from error


def _on_sets(arguments: argparse.Namespace, files: dict[str, Path]) -> int:
    from saranga.evaluation.answering import Nothing
    from saranga.evaluation.comparison import Comparison
    from saranga.evaluation.loading import load_denoisers
    from saranga.evaluation.power import Energy, load_power
    from saranga.evaluation.progress import Progress
    from saranga.evaluation.report import comparison_json, write_examples, write_json
    from saranga.evaluation.sets import KINDS, PSNRS_DB, SEED
    from saranga.evaluation.table import comparison_text

    images = 200 if arguments.images is None else arguments.images
    if not 10 <= images <= 100_000:
        raise UsageError(f"--images is {images}: it must be 10..100000")
    kinds = _chosen("--sets", arguments.sets, KINDS)
    psnrs = _psnrs(arguments.psnr) if arguments.psnr is not None else PSNRS_DB
    seed = SEED if arguments.seed is None else arguments.seed
    if not 0 <= seed < 2**62:
        raise UsageError(f"--seed is {seed}: it must be 0..2^62-1")
    meter = load_power(arguments.power) if arguments.power else None
    denoisers, skipped = load_denoisers(_names(arguments.denoisers))
    comparison = Comparison({**denoisers, Nothing.name: Nothing()}, images, psnrs, kinds, seed)
    progress = Progress(comparison.frames)
    energy: dict[str, Energy] = {}

    def tree(complete: bool) -> dict[str, Any]:
        return {**comparison_json(comparison, complete, skipped, energy),
                "run": str(arguments.out) if arguments.out else None}

    def save(complete: bool = False) -> None:
        if files:
            write_json(files["evaluation.json"], tree(complete))
            write_examples(files["examples.npz"], comparison)

    complete = False
    try:
        comparison.run(lambda pairs, frames: progress.add(_title(pairs.kind, pairs.psnr_db), frames), save)
        if meter is not None:
            energy.update(_energy(denoisers, meter))
        complete = True
        save(complete)
    except KeyboardInterrupt:
        kept = f"; {files['evaluation.json']} holds them" if files and comparison.finished else ""
        progress.end()
        print(f"interrupted: {len(comparison.finished)} sets are finished{kept}", file=sys.stderr)
    else:
        progress.end()
    _print(tree(complete), arguments.json, comparison_text)
    return 0 if complete else 130


def _on_recording(arguments: argparse.Namespace, files: dict[str, Path]) -> int:
    from saranga.evaluation.loading import load_denoisers
    from saranga.evaluation.long_image import columns_of
    from saranga.evaluation.on_recording import (
        RecordingScore,
        check_truth,
        consensus,
        recording_json,
        score_recording,
    )
    from saranga.evaluation.progress import Progress
    from saranga.evaluation.recorded import read_recorded
    from saranga.evaluation.report import machine, plain, write_json
    from saranga.evaluation.table import recording_text
    from saranga.resample import sound_speed_m_s

    tolerance_m = 0.1 if arguments.tolerance_m is None else arguments.tolerance_m
    temperature_c = 20.0 if arguments.temperature is None else arguments.temperature
    truth_m = _truth(arguments.truth_m)
    step_m = arguments.columns_m
    if step_m is not None and not 1e-4 <= step_m <= 0.5:
        raise UsageError(f"--columns-m {step_m:g} m: range from sample to sample must be 0.0001..0.5 m")
    if not -40.0 <= temperature_c <= 60.0:
        raise UsageError(f"--temperature {temperature_c:g} C: it must be -40..60 C")
    c_m_s = sound_speed_m_s(temperature_c)
    recorded = read_recorded(arguments.recording, arguments.role)
    columns = columns_of(recorded, c_m_s, step_m)
    check_truth(recorded, 1e-9 if truth_m is None else truth_m, tolerance_m, columns)
    if arguments.ring_down_m is not None and not 0.0 <= arguments.ring_down_m <= 1.0:
        raise UsageError(f"--ring-down-m {arguments.ring_down_m:g} m: it must be 0..1 m")
    agreed = consensus(recorded, c_m_s, step_m, arguments.ring_down_m)
    range_m = agreed.range_m if truth_m is None else truth_m
    truth = {"range_m": range_m, "tolerance_m": tolerance_m,
             "source": CONSENSUS if truth_m is None else "given", "consensus_m": agreed.range_m,
             "peak_over_noise_db": agreed.peak_over_noise_db, "ring_down_m": agreed.ring_down_m}
    denoisers, skipped = load_denoisers(_names(arguments.denoisers))
    progress = Progress(len(denoisers))
    scores: dict[str, RecordingScore] = {}
    complete = False
    try:
        for name, denoiser in denoisers.items():
            scores |= score_recording({name: denoiser}, recorded, range_m, tolerance_m, c_m_s, step_m,
                                      agreed.ring_down_m)
            progress.add(name, 1)
        complete = True
    except KeyboardInterrupt:
        print(f"\ninterrupted: {', '.join(scores) or 'no denoiser'} finished", file=sys.stderr)
    else:
        progress.end()
    tree = plain(recording_json(recorded, scores, truth, skipped, complete)
                 | {"provenance": {"temperature_c": temperature_c, "range_per_sample_m": step_m, **machine(denoisers)},
                    "run": str(arguments.out) if arguments.out else None})
    if files:
        write_json(files["evaluation.json"], tree)
    if recorded.losses != "nothing lost":
        print(f"warning: {recorded.path}: {recorded.losses}; what is readable was evaluated", file=sys.stderr)
    _print(tree, arguments.json, recording_text)
    return 0 if complete else 130


def _energy(denoisers: dict[str, Any], meter: Any) -> dict[str, Any]:
    import numpy as np

    from saranga.evaluation.answering import ArrayImage
    from saranga.evaluation.power import energy_of, idle_power_w
    from saranga.evaluation.sets import pair_set

    batch = next(pair_set("single", 1, 5.0).batches())
    assert batch.iq is not None
    image = ArrayImage(batch.iq[0, 0], np.abs(batch.iq[0, 0]))
    idle_w = idle_power_w(meter)
    return {name: energy_of(partial(denoiser, image), meter, idle_w) for name, denoiser in denoisers.items()}


def _print(tree: dict[str, Any], as_json: bool, text: Callable[[dict[str, Any]], str]) -> None:
    print(json.dumps(tree, allow_nan=False) if as_json else text(tree))


def _title(kind: str, psnr_db: float | None) -> str:
    return kind if psnr_db is None else f"{kind} {psnr_db:g} dB"


def _check_pairing(arguments: argparse.Namespace) -> None:
    for_sets = ("images", "psnr", "sets", "seed", "power")
    for_recording = ("truth_m", "tolerance_m", "columns_m", "ring_down_m", "role", "temperature")
    useless = for_recording if arguments.recording is None else for_sets
    given = [f"--{name.replace('_', '-')}" for name in useless if getattr(arguments, name) is not None]
    if given:
        other = "needs --recording FILE" if arguments.recording is None else "is for the common sets, no recording"
        raise UsageError(f"{', '.join(given)} {other}")


def _new_files(folder: Path | None, names: list[str]) -> dict[str, Path]:
    if folder is None:
        return {}
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file: give a folder")
    files = {name: folder / name for name in names}
    for path in files.values():
        if path.exists():
            raise UsageError(f"{path} exists: results are never overwritten; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder} cannot be made: {error.strerror}") from error
    return files


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def _chosen(option: str, text: str | None, known: tuple[str, ...]) -> tuple[str, ...]:
    names = known if text is None else tuple(_names(text) or ())
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise UsageError(f"{option} {text}: give some of {', '.join(known)}")
    return names


def _psnrs(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--psnr {text!r}: give numbers of dB separated by commas, such as 10,5,0") from None
    if not all(math.isfinite(v) and -30.0 <= v <= 60.0 for v in values) or len(set(values)) != len(values):
        raise UsageError(f"--psnr {text!r}: each must be within -30..60 dB and given once")
    return values


def _truth(text: str | None) -> float | None:
    if text is None or text == CONSENSUS:
        return None
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"--truth-m {text!r}: give metres or {CONSENSUS!r}") from None
