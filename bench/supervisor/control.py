"""The control processes that the kill matrix cuts off."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Protocol

OUTPUT = "control.out"
PYTEST = "test_rehearsal_under_a_time_out.py"
PYTEST_TEXT = """
from pathlib import Path

from bench.supervisor.rehearsal import rehearse


def test_rehearsal():
    assert rehearse({url!r}, {rig!r}, Path({run!r}), {steps}) == "PASS"
"""
TIMEOUT_S = 300


class Control(Protocol):
    """A control process: a run of `steps` steps that each go up to `full_throttle`, hold, and come down."""

    steps: int
    full_throttle: float

    def start(self, folder: Path, stand_url: str, rig_url: str | None, under_pytest: bool) -> "subprocess.Popen[bytes]":
        """Begin the run in `folder`, or go on with it; `under_pytest`: as a pytest with a time-out."""
        ...

    def steps_said(self, folder: Path) -> set[int]:
        """Steps that the process itself has said are finished."""
        ...

    def said(self, folder: Path) -> str:
        """The end of its output."""
        ...


class Rehearsal:
    """`bench.supervisor.rehearsal`: the smallest run that has every phase."""

    def __init__(self, steps: int = 2) -> None:
        from bench.supervisor.rehearsal import THROTTLE

        self.steps = steps
        self.full_throttle = THROTTLE

    def start(self, folder: Path, stand_url: str, rig_url: str | None, under_pytest: bool) -> "subprocess.Popen[bytes]":
        if under_pytest:
            file = folder / PYTEST
            file.write_text(PYTEST_TEXT.format(url=stand_url, rig=rig_url, run=str(folder), steps=self.steps))
            command = ["-m", "pytest", "-s", "-q", "-p", "no:cacheprovider", "-c", os.devnull, f"--rootdir={folder}",
                       f"--timeout={TIMEOUT_S}", "--timeout-method=signal", str(file)]
        else:
            command = ["-m", "bench.supervisor.rehearsal", "--url", stand_url, "--run", str(folder), "--steps",
                       str(self.steps), *(["--rig", rig_url] if rig_url else [])]
        return start_control(folder, command)

    def steps_said(self, folder: Path) -> set[int]:
        return {int(line.split()[1]) for line in (folder / OUTPUT).read_text(errors="replace").split("\n")[:-1]
                if line.startswith("step ")}

    def said(self, folder: Path) -> str:
        return (folder / OUTPUT).read_text(errors="replace")[-400:].strip()


def start_control(folder: Path, arguments: list[str]) -> "subprocess.Popen[bytes]":
    """Python with these arguments in a session and group of its own, as a shell starts a job."""
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(
        [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]), "PYTHONUNBUFFERED": "1"}
    with (folder / OUTPUT).open("ab") as output:
        return subprocess.Popen([sys.executable, *arguments], stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                                start_new_session=True, env=environment, cwd=folder)
