"""Subprocesses that never outlive us."""

import ctypes
import signal

PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Use as `preexec_fn`: the kernel kills the child when this process ends, however it ends (Linux).

    Start such children in a session of their own (`start_new_session=True`): Ctrl-C in the terminal is for us, who then
    end the flight in order.
    """
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
