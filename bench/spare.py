"""How many threads a simulator may use for its stack, of the CPUs of this machine."""

import os

MOST = 2
"""A third would wait for the two sensors of most rigs."""


def stack_threads(simulators: int = 1) -> int:
    """Threads for each of so many simulators at a time: one more than one only where a CPU would be idle."""
    return max(1, min(MOST, len(os.sched_getaffinity(0)) // max(simulators, 1)))
