"""A control process as small as can be, for trying interruptions: ramps, holds and journals steps, nothing else.

`python -m bench.supervisor.rehearsal --help`. What it spins must be emulated: it refuses any other device.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.interrupt import EXIT_INTERRUPTED, Interrupts, interruptible
from bench.journal import FILE_NAME, Journal, read_journal
from bench.supervisor.client import Supervisor
from bench.supervisor.limits import Limits
from bench.supervisor.plan import Confirmation, SupervisorPlan
from saranga.byte_links import TcpLink
from saranga.errors import BenchError, UsageError
from saranga.framing import encode
from saranga.messages import MODE_RECEIVE_ONLY, Start

THROTTLE = 0.4
SLEW_PER_S = 1.0
HOLD_S = 0.4
IDLE_S = 0.4
LOOP_S = 0.02
LIMITS = Limits(thrust_n=20.0, current_a=60.0, throttle=0.8, slew_per_s=SLEW_PER_S)


class Interrupted(Exception):
    """A signal asked to stop."""


class Rehearsal:
    """Steps of: up, hold, down, rest; each in the journal when it is over."""

    def __init__(self, supervisor: Supervisor, rig: TcpLink, journal: Journal, interrupts: Interrupts) -> None:
        self._supervisor = supervisor
        self._rig = rig
        self._journal = journal
        self._interrupts = interrupts

    def step(self, number: int) -> None:
        """One step."""
        self._supervisor.set(THROTTLE)
        self._loop(lambda: self._supervisor.status().state == "hold")
        end_s = time.monotonic() + HOLD_S
        self._loop(lambda: time.monotonic() > end_s)
        samples = [r.thrust_n for r in self._supervisor.readings()[-10:]]
        self._supervisor.set(0.0)
        self._loop(lambda: self._supervisor.status().state == "idle")
        end_s = time.monotonic() + IDLE_S
        self._loop(lambda: time.monotonic() > end_s)
        self._journal.append("step", step=number, thrust_n=sum(samples) / len(samples), n=len(samples),
                             origin=self._supervisor.origin)
        print(f"step {number}", flush=True)

    def _loop(self, done: Callable[[], bool]) -> None:
        """The control loop: look at the rig, look at the signals, keep the throttle alive."""
        while not done():
            if self._interrupts.asked():
                raise Interrupted(self._interrupts.signal_name)
            self._rig.read(LOOP_S)
            self._supervisor.refresh()
            time.sleep(0.005)


def rehearse(url: str, rig_url: str | None, folder: Path, steps: int) -> str:
    """Run what the journal in `folder` does not hold yet. Returns the verdict, which also ends the journal.

    Raises:
        UsageError: the device is not emulated. DeviceError: a device or the supervisor is gone, or a trip.
    """
    journal = Journal(folder / FILE_NAME)
    if journal.path.stat().st_size == 0:
        journal.append("header", format=1, run_kind="rehearsal", steps=steps)
    done = {r["step"] for r in read_journal(journal.path).of("step")}
    plan = SupervisorPlan(url, url, LIMITS, log_folder=folder)
    verdict, why = "ERROR", "never came to its end"
    try:
        with interruptible() as interrupts, Supervisor.start(plan, Confirmation.flag()) as supervisor:
            if supervisor.origin != "emulated":
                raise UsageError(f"{url}: is {supervisor.origin}, a rehearsal spins emulated devices only")
            rig = _open_rig(rig_url or supervisor.rig_url)
            try:
                run = Rehearsal(supervisor, rig, journal, interrupts)
                for number in range(steps):
                    if number not in done:
                        run.step(number)
            finally:
                report = supervisor.stop()
                rig.close()
        verdict, why = ("PASS", "") if report.confirmed and not report.trips else ("ERROR", report.text)
    except Interrupted as error:
        verdict, why = "INCONCLUSIVE", f"interrupted by {error}"
    except BaseException as error:
        why = str(error) or type(error).__name__
        raise
    finally:
        journal.append("end", verdict=verdict, why=why)
        journal.close()
    return verdict


def _open_rig(url: str | None) -> TcpLink:
    if url is None:
        raise UsageError("no rig: give --rig")
    host, _, port = url.removeprefix("tcp://").rpartition(":")
    rig = TcpLink(url, host, int(port))
    rig.open()
    rig.write(encode(Start(mode=MODE_RECEIVE_ONLY, rate_hz=40.0)))
    return rig


def main() -> int:
    """Exit code as of every command of the bench."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", required=True, help="stand and throttle, emulated")
    parser.add_argument("--rig", help="the rig, when it has a port of its own")
    parser.add_argument("--run", type=Path, required=True, help="folder with, or for, the journal")
    parser.add_argument("--steps", type=int, default=3)
    arguments = parser.parse_args()
    try:
        verdict = rehearse(arguments.url, arguments.rig, arguments.run, arguments.steps)
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return {"PASS": 0, "INCONCLUSIVE": EXIT_INTERRUPTED}.get(verdict, 4)


if __name__ == "__main__":
    sys.exit(main())
