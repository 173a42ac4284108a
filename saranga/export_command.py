"""`python -m saranga export`: a trained network in the format of a runtime."""

import argparse
import hashlib
import os
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from saranga.errors import BenchError, DeviceError, UsageError

HELP = """\
Write a trained network in the format of a runtime.

  python -m saranga export --format onnx checkpoint.pt --out mine.onnx
  python -m saranga export --format int8 mine.onnx --out mine-int8.onnx
  python -m saranga export --format openvino mine.onnx --out mine.xml
  python -m saranga export --format tflite mine.onnx --out mine.tflite

SOURCE is a checkpoint of the training or an fp32 .onnx file. onnx: fp32, for every runtime. int8: quantised ONNX, for
ONNX Runtime and OpenVINO. openvino: .xml and .bin, fp32. tflite: whole numbers throughout, for LiteRT and, once
compiled with edgetpu_compiler, the Edge TPU. int8 and tflite measure the range of each activation on synthetic
images. What is written is run beside the fp32 network on other images and refused where they differ much.

Files are never overwritten. Exit codes: 0 written, 2 bad input, 4 export or disk failed, 130 interrupted.
"""

SUFFIXES = {"onnx": ".onnx", "int8": ".onnx", "openvino": ".xml", "tflite": ".tflite"}
CHECK_IMAGES = 64
CHECK_SEED = 1_000_003
MOST_RMS = 0.05
"""RMS difference of the edge probabilities from the fp32 network's; a good int8 network is at a tenth of it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("source", type=Path, metavar="SOURCE", help="checkpoint (.pt) or fp32 .onnx")
    parser.add_argument("--format", choices=tuple(SUFFIXES), required=True)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="must not exist yet")
    parser.add_argument("--recipe", default="default", metavar="NAME|FILE",
                        help="of the images that int8 and tflite are calibrated on (default: %(default)s)")
    parser.add_argument("--images", type=int, default=256, metavar="N", help="how many (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="(default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Write the file; returns the exit code.

    Raises:
        UsageError: a bad option, source or a package that is not installed. BenchError: the result does not compute
        what the fp32 network does. DeviceError: the disk is full or gone.
    """
    paths = _paths(arguments.format, arguments.out)
    try:
        made = _made(arguments)
        _write(dict(zip(paths, made, strict=True)))
    except KeyboardInterrupt:
        print(f"\ninterrupted: {arguments.out} was not written", file=sys.stderr)
        return 130
    for path, data in zip(paths, made, strict=True):
        print(f"{path}  {len(data)} bytes  sha256 {hashlib.sha256(data).hexdigest()}")
    return 0


def _paths(kind: str, out: Path) -> list[Path]:
    if out.suffix != SUFFIXES[kind]:
        raise UsageError(f"--out is {out}: --format {kind} writes {SUFFIXES[kind]} files")
    if not out.parent.is_dir():
        raise UsageError(f"{out}: there is no folder {out.parent}: make it first")
    paths = [out, out.with_suffix(".bin")] if kind == "openvino" else [out]
    for path in paths:
        if path.exists():
            raise UsageError(f"{path} exists: networks are never overwritten; choose another name")
    return paths


def _made(arguments: argparse.Namespace) -> tuple[bytes, ...]:
    # PyTorch loads in seconds: not before it is needed.
    from saranga.export import read_source, source_kind
    from saranga.quantise import calibration_inputs, quantised

    if arguments.images < 4:
        raise UsageError(f"--images is {arguments.images}: give at least 4")
    with _step(f"reading {arguments.source}"):
        fp32 = read_source(arguments.source)
    kind = source_kind(fp32, arguments.source)
    if arguments.format == "onnx":
        return (fp32,)
    if arguments.format == "openvino":
        from saranga.export_formats import openvino_from_onnx

        with _step("converting"):
            return openvino_from_onnx(fp32)
    with _step(f"drawing {arguments.images} images"):
        images = calibration_inputs(kind, arguments.images, arguments.recipe, arguments.seed)
        others = calibration_inputs(kind, CHECK_IMAGES, arguments.recipe, CHECK_SEED)
    if arguments.format == "int8":
        with _step("quantising"):
            data = quantised(fp32, images)
        with _step("checking"):
            found = _onnx_edges(data, others)
    else:
        from saranga.export_formats import tflite_edges, tflite_from_onnx

        with _step("converting and quantising"):
            data = tflite_from_onnx(fp32, images)
        with _step("checking"):
            found = tflite_edges(data, others)
    difference = found - _onnx_edges(fp32, others)
    rms = float(np.sqrt(np.mean(difference**2)))
    print(f"edge probabilities against fp32 on {CHECK_IMAGES} other images: RMS difference {rms:.4f}, largest "
          f"{np.abs(difference).max():.3f}", file=sys.stderr)
    if not rms <= MOST_RMS:
        raise BenchError(f"{arguments.out} was not written: its edge probabilities differ from the fp32 network's by "
                         f"{rms:.3f} RMS (limit {MOST_RMS}); calibrate on images as in training (--recipe)")
    return (data,)


def _onnx_edges(data: bytes, images: NDArray[np.float32]) -> NDArray[np.float32]:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    return np.stack([session.run(None, {name: image[None]})[0] for image in images])


class _step:
    """Progress on stderr: what is being done, then how long it took."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __enter__(self) -> None:
        print(f"{self._what} ...", end="", file=sys.stderr, flush=True)
        self._start = perf_counter()

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        print(" failed" if kind else f" {perf_counter() - self._start:.1f} s", file=sys.stderr)


def _write(files: dict[Path, bytes]) -> None:
    """All files or none; never over an existing one.

    Raises:
        UsageError: a file came into being meanwhile. DeviceError: the disk failed.
    """
    written: list[Path] = []
    try:
        for path, data in files.items():
            with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as part:
                try:
                    part.write(data)
                    part.flush()
                    os.fsync(part.fileno())
                    Path(part.name).chmod(0o644)
                    os.link(part.name, path)
                    written.append(path)
                finally:
                    Path(part.name).unlink()
    except OSError as error:
        for path in written:
            path.unlink(missing_ok=True)
        if isinstance(error, FileExistsError):
            raise UsageError(f"{path} exists: networks are never overwritten; choose another name") from error
        raise DeviceError(f"{path} cannot be written: {error.strerror or error}; free some space") from error
