"""The real ArduCopter: how it fails to start, how it dies, and that it leaves nothing behind."""

from pathlib import Path

import numpy as np
import psutil
import pytest

from saranga.errors import DeviceError
from sitl.airframe import load_airframe
from sitl.autopilot.arducopter import ArduCopter
from sitl.autopilot.binary import require_binary
from sitl.physics import Physics, SteadyWind


@pytest.fixture
def physics() -> Physics:
    return Physics(load_airframe(), np.zeros(3), SteadyWind(), 1)


BEFORE: set[int] = set()
"""Helpers of earlier tests in this process, such as multiprocessing's resource tracker, which lives as long as it."""


@pytest.fixture(autouse=True)
def _others() -> None:
    BEFORE.clear()
    BEFORE.update(p.pid for p in psutil.Process().children(recursive=True))


def started() -> list[psutil.Process]:
    """Processes that the test started and that still run."""
    return [p for p in psutil.Process().children(recursive=True)
            if p.pid not in BEFORE and p.status() != psutil.STATUS_ZOMBIE]


def children() -> list[str]:
    return [p.name() for p in started()]


def test_a_missing_binary_is_named_with_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ARDUCOPTER", str(tmp_path / "nowhere"))
    with pytest.raises(DeviceError, match=r"nowhere.*sitl install"):
        require_binary()


def test_a_binary_that_is_not_executable_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "arducopter"
    path.write_text("x")
    monkeypatch.setenv("ARDUCOPTER", str(path))
    with pytest.raises(DeviceError, match="chmod"):
        require_binary()


@pytest.mark.parametrize("text,expected", [
    ("#!/bin/sh\necho cannot open display; exit 3\n", "exit code 3.*cannot open display"),
    ("#!/bin/sh\nkill -SEGV $$\n", "SIGSEGV"),
    ("not a program at all", "cannot be started"),
])
def test_a_program_that_is_not_arducopter_fails_at_once_with_its_last_words(
    physics: Physics, tmp_path: Path, text: str, expected: str
) -> None:
    fake = tmp_path / "fake"
    fake.write_text(text)
    fake.chmod(0o755)
    autopilot = ArduCopter(tmp_path / "work", binary=fake)
    with pytest.raises(DeviceError, match=expected):
        autopilot.start(physics.state)
    autopilot.close()
    assert children() == []


def test_a_step_before_the_start_is_refused(physics: Physics, tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="not running"):
        ArduCopter(tmp_path).step(physics.state, b"")


@pytest.mark.real_arducopter
def test_it_boots_steps_and_leaves_no_process(physics: Physics, tmp_path: Path) -> None:
    autopilot = ArduCopter(tmp_path)
    autopilot.start(physics.state)
    try:
        assert "arducopter" in children()[0]
        spoken = b""
        for _ in range(1200):
            throttle, data = autopilot.step(physics.state, b"")
            physics.step(autopilot.tick_us, throttle)
            spoken += data
        assert np.all(throttle == 0.0), "disarmed motors must not turn"
        assert b"Init ArduCopter" in spoken
        listening = [c for c in started()[0].net_connections("inet")
                     if c.status == psutil.CONN_LISTEN]
        assert listening == []
    finally:
        autopilot.close()
    autopilot.close()
    assert children() == []
    assert list((tmp_path / "logs").glob("*.BIN")), "the DataFlash log is kept"


@pytest.mark.real_arducopter
def test_a_killed_process_is_an_error_with_its_cause_not_a_hang(physics: Physics, tmp_path: Path) -> None:
    autopilot = ArduCopter(tmp_path)
    autopilot.start(physics.state)
    autopilot.step(physics.state, b"")
    autopilot.kill()
    with pytest.raises(DeviceError, match="SIGKILL"):
        for _ in range(3):
            autopilot.step(physics.state, b"")
    assert "SIGKILL" in (autopilot.health() or "")
    autopilot.close()


@pytest.mark.real_arducopter
def test_a_lost_physics_socket_is_an_error_within_its_deadline(
    physics: Physics, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.autopilot.arducopter.ANSWER_DEADLINE_S", 1.0)
    autopilot = ArduCopter(tmp_path)
    autopilot.start(physics.state)
    autopilot.step(physics.state, b"")
    autopilot.lose_physics_socket()
    with pytest.raises(DeviceError, match="physics socket lost"):
        autopilot.step(physics.state, b"")
    autopilot.close()
    assert children() == []
