"""`python -m saranga synthesise`: a data set of training pairs in one .npz file."""

import argparse
import sys
import tomllib
from pathlib import Path
from typing import Any

from saranga.errors import DeviceError, UsageError

HELP = """\
Draw training pairs (paper eqs 2-9 with the errata): echo images and the leading edges in them.

  python -m saranga synthesise --recipe default --count 40000 --seed 1 --out pairs.npz
  python -m saranga synthesise --recipe default --count 64 --set noise.psnr_db=[5,5] --out five.npz --preview look.png

One pair is one sensor's image; the sensors of a scene follow each other. The file holds images (count, 32, 512),
labels (uint8, 255 = edge), scene and role of each pair, truth of each scene, and provenance (JSON). The same recipe,
seed, sensors and noise give the same file. Ctrl-C leaves no file. Exit codes: 0 written, 2 bad input, 4 disk failed,
130 interrupted.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--recipe", default="default", metavar="NAME|FILE",
                        help="fixtures/synthesis or a TOML path (default: %(default)s)")
    parser.add_argument("--count", type=int, required=True, metavar="N", help="pairs, one sensor's image each")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.npz", help="must not exist yet")
    parser.add_argument("--roles", metavar="left,right", help="sensors (default: all of the recipe's sonar)")
    parser.add_argument("--noise", type=Path, nargs="+", default=[], metavar="FILE",
                        help="receive-only recordings, .mcap of the rig, .npz or .npy (default: modelled noise)")
    parser.add_argument("--set", action="append", default=[], metavar="TABLE.KEY=VALUE", dest="values",
                        help="change a value of the recipe, written as in TOML; may be repeated")
    parser.add_argument("--dtype", choices=("float32", "float16"), default="float32",
                        help="of the images (default: %(default)s)")
    parser.add_argument("--preview", type=Path, metavar="FILE.png", help="the first pairs, image left, label right")


def run(arguments: argparse.Namespace) -> int:
    """Write the file; returns the exit code.

    Raises:
        UsageError: a bad option, recipe or recording. DeviceError: the disk is full or gone.
    """
    # Kernels load in a second: not before they are needed.
    from saranga.synthesis import Synthesiser, load_recipe
    from saranga.synthesis.dataset import preview, write_pairs

    if arguments.count < 1:
        raise UsageError(f"--count is {arguments.count}: it must be at least 1")
    for path in (arguments.out, arguments.preview):
        if path is not None and not path.parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent}: make it first")
    if arguments.out.suffix != ".npz":
        raise UsageError(f"--out is {arguments.out}: it must end in .npz")
    if arguments.out.exists():
        raise UsageError(f"{arguments.out} exists: data sets are never overwritten; choose another name")
    recipe = load_recipe(arguments.recipe).with_values(dict(_assignment(text) for text in arguments.values))
    roles = arguments.roles.split(",") if arguments.roles else None
    synthesiser = Synthesiser(recipe, arguments.seed, roles, arguments.noise)
    try:
        write_pairs(synthesiser, arguments.count, arguments.out, arguments.dtype)
        if arguments.preview is not None:
            arguments.preview.write_bytes(preview(synthesiser, arguments.count))
    except KeyboardInterrupt:
        left = "is complete" if arguments.out.exists() else "was not written"
        print(f"\ninterrupted: {arguments.out} {left}", file=sys.stderr)
        return 130
    except OSError as error:
        raise DeviceError(f"{arguments.out} cannot be written: {error.strerror or error}; free some space") from error
    return 0


def _assignment(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set {text!r}: give TABLE.KEY=VALUE, such as noise.psnr_db=[0,10]")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value
