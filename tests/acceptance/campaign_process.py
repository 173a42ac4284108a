"""A campaign as its own process, to be disturbed: `saranga-bench campaign` with its progress read line by line."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import psutil

PATIENCE_S = 500.0
SUITE = """
[suite]
name = "short"
description = "flights that end at the first obstacle"
trials = 4
denoiser = "gaussian"
stack = "none"
autopilot = "AUTOPILOT"

[[row]]
name = "poles"
scene = "poles"
paper = { successes = 17, trials = 21 }

[[row]]
name = "boxes"
scene = "boxes"

[[comparison]]
name = "poles against boxes"
a = "poles"
b = "boxes"
"""


def write_suite(folder: Path, autopilot: str = "embedded") -> Path:
    path = folder / "short.toml"
    path.write_text(SUITE.replace("AUTOPILOT", autopilot))
    return path


class CampaignProcess:
    """Started at once; stdout is the JSON object, stderr the progress."""

    def __init__(self, suite: Path, runs: Path, *options: str) -> None:
        command = [sys.executable, "-m", "bench.cli", "campaign", str(suite), "--out", str(runs), "--json", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.lines: list[str] = []
        self.seen: list[psutil.Process] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.rstrip())

    def progress(self) -> list[str]:
        """One line a finished trial."""
        return [line for line in self.lines if line[:1].isdigit() and "/" in line[:6]]

    def wait_for_trials(self, count: int) -> None:
        until = time.monotonic() + PATIENCE_S
        while len(self.progress()) < count:
            assert time.monotonic() < until and self.process.poll() is None, "\n".join(self.lines)
            time.sleep(0.01)
        self.family()

    def family(self) -> list[psutil.Process]:
        """Every process that the campaign has started and that lives; they are remembered."""
        found = psutil.Process(self.process.pid).children(recursive=True)
        self.seen += found
        return found

    def workers(self) -> list[psutil.Process]:
        return [p for p in self.family() if "spawn_main" in " ".join(command_of(p))]

    def send(self, number: int) -> None:
        os.kill(self.process.pid, number)

    def finish(self) -> tuple[int, dict[str, Any] | None]:
        """Exit code and the JSON object, None where it was killed."""
        assert self.process.stdout is not None
        with self.process.stdout as stdout:
            text = stdout.read()
        code = self.process.wait(timeout=PATIENCE_S)
        self._reader.join(timeout=5.0)
        return code, json.loads(text) if code != -signal.SIGKILL else None

    def assert_nothing_left(self) -> None:
        until = time.monotonic() + 10.0
        while (left := [p for p in self.seen if alive(p)]) and time.monotonic() < until:
            time.sleep(0.05)
        assert not left, [command_of(p) for p in left]


def alive(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def command_of(process: psutil.Process) -> list[str]:
    try:
        return list(process.cmdline())
    except psutil.Error:
        return []


def table(summary: dict[str, Any]) -> dict[str, Any]:
    """What must not depend on how the campaign went."""
    rows = [{key: value for key, value in row.items() if key != "realtime_factor"} for row in summary["rows"]]
    return {"rows": rows, "comparisons": summary["comparisons"], "verdict": summary["verdict"],
            "hash": summary["metrics"]["determinism_hash"],
            "outcomes": [(t["row"], t["seed"], t["outcome"], t["determinism_hash"]) for t in summary["outcomes"]]}
