"""MAVSDK and MAVProxy connect to the embedded autopilot in wall time, arm, take off, fly and land."""

import contextlib
import json
import os
import queue
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAVPROXY = Path(sys.executable).with_name("mavproxy.py")
pytestmark = [pytest.mark.wall_time, pytest.mark.xdist_group("wall_time")]


def environment(home: Path) -> dict[str, str]:
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path, "HOME": str(home)}


class World:
    """`world_process.py`, and the truth it prints."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("world_process.py")), "--seconds", "90", *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)})
        assert self.process.stdout is not None
        self.urls: list[str] = json.loads(self.process.stdout.readline())["urls"]
        self.truth: list[dict[str, Any]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.truth.append(json.loads(line))

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(5.0)
        self.process.kill()
        self.process.wait()
        self._reader.join(2.0)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def check_truth(truth: list[dict[str, Any]], forward_m: float) -> None:
    """What the physics says happened, whatever the ground station believes."""
    heights = [-row["pos_m"][2] - 0.03 for row in truth]
    assert max(heights) == pytest.approx(1.0, abs=0.15)
    assert truth[-1]["pos_m"][0] > forward_m
    assert abs(truth[-1]["pos_m"][1]) < 0.4
    assert heights[-1] == pytest.approx(0.0, abs=0.01)
    assert any(row["armed"] for row in truth) and not truth[-1]["armed"]


@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_mavsdk_flies_it(transport: str, tmp_path: Path) -> None:
    port = free_port()
    world = World("--tcp", "0") if transport == "tcp" else World("--udp-to", str(port))
    url = f"tcpout://{world.urls[0].removeprefix('tcp://')}" if transport == "tcp" else f"udpin://127.0.0.1:{port}"
    try:
        flight = subprocess.run([sys.executable, str(Path(__file__).with_name("mavsdk_flight.py")), url],
                                capture_output=True, text=True, timeout=80, cwd=tmp_path, env=environment(tmp_path),
                                check=False)
    finally:
        world.close()
    assert flight.returncode == 0, flight.stdout[-2000:] + flight.stderr[-2000:]
    seen = json.loads(flight.stdout.strip().splitlines()[-1])
    assert seen["version"] == "0.1.0" and seen["guid_timeout_s"] == 3.0
    assert seen["velocity_m_s"] == pytest.approx(0.5, abs=0.1)
    assert 15.5 < seen["battery_v"] <= 16.8
    check_truth(world.truth, forward_m=1.0)


class MavProxy:
    """mavproxy.py without a terminal: type a line, wait for a text."""

    def __init__(self, master: str, home: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-u", str(MAVPROXY), f"--master={master}", f"--state-basedir={home}"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=home,
            env=environment(home))
        self.lines: queue.Queue[str] = queue.Queue()
        self.said = ""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.put(line)

    def wait(self, pattern: str, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        fresh = ""
        while not re.search(pattern, fresh):
            try:
                line = self.lines.get(timeout=max(deadline - time.monotonic(), 0.01))
            except queue.Empty:
                pytest.fail(f"MAVProxy did not say {pattern!r} within {seconds:g} s; it said:\n{self.said[-3000:]}")
            fresh += line
            self.said += line

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def close(self) -> None:
        self.process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(5.0)
        self.process.kill()
        self.process.wait()


@pytest.fixture
def proxied(tmp_path: Path) -> Iterator[tuple[World, MavProxy]]:
    port = free_port()
    world = World("--udp-to", str(port), "--origin")
    proxy = MavProxy(f"udpin:127.0.0.1:{port}", tmp_path)
    yield world, proxy
    proxy.close()
    world.close()


@pytest.mark.skipif(not MAVPROXY.is_file(), reason="MAVProxy is not installed")
def test_mavproxy_flies_it(proxied: tuple[World, MavProxy]) -> None:
    world, proxy = proxied
    proxy.wait(r"Received \d+ parameters", 30.0)
    proxy.type("param set LAND_SPEED 50")
    time.sleep(1.0)
    proxy.type("param show LAND_SPEED")
    proxy.wait(r"LAND_SPEED\s+50", 5.0)
    deadline = time.monotonic() + 10.0
    while world.truth[-1]["t_s"] < 5.0 and time.monotonic() < deadline:
        time.sleep(0.1)
    proxy.type("mode guided")
    proxy.wait("Mode GUIDED", 5.0)
    proxy.type("arm throttle")
    proxy.wait("ARMED", 5.0)
    proxy.type("takeoff 1")
    proxy.wait("NAV_TAKEOFF: ACCEPTED", 5.0)
    time.sleep(4.0)
    for _ in range(2):
        proxy.type("velocity 0.5 0 0")
        time.sleep(1.5)
    proxy.type("velocity 0 0 0")
    time.sleep(1.5)
    proxy.type("mode land")
    proxy.wait("DISARMED", 15.0)
    time.sleep(0.5)
    check_truth(world.truth, forward_m=1.0)
