"""`python -m saranga train`."""

import argparse
import signal
import sys
from pathlib import Path

from saranga.errors import UsageError

HELP = """\
Train a network on pairs that are drawn as it goes (python -m saranga synthesise shows them).

  python -m saranga train --out training                          our recipe: 700 000 images, 40 min on 2 cores
  python -m saranga train --out quick --minutes 20                the same, cut short
  python -m saranga train --recipe paper --out paper --device cuda  the paper's: 40 000 pairs, 100 epochs
  python -m saranga train --out training --resume                 go on where it ended

--out gets checkpoint.pt (once a minute, and on Ctrl-C) and log.jsonl. Turn the checkpoint into a network that flies
with python -m saranga export. Exit codes: 0 done, 2 bad input, 4 failed, 130 interrupted (--resume goes on).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--recipe", default="default", metavar="NAME|FILE",
                        help="fixtures/training or a TOML path (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="checkpoint and log")
    parser.add_argument("--resume", action="store_true", help="go on with the checkpoint in --out")
    parser.add_argument("--start", type=Path, metavar="CHECKPOINT|NAME",
                        help="begin with the weights of another run, of a published .onnx, or of a shipped network")
    parser.add_argument("--minutes", type=float, metavar="M", help="end after so long, schedule and all")
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="of PyTorch (default: %(default)s)")
    parser.add_argument("--feed-threads", type=int, default=1, metavar="N",
                        help="that draw images (default: %(default)s)")
    parser.add_argument("--feed-processes", type=int, default=0, metavar="N",
                        help="draw in N processes instead of threads; a GPU wants 8 or more (default: %(default)s)")
    parser.add_argument("--device", default="cpu", help="cpu, cuda, ... (default: %(default)s)")
    parser.add_argument("--precision", choices=("auto", "bf16", "fp32"), default="auto",
                        help="auto: bf16 where the hardware has it (default: %(default)s)")
    parser.add_argument("--check-every", type=int, default=50_000, metavar="N",
                        help="images between two checks (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Train; returns the exit code.

    Raises:
        UsageError: a bad option, recipe or checkpoint, or PyTorch is not installed. DeviceError: training failed.
    """
    for name, low, high in (("threads", 1, 256), ("feed_threads", 1, 256), ("feed_processes", 0, 256),
                            ("check_every", 1, 10**9)):
        if not low <= getattr(arguments, name) <= high:
            raise UsageError(f"--{name.replace('_', '-')} is {getattr(arguments, name)}: it must be in {low}..{high}")
    if arguments.resume and arguments.start is not None:
        raise UsageError("--resume goes on with the checkpoint in --out, --start begins a new run: give one of them")
    if arguments.minutes is not None and not 0.0 < arguments.minutes <= 1e5:
        raise UsageError(f"--minutes is {arguments.minutes:g}: it must be over 0 and at most 100000")
    from saranga.training.recipe import load_training_recipe

    recipe = load_training_recipe(arguments.recipe)
    try:
        from saranga.training.loop import TrainingOptions, train
    except ImportError as error:
        raise UsageError(f"training needs PyTorch ({error}): pip install 'saranga-bench[train]'") from error
    options = TrainingOptions(arguments.out, arguments.resume, arguments.minutes, arguments.threads,
                              arguments.feed_threads, arguments.feed_processes, arguments.device, arguments.precision,
                              arguments.check_every, arguments.start)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends like Ctrl-C: with a checkpoint
    try:
        path = train(recipe, options, say=lambda line: print(line, file=sys.stderr, flush=True))
    except KeyboardInterrupt:
        print(f"\ninterrupted: {arguments.out} holds a checkpoint; --resume goes on with it", file=sys.stderr)
        return 130
    print(path)
    return 0
