"""Simulated time: how often, in what order."""

import pytest

from sitl.clock import ECHO_CYCLE_US, STACK_TICK_US, Delayed, Periodic


def test_rates_are_the_papers() -> None:
    assert pytest.approx(39, abs=0.1) == 1e6 / ECHO_CYCLE_US
    assert 1e6 / STACK_TICK_US == 16.0
    assert pytest.approx(0.82, abs=0.001) == 32 * ECHO_CYCLE_US / 1e6


def test_periodic_fires_once_a_period_however_time_is_cut() -> None:
    for step in (1, 700, 2_500, 30_000):
        timer, fired = Periodic(ECHO_CYCLE_US), 0
        for t_us in range(0, 1_000_001, step):
            while timer.due(t_us):
                fired += 1
        assert fired == 1_000_000 // ECHO_CYCLE_US + 1 or (step == 30_000 and fired == 990_000 // ECHO_CYCLE_US + 1)


def test_a_period_must_be_positive() -> None:
    with pytest.raises(ValueError, match="positive"):
        Periodic(0)


def test_delayed_bytes_come_due_in_order_and_never_overtake() -> None:
    queue = Delayed()
    queue.put(100, b"a")
    queue.put(50, b"b")
    assert queue.take(60) == b""
    assert queue.take(100) == b"ab"
    assert queue.take(10_000) == b""
