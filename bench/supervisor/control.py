"""The control process that the kill matrix cuts off, seen from outside: started, listened to, its record read."""

import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from bench.journal import FILE_NAME, read_journal
from bench.procedures.sweep_session import rebuild_sweep
from bench.supervisor.control_process import run_folder
from saranga.errors import BenchError

OUTPUT = "control.out"
PYTEST = "test_sweep_under_a_time_out.py"
PYTEST_TEXT = """
from pathlib import Path

from bench.supervisor.control_process import control


def test_sweep():
    assert control({stand!r}, {rig!r}, Path({folder!r})) == 0
"""
TIMEOUT_S = 300


@dataclass
class Outcome:
    """What the record says, rebuilt from the journal alone."""

    steps: list[int] = field(default_factory=list)
    damaged_lines: list[int] = field(default_factory=list)
    state: str | None = None
    verdict: str | None = None
    error: str | None = None


def start_control(folder: Path, stand_url: str, rig_url: str | None, under_pytest: bool) -> "subprocess.Popen[bytes]":
    """Begin the sweep in `folder`, or go on with it, in a session and group of its own as a shell starts a job.

    Args:
        rig_url: where the rig has a port of its own.
        under_pytest: as a test with a time-out.
    """
    if under_pytest:
        file = folder / PYTEST
        file.write_text(PYTEST_TEXT.format(stand=stand_url, rig=rig_url, folder=str(folder)))
        command = ["-m", "pytest", "-s", "-q", "-p", "no:cacheprovider", "-p", "no:saranga_bench", "-c", os.devnull,
                   f"--rootdir={folder}", f"--timeout={TIMEOUT_S}", "--timeout-method=signal", str(file)]
    else:
        command = ["-m", "bench.supervisor.control_process", stand_url, rig_url or "-", str(folder)]
    root = Path(__file__).resolve().parents[2]
    path = os.pathsep.join([str(root), *filter(None, [os.environ.get("PYTHONPATH")])])
    with (folder / OUTPUT).open("ab") as output:
        return subprocess.Popen([sys.executable, *command], stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                                start_new_session=True, env={**os.environ, "PYTHONPATH": path}, cwd=folder)


def steps_said(folder: Path) -> set[int]:
    """Steps that the process itself has said are finished."""
    lines = (folder / OUTPUT).read_text(errors="replace").split("\n")[:-1]
    return {int(line.split()[1]) for line in lines if line.startswith("step ")}


def last_words(folder: Path) -> str:
    """The end of its output."""
    return (folder / OUTPUT).read_text(errors="replace")[-400:].strip()


def run_has_devices(folder: Path, times: int) -> bool:
    """Whether the run has opened its devices that often: everything is imported and compiled by then."""
    run = run_folder(folder)
    return run is not None and len(read_journal(run / FILE_NAME).of("devices")) >= times


def read_outcome(folder: Path) -> Outcome:
    """The record as a report would read it."""
    run = run_folder(folder)
    if run is None:
        return Outcome(error="there is no run folder")
    try:
        records = read_journal(run / FILE_NAME)
        found = Outcome([int(r["step"]) for r in records.of("step")], records.damaged_lines)
        found.state = str(records.end["state"]) if records.end else None
    except BenchError as error:
        return Outcome(error=str(error))
    with suppress(BenchError):  # too little for a summary is no verdict
        found.verdict = str(rebuild_sweep(run)["verdict"])
    return found
