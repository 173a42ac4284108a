"""Other programs for the tests of this folder: the world process, and ground stations that fly it."""

import contextlib
import json
import os
import queue
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import psutil
import pytest

from sitl.process import die_with_parent

ROOT = Path(__file__).resolve().parents[2]
WORLD = Path(__file__).with_name("world_process.py")
MAVPROXY = Path(sys.executable).with_name("mavproxy.py")
# A cold cache compiles the physics first, on a machine that may be busy.
BOOT_LIMIT_S = 150.0
END_LIMIT_S = 15.0


def environment(home: Path) -> dict[str, str]:
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    # Ground stations keep files in the home folder: this one is not the user's.
    return {**os.environ, "PYTHONPATH": path, "HOME": str(home)}


@pytest.fixture
def free_port() -> int:
    """A UDP port that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


class World:
    """`world_process.py`, the truth it prints, and the processes it started."""

    def __init__(self, folder: Path, autopilot: str, *arguments: str) -> None:
        self._errors = folder / "world-errors.txt"
        with self._errors.open("w") as errors:
            self.process = subprocess.Popen(
                [sys.executable, str(WORLD), "--autopilot", autopilot, "--seconds", "200", "--workdir",
                 str(folder / "autopilot"), *arguments],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=ROOT,
                env={**os.environ, "PYTHONPATH": str(ROOT)}, preexec_fn=die_with_parent)
        self.truth: list[dict[str, Any]] = []
        self.started: dict[str, Any] = {}
        self.children: list[psutil.Process] = []
        self._reader = threading.Thread(target=self._read, args=(self.process.stdout,), daemon=True)
        self._reader.start()

    def _read(self, stdout: IO[str]) -> None:
        for line in stdout:
            (self.truth.append if self.started else self.started.update)(json.loads(line))

    def wait_started(self) -> None:
        if not wait_until(lambda: bool(self.truth) or not self._reader.is_alive(), BOOT_LIMIT_S) or not self.truth:
            pytest.fail(f"the world process did not start: {self._errors.read_text()[-2000:]}")
        self.children = psutil.Process(self.process.pid).children(recursive=True)

    def wait(self, what: str, condition: Callable[[dict[str, Any]], bool], seconds: float) -> None:
        if not wait_until(lambda: condition(self.truth[-1]) or not self._reader.is_alive(), seconds) \
                or not condition(self.truth[-1]):
            pytest.fail(f"{what}: not within {seconds:g} s; truth {self.truth[-1]}; {self._errors.read_text()[-2000:]}")

    def close(self) -> int:
        """End it the way its user does; returns its exit code, or that of the kill it needed."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(END_LIMIT_S)
        self.process.kill()
        self._reader.join(5.0)
        return self.process.wait()


@pytest.fixture
def run_program(tmp_path: Path) -> Callable[..., "subprocess.CompletedProcess[str]"]:
    """`run_program(script, *arguments, **variables)` runs a script of this folder to its end."""

    def run(script: str, *arguments: str, **variables: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, str(WORLD.with_name(script)), *arguments], stdin=subprocess.DEVNULL, capture_output=True,
            text=True, timeout=150.0, cwd=tmp_path, env={**environment(tmp_path), **variables}, check=False,
            preexec_fn=die_with_parent)

    return run


@pytest.fixture
def start_world(tmp_path: Path) -> Iterator[Callable[..., World]]:
    """`start_world(autopilot, *arguments)`; it is ended, cleanly and with all it started, when the test ends."""
    worlds: list[World] = []

    def start(autopilot: str, *arguments: str) -> World:
        world = World(tmp_path, autopilot, *arguments)
        worlds.append(world)
        world.wait_started()
        return world

    yield start
    for world in worlds:
        killed_by_the_test = world.process.poll() == -signal.SIGKILL
        code = world.close()
        left = psutil.wait_procs(world.children, timeout=5.0)[1]
        for orphan in left:
            orphan.kill()
        assert killed_by_the_test or code == 0, f"world process ended with {code}"
        assert left == [], "the world process left these behind"


class MavProxy:
    """mavproxy.py without a terminal: type a line, wait for a text."""

    def __init__(self, master: str, home: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-u", str(MAVPROXY), f"--master={master}", f"--state-basedir={home}"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=home,
            env=environment(home), preexec_fn=die_with_parent)
        self.lines: queue.Queue[str] = queue.Queue()
        self.said = ""
        self._fresh = ""
        threading.Thread(target=self._read, args=(self.process.stdout,), daemon=True).start()

    def _read(self, stdout: IO[str]) -> None:
        for line in stdout:
            self.lines.put(line)

    def wait(self, pattern: str, seconds: float) -> str:
        """What matched, in what it said since the last match."""
        deadline = time.monotonic() + seconds
        while (match := re.search(pattern, self._fresh)) is None:
            try:
                line = self.lines.get(timeout=max(deadline - time.monotonic(), 0.01))
            except queue.Empty:
                pytest.fail(f"MAVProxy did not say {pattern!r} within {seconds:g} s; it said:\n{self.said[-3000:]}")
            self._fresh += line
            self.said += line
        self._fresh = self._fresh[match.end():]
        return match.group(0)

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def mavproxy(tmp_path: Path) -> Iterator[Callable[[str], MavProxy]]:
    """`mavproxy(master)` starts one."""
    if not MAVPROXY.is_file():
        pytest.skip("MAVProxy is not installed: run `make venv`")
    running: list[MavProxy] = []

    def start(master: str) -> MavProxy:
        running.append(MavProxy(master, tmp_path))
        return running[-1]

    yield start
    for proxy in running:
        proxy.close()
