"""The supervisor's process: devices, guard and channel tied together in one loop. Nothing here decides anything.

It leaves only when it has idled: by `stop`, by the end of the channel (the control process died, however), or by a
signal. Should it be killed itself, the device idles by the deadline of the last command.
"""

import contextlib
import math
import os
import select
import signal
import time
from dataclasses import asdict
from types import FrameType

from bench.supervisor.channel import Channel
from bench.supervisor.devices import Devices, open_devices
from bench.supervisor.guard import Event, Guard
from bench.supervisor.latches import Latches, state_folder
from bench.supervisor.log import Log
from bench.supervisor.plan import CLEAR_WORD, Confirmation, StopReport, SupervisorPlan, SupervisorStatus
from bench.thrust_stand.protocol import StandReading
from saranga.errors import BenchError, DeviceError

PERIOD_S = 0.01
COMMAND_PERIOD_S = 0.02
STATUS_PERIOD_S = 0.05
REALTIME_PRIORITY = 2
FIRST_READING_S = 2.0
"""How long starting waits for the first measurement of everything that has a limit; `set` looks again."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Worker:
    """One run of the loop."""

    def __init__(self, channel: Channel, plan: SupervisorPlan, confirmation: Confirmation, devices: Devices) -> None:
        self._channel = channel
        self._plan = plan
        self._devices = devices
        folder = plan.latch_folder
        if folder is None:
            folder = state_folder() if devices.origin != "emulated" else plan.log_folder
        self._latches = Latches(folder, plan.throttle_url)
        latched = self._latches.load()
        confirmed = confirmation.allows_spinning(devices.origin)
        self.guard = Guard(plan.limits, plan.timing(), confirmed, devices.throttle.readback, latched)
        self.log = Log(plan.log_folder, plan=plan.to_dict(), confirmed=confirmed, origin=devices.origin,
                        stand=devices.describe(), latched=[asdict(t) for t in latched], pid=os.getpid())
        self._throttle_lost = False
        self._stand_lost = False
        self._ready = False
        self.overslept_s = 0.0
        """How late the computer woke this process at worst."""
        self._signal: str | None = None
        self._last: StandReading | None = None
        self._status_s = -math.inf
        self._latched_names = set(self.guard.trips)
        self._sent = (-math.inf, math.nan)

    def run(self) -> StopReport:
        """Until the throttle idles for good."""
        opened_s = time.monotonic()
        poll = select.poll()
        poll.register(self._channel.fileno(), select.POLLIN)
        due_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            self._hear(now_s)
            self._measure(now_s)
            self._command(now_s)
            self._pump_tee(now_s)
            if not self._ready and (self.guard.measured_all or now_s - opened_s > FIRST_READING_S):
                self._say_ready(now_s)
            self._tell(now_s)
            if self._finished():
                return self._leave()
            due_s = max(due_s + PERIOD_S, now_s)
            if self._channel.ended:
                time.sleep(max(0.0, due_s - time.monotonic()))
            else:
                poll.poll(max(0.0, due_s - time.monotonic()) * 1e3)
            self.overslept_s = max(self.overslept_s, time.monotonic() - due_s)

    def signalled(self, number: int, frame: FrameType | None) -> None:
        """The signal handler: only remembers it."""
        self._signal = signal.Signals(number).name

    # ---- in ----------------------------------------------------------------------------------------
    def _hear(self, now_s: float) -> None:
        guard = self.guard
        for message in self._channel.receive():
            if "set" in message:
                guard.set(float(message["set"]), now_s)
            elif "refresh" in message:
                guard.refresh(now_s)
            elif "stop" in message:
                guard.stop(str(message["stop"]), now_s)
            elif "clear" in message:
                self._clear(str(message["clear"]), now_s)
            elif "tare" in message:
                self._tare()
        if self._channel.ended:
            guard.stop("the control process has gone", now_s)
        if self._signal is not None:
            guard.stop(f"{self._signal} to the supervisor", now_s)

    def _measure(self, now_s: float) -> None:
        stand = self._devices.stand
        if stand is None or self._stand_lost:
            return
        try:
            readings = stand.read(0.0)
        except DeviceError as error:
            self._stand_lost = True
            self.guard.trip("stand-lost", str(error), now_s)
            return
        for reading in readings:
            self.guard.reading(reading, now_s)
        if readings:
            self._last = readings[-1]
            self._channel.offer({"readings": [list(asdict(r).values()) for r in readings]})

    # ---- out ---------------------------------------------------------------------------------------
    def _command(self, now_s: float) -> None:
        value = self.guard.tick(now_s)
        throttle = self._devices.throttle
        if self._throttle_lost:
            return
        try:
            if value != self._sent[1] or now_s - self._sent[0] > COMMAND_PERIOD_S - PERIOD_S / 2:
                self._sent = (now_s, value)
                throttle.command(value, self.guard.token, self._plan.deadline_s)
            applied = throttle.applied() if throttle.readback else None
        except DeviceError as error:
            self._throttle_lost = True
            self.guard.trip("throttle-lost", f"{error}; its dead-man idles it within {self._plan.deadline_s * 1e3:.0f} "
                                             "ms of the last command", now_s)
            return
        if applied is not None:
            self.guard.applied(*applied, now_s)

    def _pump_tee(self, now_s: float) -> None:
        devices = self._devices
        if devices.tee is None or devices.link is None or self._throttle_lost:
            return
        try:
            devices.tee.pump(devices.link)
        except DeviceError as error:
            self._throttle_lost = True
            self.guard.trip("throttle-lost", str(error), now_s)

    def _tell(self, now_s: float) -> None:
        events, self.guard.events = self.guard.events, []
        for event in events:
            self._note(event)
        new = set(self.guard.trips) - self._latched_names
        if new and self.guard.command == 0:  # not before: a slow disk must not hold up the ramp
            self._latched_names |= new
            try:
                self._latches.save(list(self.guard.trips.values()))
            except BenchError as error:
                _shout(str(error))
        if events or now_s - self._status_s >= STATUS_PERIOD_S:
            self._send_status(now_s)

    def _say_ready(self, now_s: float) -> None:
        self._ready = True
        self._send_status(now_s)
        self._channel.offer({"ready": {**self._devices.describe(), "rig_url": self._devices.rig_url,
                                       "confirmed": self.guard.confirmed, "origin": self._devices.origin}})

    def _note(self, event: Event) -> None:
        applied = self.guard.applied_throttle
        self.log.add(event.kind, monotonic_s=event.time_s, text=event.text, commanded=self.guard.command,
                      applied=None if math.isnan(applied) else applied, **event.values)
        if event.kind == "trip":
            _shout(f"throttle taken away: {event.values['name']}: {event.text}")
        if event.kind == "unconfirmed":
            _shout(f"{event.text}{self._what_the_stand_says()}")

    def _send_status(self, now_s: float) -> None:
        self._status_s = now_s
        guard, tee = self.guard, self._devices.tee
        status = SupervisorStatus(guard.state, guard.target, guard.command, guard.applied_throttle,
                                  tuple(guard.trips.values()), guard.why(), guard.confirmed,
                                  tee.refused if tee else 0, tee.dropped_bytes if tee else 0)
        self._channel.offer({"status": asdict(status)})

    def _what_the_stand_says(self) -> str:
        last = self._last
        if last is None:
            return ""
        known = {"thrust": (last.thrust_n, "N"), "rpm": (last.rpm, "1/min"), "current": (last.current_a, "A")}
        words = [f"{name} {value:.3g} {unit}" for name, (value, unit) in known.items() if math.isfinite(value)]
        return f"; the stand last said {', '.join(words)}" if words else ""

    # ---- the operator ------------------------------------------------------------------------------
    def _clear(self, text: str, now_s: float) -> None:
        if text != CLEAR_WORD:
            self._channel.offer({"cleared": False, "text": f"{text!r} was typed, not {CLEAR_WORD}"})
        elif self._stand_lost or self._throttle_lost:
            self._channel.offer({"cleared": False, "text": "a device is lost: plug it in and start again"})
        elif not self.guard.clear(now_s):
            self._channel.offer({"cleared": False, "text": "not at idle"})
        else:
            self._latched_names.clear()
            self._latches.remove()
            self._channel.offer({"cleared": True, "text": ""})

    def _tare(self) -> None:
        stand = self._devices.stand
        if stand is None or self.guard.spinning or self._stand_lost:
            self._channel.offer({"tare": None, "text": "no stand, or not at idle"})
            return
        try:
            self._channel.offer({"tare": stand.tare(), "text": ""})
        except BenchError as error:
            self._channel.offer({"tare": None, "text": str(error)})

    # ---- the end -----------------------------------------------------------------------------------
    def _finished(self) -> bool:
        guard = self.guard
        if guard.stopping is None or guard.command > 0:
            return False
        return guard.unconfirmed or not math.isnan(guard.idle_confirmed_s)

    def _leave(self) -> StopReport:
        guard = self.guard
        confirmed = not math.isnan(guard.idle_confirmed_s)
        seconds = guard.idle_confirmed_s - guard.cut_asked_s
        if confirmed:
            text = f"idle, as the device itself says, {seconds * 1e3:.0f} ms after it was to"
        else:
            text = "STOP NOT CONFIRMED by the device" + self._what_the_stand_says()
        report = StopReport(confirmed, seconds, text, tuple(guard.trips.values()))
        self._send_status(time.monotonic())
        self._channel.offer({"stopped": asdict(report)})
        self.log.add("end", monotonic_s=time.monotonic(), confirmed=confirmed, text=text, why=guard.stopping,
                     seconds=seconds if confirmed else None, trips=[asdict(t) for t in report.trips],
                     overslept_ms=self.overslept_s * 1e3)
        self.log.close()
        return report


def _shout(text: str) -> None:
    with contextlib.suppress(OSError):  # The terminal may have gone; that must not stop the stopping.
        os.write(2, f"\nSUPERVISOR: {text}\n".encode())


def go_first() -> str:
    """Ask for real-time scheduling, else for a better share; says what was given. A busy computer must not be able to
    hold up the throttle. Needs no privilege to be tried; docs/safety.md says how to be allowed to.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(REALTIME_PRIORITY))
        return "real-time"
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
        return "nice -10"
    return "ordinary"


def serve(channel: Channel, plan: SupervisorPlan, confirmation: Confirmation) -> int:
    """Open, run, close. Errors go to the control process. Returns the exit code."""
    try:
        devices = open_devices(plan)
    except BenchError as error:
        channel.offer({"error": str(error), "exit_code": error.exit_code})
        return error.exit_code
    try:
        worker = Worker(channel, plan, confirmation, devices)
        worker.log.add("priority", text=go_first())
        before = {number: signal.signal(number, worker.signalled) for number in SIGNALS}
        try:
            report = worker.run()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    except BenchError as error:
        channel.offer({"error": str(error), "exit_code": error.exit_code})
        return error.exit_code
    finally:
        devices.close()
    return 0 if report.confirmed else DeviceError.exit_code
