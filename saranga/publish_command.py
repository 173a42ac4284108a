"""`python -m saranga publish`: a trained network as it ships."""

import argparse
import sys
from pathlib import Path

from saranga.errors import DeviceError, UsageError

HELP = """\
Export a checkpoint in fp32 and int8, calibrate its threshold and edge offset, measure it, and write it all with its
metadata (recipe, seed, hardware, metrics), so that it can be used by path or name:

  python -m saranga publish training/checkpoint.pt --out my-models
  python -m saranga evaluate --denoisers tbd,saranga
  python -c "from saranga.denoise import load_denoiser; load_denoiser('saranga', weights='my-models/saranga.json')"

The shipped ones are in fixtures/models. Exit codes: 0 written, 2 bad input, 4 disk failed, 130 interrupted.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("checkpoint", type=Path, metavar="CHECKPOINT", help="of python -m saranga train")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--images", type=int, default=500, metavar="N",
                        help="scenes a point of the metrics (default: %(default)s)")
    parser.add_argument("--tflite", type=Path, metavar="FILE",
                        help="list this network too, made by export --format tflite from the same checkpoint")


def run(arguments: argparse.Namespace) -> int:
    """Write the files; returns the exit code.

    Raises:
        UsageError: a bad option or checkpoint, or a package that is not installed. DeviceError: the disk failed.
    """
    if not 50 <= arguments.images <= 100_000:
        raise UsageError(f"--images is {arguments.images}: it must be in 50..100000")
    if arguments.tflite is not None and not arguments.tflite.is_file():
        raise UsageError(f"--tflite {arguments.tflite} does not exist")
    from saranga.export import need_packages
    from saranga.publish import publish, say_on_stderr

    need_packages("torch", "onnx", "onnxruntime")
    try:
        print(publish(arguments.checkpoint, arguments.out, arguments.images, say_on_stderr, arguments.tflite))
    except KeyboardInterrupt:
        print(f"\ninterrupted: {arguments.out} was not written", file=sys.stderr)
        return 130
    except OSError as error:
        raise DeviceError(f"{arguments.out} cannot be written: {error.strerror or error}; free some space") from error
    return 0
