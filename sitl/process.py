"""Subprocesses that never outlive us, and how one that serves ends."""

import ctypes
import signal
import sys
from collections.abc import Callable

from saranga.errors import BenchError

PR_SET_PDEATHSIG = 1


def die_with_parent(how: int = signal.SIGKILL) -> None:
    """Use as `preexec_fn`: the kernel ends the child when this process ends, however it ends (Linux; else nothing).

    Start such children in a session of their own (`start_new_session=True`): Ctrl-C in the terminal is for us, who then
    end the flight in order.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, how)


def serve_until_told(serve: Callable[[], None]) -> int:
    """Run `serve`; returns the exit code.

    SIGTERM, Ctrl-C and a reader that has gone end it in order, a BenchError with its line.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        serve()
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except (KeyboardInterrupt, BrokenPipeError):
        return 0
    return 0
