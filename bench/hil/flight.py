"""One flight with a companion in the loop: boot, wait for it, then wall time from arming to landing."""

import contextlib
import functools
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.hil.companion import CommandCompanion, Companion, RemoteCompanion
from bench.hil.ports import StampedPort
from bench.hil.timing import WireTiming
from saranga.errors import DeviceError
from saranga.navigate import DEFAULT_SONAR
from sitl.autopilot import make_autopilot
from sitl.clock import Periodic
from sitl.flight_log import FlightRecorder
from sitl.ground_control import Phase
from sitl.live import Shadow, refuse_faults_inside_stack
from sitl.rig_ports import TcpPort
from sitl.scene import build_scene, load_scene
from sitl.trial import PROGRESS_US, Cancel, Progress, collect, ended, progress_of, run_trial
from sitl.trial_types import Faults, TrialRequest, TrialResult
from sitl.world import World

SAY_EVERY_S = 10.0
POLL_S = 0.01
LEAST_WAIT_S = 0.0005
# A busy machine makes simulated time late rather than hurried: further behind than this, the schedule is moved back.
BEHIND_LIMIT_S = 0.1
# More than this share of the flight moved back is no wall time any more, and not worth judging.
SLIP_LIMIT = 0.25
SLIP_FREE_S = 3.0


@dataclass
class HilSetup:
    """Where to listen, what to start, how long to wait for it. Ports that were 0 keep the number they got."""

    echoes: tuple[str, int]
    vehicle: tuple[str, int]
    command: tuple[str, ...] = ()
    wait_s: float = 120.0
    note: Callable[[str], None] = field(default=lambda text: None)


class CompanionGone(DeviceError):
    """The companion has hung up."""


class HilFlight:
    """World, ports and companion of one flight.

    Raises:
        DeviceError: a port that is taken, or an autopilot that cannot be started.
    """

    def __init__(self, request: TrialRequest, setup: HilSetup, folder: Path, closing: contextlib.ExitStack) -> None:
        self.request, self.setup, self._folder = request, setup, folder
        self.rig_port = TcpPort(setup.echoes[1], setup.echoes[0])
        closing.callback(self.rig_port.close)
        self.mav_port = closing.enter_context(contextlib.closing(StampedPort(*setup.vehicle)))
        setup.echoes = setup.echoes[0], int(self.rig_port.url.rpartition(":")[2])
        setup.vehicle = setup.vehicle[0], int(self.mav_port.url.rpartition(":")[2])
        scene = build_scene(load_scene(request.scene), request.seed)
        autopilot, parameters = make_autopilot(request.autopilot, request.seed, folder)
        closing.callback(autopilot.close)
        self.world = World(scene, autopilot, request.sonar, request.shield, request.seed, request.faults or Faults(),
                           parameters)
        self.world.ground.hold = True
        self.shadow = Shadow(self.world)
        self.timing = WireTiming()
        self.mav_port.hear = self._hear
        self.recorder = FlightRecorder(scene, self.world.volume) if request.keep_log else None
        self.companion: Companion = RemoteCompanion()
        self.slipped_s = 0.0
        self.boot_us = 0
        self._closing = closing

    def _hear(self, data: bytes, now_s: float) -> None:
        self.timing.hear(data, now_s)
        self.shadow.saw_mavlink(data)

    def _serve_rig(self) -> None:
        asked = self.rig_port.read()
        if asked:
            answer = self.world.rig.receive(asked, self.world.t_us)
            self.rig_port.write(answer)
            self.shadow.source.feed(answer)

    # ---- before ------------------------------------------------------------------------------------
    def boot(self, cancel: Cancel) -> tuple[str, str] | None:
        """As fast as the machine allows, until only arming is left; nobody is needed for that."""
        world = self.world
        world.start()
        while not world.ground.ready_to_arm:
            tick = world.tick(b"")
            if tick.stack_due:
                self._serve_rig()
                cause = ended(world, None, tick.t_us, self.request.max_sim_s)
                if cause is not None:
                    return cause
                if cancel():
                    return "interrupted", "interrupted by the operator"
        return None

    def await_companion(self, cancel: Cancel) -> tuple[str, str] | None:
        """Simulated time stands still until echoes are asked for and somebody is at the MAVLink port."""
        setup = self.setup
        setup.note(f"ready: echoes {self.rig_port.url}  MAVLink {self.mav_port.url}")
        if setup.command:
            self.companion = self._closing.enter_context(contextlib.closing(CommandCompanion(
                setup.command, self.rig_port.url, self.mav_port.url, self.world.scene.course.speed_m_s, self._folder)))
        else:
            sonar = "" if self.request.sonar == DEFAULT_SONAR else f" --sonar {self.request.sonar}"
            setup.note(f"run    python -m saranga run --echoes {self.rig_port.url} --vehicle {self.mav_port.url} "
                       f"--speed {self.world.scene.course.speed_m_s:g}{sonar}")
        began = said = time.monotonic()
        while not (self.world.rig.running and self.mav_port.clients):
            self.companion.check()
            self.mav_port.poll()
            self._serve_rig()
            now = time.monotonic()
            missing = " and ".join(what for what, there in (
                ("START on the echo port", self.world.rig.running),
                ("a connection to the MAVLink port", self.mav_port.clients)) if not there)
            if now - began > setup.wait_s:
                return "infrastructure", (
                    f"companion: {missing} did not come within {setup.wait_s:g} s (--wait-s); it said last: "
                    f"{self.companion.last_line()!r}")
            if cancel():
                return "interrupted", "interrupted while waiting for the companion"
            if now - said > SAY_EVERY_S:
                said = now
                setup.note(f"waiting for {missing}: {now - began:.0f} of {setup.wait_s:g} s")
            time.sleep(POLL_S)
        setup.note("companion connected: flying in wall time")
        return None

    # ---- flight ------------------------------------------------------------------------------------
    def fly(self, progress: Progress | None, cancel: Cancel) -> tuple[str, str] | None:
        """Until landed or judged; returns (outcome, cause) where something other than the judge ended it."""
        world, timing = self.world, self.timing
        world.ground.hold = False
        self.boot_us = world.t_us
        report = Periodic(PROGRESS_US, world.t_us)
        started, first_us = time.monotonic(), world.t_us
        loop_start = time.perf_counter() - first_us / 1e6  # so that progress tells the pace of the flight
        while True:
            self._serve_rig()
            tick = world.tick(self.mav_port.poll())
            self._send(tick.mavlink, tick.echoes)
            self._note_phase()
            flown_s = (tick.t_us - first_us) / 1e6
            self._pace(started + flown_s, flown_s)
            if not tick.stack_due:
                continue
            if self.recorder is not None:
                self.recorder.add(world, self.shadow.decision(tick.t_us))
            cause = ended(world, None, tick.t_us, self.request.max_sim_s)
            if cause is not None:
                return cause
            if world.phase is Phase.DONE or (world.judge.finished and not world.judge.reached_goal):
                timing.end(time.monotonic())
                return None
            self._check_companion()
            if report.due(tick.t_us):
                if cancel():
                    return "interrupted", "interrupted by the operator"
                if progress is not None:
                    progress(progress_of(world, loop_start))

    def _send(self, mavlink: bytes, echoes: bytes) -> None:
        now = time.monotonic()
        self.mav_port.send(mavlink + self.timing.question(now))
        if echoes:
            dropped = self.rig_port.dropped_bytes
            self.rig_port.write(echoes)
            self.timing.cycle(time.monotonic(), self.rig_port.dropped_bytes == dropped)
            self.shadow.saw_echoes(echoes)

    def _note_phase(self) -> None:
        """The course is what counts; the goal, a failure or the landing end it."""
        on_course = self.world.phase is Phase.COURSE
        if on_course and self.timing.began_s is None:
            self.timing.begin(time.monotonic())
        elif not on_course:
            self.timing.end(time.monotonic())

    def _check_companion(self) -> None:
        if self.world.phase in (Phase.LAND, Phase.DONE):
            return  # It has nothing left to say, and may go.
        self.companion.check()
        for what, there in (("echo", self.rig_port.listening), ("MAVLink", self.mav_port.clients)):
            if not there:
                raise CompanionGone(f"companion: its {what} connection has closed in flight (phase "
                                    f"{self.world.phase.value}); it said last: {self.companion.last_line()!r}")

    def _pace(self, due_s: float, flown_s: float) -> None:
        """Wait until `due_s`, or be late and say so. Raises DeviceError when that is too often."""
        ahead_s = due_s + self.slipped_s - time.monotonic()
        if ahead_s > LEAST_WAIT_S:
            self.mav_port.wait(ahead_s)
        elif ahead_s < -BEHIND_LIMIT_S:
            self.slipped_s -= ahead_s
            if self.slipped_s > SLIP_FREE_S + SLIP_LIMIT * flown_s:
                raise DeviceError(f"the simulation lost {self.slipped_s:.1f} s on wall time in {flown_s:.0f} s flown "
                                  f"(limit {SLIP_LIMIT:.0%} and {SLIP_FREE_S:g} s): this machine is too busy for a "
                                  "companion in the loop")


@functools.cache
def _warm_up(scene: str, sonar: str, shield: str) -> None:
    """A flight in lockstep (a second), so that nothing is compiled or loaded while wall time runs."""
    run_trial(TrialRequest(scene, sonar=sonar, shield=shield, stack="none", denoiser="gaussian", keep_log=False))


def run_hil_trial(request: TrialRequest, setup: HilSetup, progress: Progress | None = None,
                  cancel: Cancel | None = None) -> TrialResult:
    """Fly one trial with a companion in the loop; the timing is in `link_counters["companion"]`.

    Raises:
        UsageError: as `run_trial`, a fault that acts inside the stack, or a command that cannot be started.
        DeviceError: a port is taken, or the autopilot cannot be started.
    """
    asked = cancel or (lambda: False)
    refuse_faults_inside_stack(request.faults or Faults())
    _warm_up(request.scene, request.sonar, request.shield)
    wall_start = time.perf_counter()
    with contextlib.ExitStack() as closing:
        folder = request.workdir or Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="saranga-hil-")))
        flight = HilFlight(request, setup, folder, closing)
        loop_s = 0.0
        try:
            cause = flight.boot(asked) or flight.await_companion(asked)
            if cause is None:
                fly_start = time.perf_counter()
                try:
                    cause = flight.fly(progress, asked)
                finally:
                    loop_s = time.perf_counter() - fly_start
        except DeviceError as error:
            cause = "infrastructure", str(error)
        flight.timing.end(time.monotonic())
        fault = flight.companion.last_line().partition("FAULT ")[2]
    if cause is None and fault and not flight.world.judge.reached_goal:
        cause = "infrastructure", f"companion: {fault} ({flight.world.judge.result().cause})"
    result = collect(request, flight.world, flight.shadow, flight.recorder, cause, loop_s,
                     time.perf_counter() - wall_start)
    result.determinism_hash = ""
    # The boot is not flown in wall time.
    result.realtime_factor = (flight.world.t_us - flight.boot_us) / 1e6 / loop_s if loop_s > 0 else math.nan
    result.link_counters |= {"rig_dropped_bytes": flight.rig_port.dropped_bytes, "companion": _figures(flight)}
    if request.workdir is not None:
        result.files["wire"] = str(_write_rows(flight.timing, request.workdir))
        console = request.workdir / "companion.txt"
        if console.is_file():
            result.files["companion"] = str(console)
    return result


def _figures(flight: HilFlight) -> dict[str, Any]:
    return {**flight.timing.figures(), "simulation_lost_s": flight.slipped_s}


def _write_rows(timing: WireTiming, folder: Path) -> Path:
    """Every setpoint of the course, for one's own plots."""
    path = folder / "setpoints.csv"
    lines = [f"{at_s:.6f},{stamp_ms},{gap_ms:.3f},{'' if response_ms is None else f'{response_ms:.3f}'}"
             for at_s, stamp_ms, gap_ms, response_ms in timing.rows()]
    path.write_text("\n".join(["arrival_s,stamp_ms,interval_ms,response_ms", *lines]) + "\n", encoding="utf-8")
    return path
