"""One CPU for two processes in lockstep: shared by the pair, by no other pair, and given back."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl.autopilot import one_cpu
from sitl.autopilot.one_cpu import OneCpu

pytestmark = pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two CPUs")


@pytest.fixture
def child(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[int]:
    monkeypatch.setattr(one_cpu, "_lock_file", lambda cpu: tmp_path / f"cpu{cpu}.lock")
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    yield process.pid
    process.kill()
    process.wait()


def test_both_are_pinned_to_one_cpu_and_ours_is_given_back(child: int) -> None:
    before = os.sched_getaffinity(0)
    pair = OneCpu()
    pair.take(child)
    try:
        assert os.sched_getaffinity(0) == os.sched_getaffinity(child) == {pair.cpu}
    finally:
        pair.release()
    pair.release()
    assert os.sched_getaffinity(0) == before


def test_a_second_pair_gets_another_cpu_and_with_none_left_nothing_is_pinned(child: int) -> None:
    before = os.sched_getaffinity(0)
    pairs = [OneCpu() for _ in range(len(before) + 1)]
    try:
        taken = []
        for pair in pairs:
            os.sched_setaffinity(0, before)
            pair.take(child)
            taken.append(pair.cpu)
        assert sorted(t for t in taken[:-1] if t is not None) == sorted(before) and taken[-1] is None
    finally:
        for pair in pairs:
            pair.release()
        os.sched_setaffinity(0, before)


def test_a_child_that_is_gone_leaves_us_as_we_were(child: int) -> None:
    before = os.sched_getaffinity(0)
    pair = OneCpu()
    pair.take(2**22 - 1)
    assert pair.cpu is None and os.sched_getaffinity(0) == before
