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
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import psutil

from bench.journal import read_journal
from bench.supervisor.causes import CAUSES, PHASES, Cause, Stage
from bench.supervisor.control import last_words, read_outcome, run_has_devices, start_control, steps_said
from bench.supervisor.control_process import STEPS, THROTTLE, run_folder
from bench.supervisor.device_log import DeviceLog, phase
from bench.supervisor.emulated import Bay, StarvationProbe, go_first
from bench.supervisor.guard import Timing
from bench.supervisor.latches import all_latches
from bench.supervisor.log import FILE_NAME as SUPERVISOR_LOG
from bench.verdict import Verdict
from saranga.errors import BenchError, DeviceError, UsageError

QUICK = (("SIGINT", "hold"), ("SIGTERM", "idle"), ("SIGHUP", "ramp-down"), ("SIGKILL", "hold"),
         ("test timeout", "ramp"), ("hung loop", "hold"), ("rig unplugged", "ramp-down"), ("stand unplugged", "hold"),
         ("supervisor killed", "ramp"))
"""Every cause and every phase at least once."""
LIMIT_MS = 200.0
DEAD_MAN_MS = 150.0
TOKEN_TIMEOUT_MS = 1e3 * Timing.token_timeout_s
STARVED_MS = 15.0
"""A probe that sleeps 2 ms and wakes this much too late shows that nobody got the processor in time."""
WATCH_S = 0.6
LONGEST_WATCH_S = 3.0
PHASE_TIMEOUT_S = 60.0
EXIT_TIMEOUT_S = 30.0
FAILED = math.inf
STAND = "f4"
STARVATION_TRIPS = {"held-up", "control", "unconfirmed", "readback"}


@dataclass
class Cell:
    """One cause in one phase. `ms_to_idle` is infinite when the throttle never came to idle."""

    cause: str
    phase: str
    ms_to_idle: float = FAILED
    dead_man_ms: float | None = None
    """Last command to idle, where the device idled by itself."""
    late_ms: float = 0.0
    """How late a waiting process got the processor while the throttle came down, at worst."""
    overslept_ms: float = 0.0
    """How late the supervisor got it, at worst of the whole run."""
    steps_kept: int = 0
    control_exit: int | None = None
    verdict_of_run: str | None = None
    began_s: float = math.nan
    """When the phase was there, monotonic."""
    resumed: bool = False
    verdict_resumed: str | None = None
    starved: bool = False
    """Trips that only a machine too busy to run the processes can explain."""
    faults: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> Verdict:
        """PASS only when everything held."""
        if self.faults:
            return Verdict.FAIL
        if self.starved:
            return Verdict.INCONCLUSIVE
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
        if self.starved:
            return f"{took}, but the machine was too busy: a loop that must run every 100 ms did not"
        if self.verdict is Verdict.INCONCLUSIVE:
            return f"{took}, but the machine was busy: a process woke {self.late_ms:.0f} ms late"
        return took

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        ms = self.ms_to_idle if math.isfinite(self.ms_to_idle) else None
        kept = {k: v for k, v in vars(self).items() if k != "began_s"}
        return {**kept, "ms_to_idle": ms, "verdict": self.verdict.value, "why": self.why, "origin": "emulated"}


def run_cell(cause_name: str, phase_name: str, folder: Path, bay: Bay) -> Cell:
    """Start everything, cut it off in that phase, look, resume. Leaves no process behind.

    Args:
        folder: new and empty; keeps the journal, the device's log and everybody's output.
        bay: the emulated devices to use.

    Raises:
        UsageError: an unknown cause or phase. DeviceError: something did not even come up.
    """
    if cause_name not in CAUSES or phase_name not in PHASES:
        raise UsageError(f"kill matrix: {cause_name!r} in {phase_name!r}: causes are {', '.join(CAUSES)}; phases are "
                         f"{', '.join(PHASES)}")
    cause, cell = CAUSES[cause_name], Cell(cause_name, phase_name)
    device, rig = bay.device, bay.own_rig() if cause.own_rig else None
    rig_url = rig.rig_url if rig is not None else None
    log = DeviceLog(device.truth, _offset=device.truth.stat().st_size)
    with _ended(start_control(folder, device.stand_url, rig_url, cause.under_pytest)) as process:
        _await_phase(log, phase_name, folder, process)
        cell.began_s = time.monotonic()
        stage = Stage(process.pid, _supervisor_pid(folder), device, rig)
        with ExitStack() as mended:
            mended.callback(cause.mend, stage)
            _cut_off(cell, cause, stage, log)
            said = steps_said(folder)
        _look_at_what_is_left(cell, process, folder, said)
    log.read()
    if log.idle_since_s() is None:
        cell.faults.append("the throttle came up again after the run was cut off")
    _gone(cell, stage.supervisor_pid)
    _judge_the_supervisors_log(cell, cause, folder)
    with _ended(start_control(folder, device.stand_url, rig_url, False)) as again:
        _resume(cell, again, folder)
    return cell


def run_matrix(cells: Iterable[tuple[str, str]], folder: Path, stand: str = STAND, jobs: int = 2,
               tell: Callable[[Cell], None] = lambda cell: None) -> list[Cell]:
    """Several cells, `jobs` at a time. A cell that the machine was too busy for gets one more try, alone.

    Args:
        folder: new; a subfolder a cell.
        stand: name of an emulated motor and propeller in fixtures/thrust.

    Raises:
        DeviceError: the emulated devices do not come up.
    """
    wanted = list(cells)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # started by nohup: the sweeps would inherit that
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    bays: SimpleQueue[Bay] = SimpleQueue()

    def one(number: int, attempt: int) -> Cell:
        cause, phase_name = wanted[number]
        place = folder / f"{number:02d}-{cause}-{phase_name}-{attempt}".replace(" ", "-")
        place.mkdir(parents=True)
        bay = bays.get()
        try:
            cell = run_cell(cause, phase_name, place, bay)
        except BenchError as error:
            cell = Cell(cause, phase_name, faults=[str(error)])
        finally:
            bays.put(bay)
        tell(cell)
        return cell

    with ExitStack() as stack:
        for number in range(max(1, min(jobs, len(wanted)))):  # one by one: the first may have to compile
            bay = Bay(folder / f"bay-{number}", stand)
            stack.callback(bay.close)
            bays.put(bay)
        with ThreadPoolExecutor(bays.qsize()) as pool:
            found = list(pool.map(lambda n: one(n, 1), range(len(wanted))))
        return [one(n, 2) if cell.verdict is Verdict.INCONCLUSIVE else cell for n, cell in enumerate(found)]


# ---- one cell, step by step --------------------------------------------------------------------------
def _await_phase(log: DeviceLog, wanted: str, folder: Path, process: "subprocess.Popen[bytes]") -> None:
    """Until a step is in the journal and the device is in the phase."""
    begun = False
    end_s = time.monotonic() + PHASE_TIMEOUT_S
    while time.monotonic() < end_s:
        if process.poll() is not None:
            raise DeviceError(f"the control process ended by itself with {process.returncode}: {last_words(folder)}")
        if not begun:
            begun = bool(steps_said(folder))
            if begun:
                go_first(process.pid)  # what else runs on this machine shall not enter
            time.sleep(0.05)
            continue
        log.read()
        if phase(log, THROTTLE) == wanted:
            return
        time.sleep(0.004)
    raise DeviceError(f"phase {wanted} was not seen within {PHASE_TIMEOUT_S:g} s: {last_words(folder)}")


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


def _look_at_what_is_left(cell: Cell, process: "subprocess.Popen[bytes]", folder: Path, said: set[int]) -> None:
    try:
        cell.control_exit = process.wait(EXIT_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        cell.faults.append(f"the control process did not end within {EXIT_TIMEOUT_S:g} s")
    cut_off = cell.phase not in CAUSES[cell.cause].survived_in
    if cell.control_exit == 0 and cut_off:
        cell.faults.append("the control process ended with 0, as if all were well")
    outcome = read_outcome(folder)
    cell.steps_kept, cell.verdict_of_run = len(outcome.steps), outcome.verdict
    lost = said - set(outcome.steps)
    if outcome.error or lost or outcome.damaged_lines:
        cell.faults.append(f"record: {outcome.error or ''} finished steps lost: {sorted(lost)}, damaged lines: "
                           f"{outcome.damaged_lines}")
    if outcome.verdict in ("PASS", "MARGINAL") and cut_off:
        cell.faults.append(f"the run that was cut off says {outcome.verdict}")


def _gone(cell: Cell, pid: int) -> None:
    end_s = time.monotonic() + 5.0
    while time.monotonic() < end_s:
        with suppress(psutil.Error):
            if psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                time.sleep(0.02)
                continue
        return
    cell.faults.append("the supervisor is still there 5 s after the run ended")


def _judge_the_supervisors_log(cell: Cell, cause: Cause, folder: Path) -> None:
    """Trips are latched where they must be and nowhere else; then the operator clears them."""
    run = run_folder(folder)
    assert run is not None
    records = read_journal(run / SUPERVISOR_LOG)
    if records.end is not None:
        cell.overslept_ms = float(records.end["overslept_ms"])
    if [t for t in records.of("trip") if t["monotonic_s"] < cell.began_s]:
        cell.starved = True  # it had been cut off already, by a loop that did not get the processor
    latched = all_latches(run)
    names = [t.name for _, found in latched.values() for t in found]
    wanted = cell.phase in cause.latches
    if bool(names) != wanted:
        # A process that takes longer to die than its silence is allowed to last trips as a silent one does.
        slow = max(cell.late_ms, cell.overslept_ms) > STARVED_MS or cell.ms_to_idle > TOKEN_TIMEOUT_MS
        if slow and set(names) <= STARVATION_TRIPS:
            cell.starved = True
        elif not cell.starved:
            cell.faults.append(f"latched trips {names}, expected {'some' if wanted else 'none'}")
    for path in latched:
        path.unlink()


def _resume(cell: Cell, process: "subprocess.Popen[bytes]", folder: Path) -> None:
    end_s = time.monotonic() + PHASE_TIMEOUT_S
    while process.poll() is None and time.monotonic() < end_s and not run_has_devices(folder, 2):
        time.sleep(0.02)
    go_first(process.pid)
    try:
        code: int | None = process.wait(PHASE_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        code = None
    outcome = read_outcome(folder)
    cell.verdict_resumed = outcome.verdict
    cell.resumed = outcome.state == "finished" and outcome.steps == list(range(STEPS))
    run = run_folder(folder)
    tripped = {t.name for _, found in all_latches(run).values() for t in found} if run is not None else set()
    if not cell.resumed and tripped and tripped <= STARVATION_TRIPS:
        cell.starved = True  # the resumed run was cut off too, by a loop that did not get the processor
    elif not cell.resumed:
        cell.faults.append(f"resumed: exit {code}, {outcome}: {last_words(folder)}")


def _supervisor_pid(folder: Path) -> int:
    run = run_folder(folder)
    assert run is not None
    return int(read_journal(run / SUPERVISOR_LOG).of("start")[-1]["pid"])


@contextmanager
def _ended(process: "subprocess.Popen[bytes]") -> Iterator["subprocess.Popen[bytes]"]:
    """At the end of the block the process is gone, stopped by a signal or not."""
    try:
        yield process
    finally:
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
