"""Threads for the stack: only where a CPU would be idle, and a flight is the same with them."""

import os

import pytest

from bench.spare import stack_threads
from sitl.trial import run_trial
from sitl.trial_types import TrialRequest


@pytest.mark.parametrize(("cpus", "simulators", "threads"),
                         [(1, 1, 1), (2, 1, 2), (2, 2, 1), (8, 1, 2), (8, 4, 2), (8, 5, 1), (4, 0, 2), (2, 9, 1)])
def test_threads_of_a_simulator(monkeypatch: pytest.MonkeyPatch, cpus: int, simulators: int, threads: int) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(cpus)))
    assert stack_threads(simulators) == threads


def test_threads_do_not_change_the_flight() -> None:
    one, two = (run_trial(TrialRequest("poles", seed=3, stack_threads=threads, keep_log=False)) for threads in (1, 2))
    assert one.determinism_hash == two.determinism_hash
    assert one.min_clearance_m == two.min_clearance_m
