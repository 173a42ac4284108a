"""The control loop's end of the supervisor."""

import contextlib
import math
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from bench.supervisor.channel import Channel
from bench.supervisor.guard import Trip
from bench.supervisor.plan import Confirmation, StopReport, SupervisorPlan, SupervisorStatus
from bench.thrust_stand.protocol import StandReading
from saranga.errors import BenchError, DeviceError, UsageError

START_TIMEOUT_S = 30.0
SEND_TIMEOUT_S = 0.5
SILENT_S = 1.0
ANSWER_TIMEOUT_S = 5.0
KEPT_READINGS = 20_000


class Supervisor:
    """A running supervisor process; use `Supervisor.start(...)` in a `with` block, which stops it at its end.

    Only what the control loop itself does keeps the throttle up: call `set` or `refresh` at 20 Hz or faster while the
    target is above 0, from the loop that looks at the measurements, never from a thread or timer of their own.
    """

    def __init__(self, plan: SupervisorPlan, confirmation: Confirmation) -> None:
        self.plan = plan
        ours, theirs = socket.socketpair()
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(
            [str(Path(__file__).resolve().parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])}
        with theirs:
            # A session of its own: Ctrl-C in the terminal is for the control process, the throttle ramps down in order.
            self._process = subprocess.Popen(
                [sys.executable, "-m", "bench.supervisor", str(theirs.fileno())], pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True, env=environment)
        self._channel = Channel(ours)
        self._status = SupervisorStatus("idle")
        self._heard_s = time.monotonic()
        self._readings: list[StandReading] = []
        self._ready: dict[str, Any] | None = None
        self._error: BenchError | None = None
        self._report: StopReport | None = None
        self._answer: dict[str, Any] | None = None
        self.lost_readings = 0
        self._channel.send({"plan": plan.to_dict(), "confirmation": asdict(confirmation)}, SEND_TIMEOUT_S)

    @classmethod
    def start(cls, plan: SupervisorPlan, confirm: Confirmation) -> "Supervisor":
        """Start the process and open the devices. Nothing spins yet, and trips of earlier runs stay latched.

        Raises:
            UsageError: a limit that nothing measures, or timing out of bounds. DeviceError: a device is missing or
            wrong, or the process did not come up.
        """
        plan.timing()
        supervisor = cls(plan, confirm)
        try:
            supervisor._await(lambda: supervisor._ready is not None, START_TIMEOUT_S)
            if supervisor._error is not None:
                raise supervisor._error
            if supervisor._ready is None:
                raise DeviceError(f"supervisor: did not come up within {START_TIMEOUT_S:g} s: nothing spins")
        except BaseException:
            supervisor._end()
            raise
        return supervisor

    # ---- what it is --------------------------------------------------------------------------------
    @property
    def pid(self) -> int:
        """Of the supervisor process."""
        return self._process.pid

    @property
    def rig_url(self) -> str | None:
        """Where the rig on the same device is to be opened, None when it has a port of its own."""
        return self._told()["rig_url"]

    @property
    def confirmed(self) -> bool:
        """Whether the confirmation is enough for this device."""
        return bool(self._told()["confirmed"])

    @property
    def origin(self) -> str:
        """measured, emulated or recorded: what readings of this stand are."""
        return str(self._told()["origin"])

    @property
    def stand(self) -> dict[str, Any]:
        """What the stand says of itself: name, firmware, quantities, origin, has_throttle, dead_man_s."""
        return dict(self._told()["stand"] or {})

    # ---- the loop ----------------------------------------------------------------------------------
    def set(self, value: float) -> None:
        """Target throttle 0..1, and a sign of life.

        Raises:
            UsageError: a value that is not allowed, or nobody has confirmed.
            DeviceError: a trip is latched, or the supervisor is gone; the text says why.
        """
        if not math.isfinite(value) or not 0 <= value <= self.plan.limits.throttle:
            raise UsageError(f"throttle {value!r}: allowed are 0 to {self.plan.limits.throttle:g} (limits.throttle)")
        if value > 0 and not self.confirmed:
            raise UsageError(f"nothing spins unconfirmed: the origin is {self.origin}: type SPIN when asked "
                             "(--yes-spin is enough only for emulated devices)")
        self._say({"set": float(value)}, check=value > 0)

    def refresh(self) -> None:
        """The loop is alive and wants what it wanted. Raises DeviceError as `set` does."""
        self._say({"refresh": 1}, check=True)

    def readings(self) -> list[StandReading]:
        """Samples of the stand since the last call."""
        self._drain()
        found, self._readings = self._readings, []
        return found

    def status(self) -> SupervisorStatus:
        """The latest the supervisor said; state "stopped" with the reason once it is gone."""
        self._drain()
        if self._gone() and self._report is None:
            text = self._how_it_died()
            return SupervisorStatus("stopped", trips=(*self._status.trips, Trip("supervisor", text)), why=text)
        return self._status

    def tare(self) -> float:
        """Take the present thrust as zero; only at idle. Returns the offset, N. Raises DeviceError."""
        answer = self._ask({"tare": 1})
        if answer.get("tare") is None:
            raise DeviceError(f"tare: {answer.get('text') or 'no answer'}")
        return float(answer["tare"])

    def clear(self, confirmation: Confirmation) -> None:
        """Clear latched trips; only an operator may (`Confirmation.typed("CLEAR")`), and only at idle.

        Raises:
            UsageError: not confirmed, not at idle, or a device is lost.
        """
        answer = self._ask({"clear": confirmation.text})
        if not answer.get("cleared"):
            raise UsageError(f"trips stay latched: {answer.get('text') or 'the supervisor does not answer'}")
        # A status from before may still be on its way; `set` must not be refused for it.
        self._await(lambda: not self._status.trips, ANSWER_TIMEOUT_S)

    # ---- the end -----------------------------------------------------------------------------------
    def stop(self) -> StopReport:
        """Ramp to idle and end the supervisor. Never raises; the report says whether the device confirmed it."""
        if self._report is None:
            with contextlib.suppress(DeviceError):
                self._channel.send({"stop": "asked to stop"}, SEND_TIMEOUT_S)
            patience_s = self.plan.ramp_down_s + self.plan.confirm_s + ANSWER_TIMEOUT_S
            self._await(lambda: self._report is not None, patience_s)
            if self._report is None:
                self._report = StopReport(False, math.nan, f"STOP NOT CONFIRMED: {self._how_it_died()}; the device's "
                                          f"dead-man idles it {self.plan.deadline_s * 1e3:.0f} ms after the last "
                                          "command, if it has one: keep away, cut the power", self._status.trips)
                print(f"\n{self._report.text}", file=sys.stderr, flush=True)
        self._end()
        return self._report

    def __enter__(self) -> "Supervisor":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        self.stop()

    # ---- inside ------------------------------------------------------------------------------------
    def _told(self) -> dict[str, Any]:
        assert self._ready is not None
        return self._ready

    def _say(self, message: dict[str, Any], check: bool) -> None:
        self._drain()
        if self._report is not None:
            raise DeviceError(f"supervisor: has stopped: {self._status.why or self._report.text}")
        if self._gone():
            raise DeviceError(f"supervisor: {self._how_it_died()}")
        if check and self._status.trips:
            raise DeviceError("throttle taken away and latched: "
                              + "; ".join(f"{t.name}: {t.text}" for t in self._status.trips)
                              + "; find the cause, then `saranga-bench supervisor clear`")
        silent_s = time.monotonic() - self._heard_s
        if silent_s > SILENT_S:
            # Nobody drained for long, or it hangs: what comes now tells.
            self._await(lambda: time.monotonic() - self._heard_s < SILENT_S, 0.2)
            if time.monotonic() - self._heard_s > SILENT_S:
                raise DeviceError(f"supervisor: silent for {silent_s:.1f} s: it hangs; the device's dead-man has idled")
        try:
            self._channel.send(message, SEND_TIMEOUT_S)
        except DeviceError:
            raise DeviceError(f"supervisor: {self._how_it_died()}") from None

    def _ask(self, message: dict[str, Any]) -> dict[str, Any]:
        self._answer = None
        self._say(message, check=False)
        self._await(lambda: self._answer is not None, ANSWER_TIMEOUT_S)
        return self._answer or {}

    def _await(self, done: Callable[[], bool], timeout_s: float) -> None:
        end_s = time.monotonic() + timeout_s
        poll = select.poll()
        poll.register(self._channel.fileno(), select.POLLIN)
        self._drain()
        while not done() and not self._channel.ended and time.monotonic() < end_s:
            poll.poll(max(0.0, end_s - time.monotonic()) * 1e3)
            self._drain()

    def _drain(self) -> None:
        if self._channel.ended:
            return
        for message in self._channel.receive():
            self._heard_s = time.monotonic()
            if "readings" in message:
                self._readings += [StandReading(*values) for values in message["readings"]]
            elif "status" in message:
                self._status = SupervisorStatus.from_dict(message["status"])
            elif "ready" in message:
                self._ready = message["ready"]
            elif "error" in message:
                kind = UsageError if message["exit_code"] == UsageError.exit_code else DeviceError
                self._error = kind(message["error"])
            elif "stopped" in message:
                report = message["stopped"]
                self._report = StopReport(**{**report, "trips": tuple(Trip(**t) for t in report["trips"])})
            else:
                self._answer = message
        if len(self._readings) > KEPT_READINGS:
            self.lost_readings += len(self._readings) - KEPT_READINGS
            del self._readings[:-KEPT_READINGS]

    def _gone(self) -> bool:
        return self._channel.ended

    def _how_it_died(self) -> str:
        if self._error is not None:
            return str(self._error)
        try:
            code = self._process.wait(0.5 if self._channel.ended else 0)
        except subprocess.TimeoutExpired:
            return "the supervisor process does not answer"
        if code < 0:
            return f"the supervisor process was killed by {signal.Signals(-code).name}"
        return f"the supervisor process has ended with code {code}"

    def _end(self) -> None:
        """Hang up: whatever state it is in, the supervisor idles and leaves. It is never killed."""
        self._channel.close()
        try:
            self._process.wait(ANSWER_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            print(f"supervisor: process {self._process.pid} does not end", file=sys.stderr)
