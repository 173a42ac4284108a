"""The kill matrix: each way a run can be cut off x each phase of a step, and how long the throttle took to idle.

Everything is real but the device: control process, supervisor and emulated device are processes of their own on real
ports, the cause is a real signal or a pulled cable, and the time is read from the device's own log. A machine that
was too busy to tell gives INCONCLUSIVE, never PASS.
"""

import math
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from bench.journal import FILE_NAME, Records, read_journal
from bench.supervisor.causes import CAUSES, Cause, Stage
from bench.supervisor.control import Control
from bench.supervisor.device_log import DeviceLog, phase
from bench.supervisor.emulated import EmulatedProcess, StarvationProbe
from bench.supervisor.latches import all_latches
from bench.supervisor.log import FILE_NAME as SUPERVISOR_LOG
from bench.verdict import Verdict
from saranga.errors import BenchError, DeviceError, UsageError

PHASES = ("idle", "ramp", "hold", "ramp-down")
QUICK = (("SIGINT", "hold"), ("SIGTERM", "ramp"), ("SIGHUP", "ramp-down"), ("SIGKILL", "hold"),
         ("test timeout", "ramp"), ("hung loop", "hold"), ("rig unplugged", "ramp-down"), ("stand unplugged", "hold"),
         ("supervisor killed", "ramp"), ("supervisor killed", "idle"))
"""Every cause and every phase at least once."""
LIMIT_MS = 200.0
DEAD_MAN_MS = 150.0
STARVED_MS = 15.0
"""A probe that sleeps 2 ms and wakes this much too late shows that nobody got the processor in time."""
WATCH_S = 0.6
LONGEST_WATCH_S = 3.0
PHASE_TIMEOUT_S = 60.0
EXIT_TIMEOUT_S = 30.0
FAILED = math.inf


@dataclass
class Cell:
    """One cause in one phase. `ms_to_idle` is infinite when the throttle never came to idle."""

    cause: str
    phase: str
    ms_to_idle: float = FAILED
    dead_man_ms: float | None = None
    """Last command to idle, where the device idled by itself."""
    late_ms: float = 0.0
    """How late a process got the processor meanwhile, at worst."""
    steps_kept: int = 0
    control_exit: int | None = None
    verdict_of_run: str | None = None
    resumed: bool = False
    faults: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> Verdict:
        """PASS only when everything held."""
        if self.faults:
            return Verdict.FAIL
        slow = self.ms_to_idle > LIMIT_MS or (self.dead_man_ms or 0.0) > DEAD_MAN_MS + 5.0
        if slow:
            return Verdict.INCONCLUSIVE if self.late_ms > STARVED_MS and self.ms_to_idle < FAILED else Verdict.FAIL
        return Verdict.PASS

    @property
    def why(self) -> str:
        """One line."""
        if self.faults:
            return "; ".join(self.faults)
        took = f"{self.ms_to_idle:.0f} ms to idle, limit {LIMIT_MS:.0f} ms"
        if self.verdict is Verdict.INCONCLUSIVE:
            return f"{took}, but the machine was busy: a process woke {self.late_ms:.0f} ms late"
        return took

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        ms = self.ms_to_idle if math.isfinite(self.ms_to_idle) else None
        return {**vars(self), "ms_to_idle": ms, "verdict": self.verdict.value, "why": self.why, "origin": "emulated"}


def run_cell(cause_name: str, phase_name: str, folder: Path, control: Control, stand: str) -> Cell:
    """Start everything, cut it off in that phase, look, resume. Leaves no process behind.

    Args:
        folder: new and empty; keeps the journal, the device's log and everybody's output.
        control: how the control process is started.
        stand: the emulated stand's name.

    Raises:
        UsageError: an unknown cause or phase. DeviceError: something did not even come up.
    """
    if cause_name not in CAUSES or phase_name not in PHASES:
        raise UsageError(f"kill matrix: {cause_name!r} in {phase_name!r}: causes are {', '.join(CAUSES)}; phases are "
                         f"{', '.join(PHASES)}")
    cause, cell = CAUSES[cause_name], Cell(cause_name, phase_name)
    with ExitStack() as stack:
        device = stack.enter_context(closing(EmulatedProcess(folder, "device", stand)))
        rig = stack.enter_context(closing(EmulatedProcess(folder, "rig", None))) if cause.own_rig else None
        rig_url = rig.rig_url if rig is not None else None
        process = stack.enter_context(_ended(control.start(folder, device.stand_url, rig_url, cause.under_pytest)))
        log = DeviceLog(device.truth)
        _await_phase(log, phase_name, control, folder, process)
        stage = Stage(process.pid, _supervisor_pid(folder), device, rig)
        _cut_off(cell, cause, stage, log)
        kept = control.steps_said(folder)
        cause.mend(stage)
        _look_at_what_is_left(cell, cause, process, folder, kept)
        log.read()
        if log.idle_since_s() is None:
            cell.faults.append("the throttle came up again after the run was cut off")
        _gone(cell, stage.supervisor_pid)
        _clear_by_the_operator(cell, cause, folder)
        again = stack.enter_context(_ended(control.start(folder, device.stand_url, rig_url, False)))
        _resume(cell, control, again, folder)
    return cell


def run_matrix(cells: Iterable[tuple[str, str]], folder: Path, control: Control, stand: str, jobs: int = 2,
               tell: Callable[[Cell], None] = lambda cell: None) -> list[Cell]:
    """Several cells, `jobs` at a time. A cell that the machine was too busy for gets one more try, alone."""
    wanted = list(cells)

    def one(number: int, attempt: int) -> Cell:
        cause, phase_name = wanted[number]
        place = folder / f"{number:02d}-{cause}-{phase_name}-{attempt}".replace(" ", "-")
        place.mkdir(parents=True)
        try:
            cell = run_cell(cause, phase_name, place, control, stand)
        except BenchError as error:
            cell = Cell(cause, phase_name, faults=[str(error)])
        return cell

    with ThreadPoolExecutor(max(1, jobs)) as pool:
        found = list(pool.map(lambda n: one(n, 1), range(len(wanted))))
    for number, cell in enumerate(found):
        if cell.verdict is Verdict.INCONCLUSIVE:
            found[number] = one(number, 2)
        tell(found[number])
    return found


# ---- one cell, step by step --------------------------------------------------------------------------
def _await_phase(log: DeviceLog, wanted: str, control: Control, folder: Path,
                 process: "subprocess.Popen[bytes]") -> None:
    """Until a step is in the journal and the device is in the phase."""
    end_s = time.monotonic() + PHASE_TIMEOUT_S
    while time.monotonic() < end_s:
        if process.poll() is not None:
            raise DeviceError(f"the control process ended by itself with {process.returncode}: {control.said(folder)}")
        log.read()
        if control.steps_said(folder) and phase(log, control.full_throttle) == wanted:
            return
        time.sleep(0.004)
    raise DeviceError(f"phase {wanted} was not seen within {PHASE_TIMEOUT_S:g} s: {control.said(folder)}")


def _cut_off(cell: Cell, cause: Cause, stage: Stage, log: DeviceLog) -> None:
    with StarvationProbe() as probe:
        time.sleep(0.02)
        began_s = time.monotonic()
        cause.fire(stage)
        end_s = began_s + WATCH_S
        while time.monotonic() < end_s or (log.idle_since_s() is None and time.monotonic() < began_s + LONGEST_WATCH_S):
            time.sleep(0.02)
            log.read()
        since_s = log.idle_since_s()
        if since_s is None:
            cell.faults.append(f"throttle still {log.now():.3f} after {LONGEST_WATCH_S:g} s")
            return
        cell.ms_to_idle = max(0.0, (since_s - began_s) * 1e3)
        if since_s in log.dead_man_s:
            cell.dead_man_ms = (since_s - log.last_command_before(since_s)) * 1e3
        cell.late_ms = probe.worst_ms(began_s - 0.02, began_s + max(0.3, cell.ms_to_idle / 1e3))


def _look_at_what_is_left(cell: Cell, cause: Cause, process: "subprocess.Popen[bytes]", folder: Path, kept: set[int]
                          ) -> None:
    try:
        cell.control_exit = process.wait(EXIT_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        cell.faults.append(f"the control process did not end within {EXIT_TIMEOUT_S:g} s")
    if cell.control_exit == 0:
        cell.faults.append("the control process ended with 0, as if all were well")
    try:
        records = read_journal(folder / FILE_NAME)
    except BenchError as error:
        cell.faults.append(str(error))
        return
    steps = _steps(records)
    cell.steps_kept = len(steps)
    lost = kept - set(steps)
    if lost or records.damaged_lines:
        cell.faults.append(f"journal: finished steps {sorted(lost)} lost, damaged lines {records.damaged_lines}")
    cell.verdict_of_run = str(records.end["verdict"]) if records.end else None
    if cell.verdict_of_run in ("PASS", "MARGINAL"):
        cell.faults.append("the run that was cut off says PASS")


def _gone(cell: Cell, pid: int) -> None:
    end_s = time.monotonic() + 5.0
    while time.monotonic() < end_s:
        with suppress(psutil.Error):
            if psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                time.sleep(0.02)
                continue
        return
    cell.faults.append("the supervisor is still there 5 s after the run ended")


def _clear_by_the_operator(cell: Cell, cause: Cause, folder: Path) -> None:
    latched = all_latches(folder)
    if bool(latched) != cause.latches:
        trips = [t.name for _, found in latched.values() for t in found]
        cell.faults.append(f"latched trips {trips}, expected {'some' if cause.latches else 'none'}")
    for path in latched:
        path.unlink()


def _resume(cell: Cell, control: Control, process: "subprocess.Popen[bytes]", folder: Path) -> None:
    try:
        code: int | None = process.wait(PHASE_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        code = None
    records = read_journal(folder / FILE_NAME)
    verdict = records.end["verdict"] if records.end else None
    cell.resumed = code == 0 and verdict == "PASS" and _steps(records) == list(range(control.steps))
    if not cell.resumed:
        cell.faults.append(f"resumed: exit {code}, verdict {verdict}, steps {_steps(records)} of {control.steps}: "
                           f"{control.said(folder)}")


def _steps(records: Records) -> list[int]:
    return [r["step"] for r in records.of("step")]


def _supervisor_pid(folder: Path) -> int:
    return int(read_journal(folder / SUPERVISOR_LOG).of("start")[-1]["pid"])


@contextmanager
def _ended(process: "subprocess.Popen[bytes]") -> Iterator["subprocess.Popen[bytes]"]:
    """At the end of the block the process is gone, stopped by a signal or not."""
    try:
        yield process
    finally:
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
