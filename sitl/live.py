"""Live mode: the stack as its own process in wall time, echoes over a pty, MAVLink over TCP.

The same world as the lockstep trial, paced by the wall clock from take-off on, with `python -m saranga run` (or a
real companion computer) on the other side of the two ports. Nothing here is bit-repeatable, so there is no
determinism hash; the outcome is judged by the same judge.
"""

import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.echo import EchoImage, sound_speed_m_s
from saranga.errors import DeviceError, UsageError
from saranga.navigate import VelocityCommand
from saranga.numba_cache import is_cold
from saranga.sources import InProcessSource
from saranga.stack import HOLD, Decision
from sitl.autopilot import make_autopilot
from sitl.autopilot.servers import TcpServer
from sitl.clock import Periodic
from sitl.faults import fault_modules
from sitl.flight_log import FlightRecorder
from sitl.ground_control import Phase
from sitl.process import die_with_parent
from sitl.rig_ports import PtyPort, TcpPort
from sitl.scene import build_scene, load_scene
from sitl.trial import PROGRESS_US, Cancel, Progress, collect, ended, progress_of, run_trial
from sitl.trial_types import Faults, TrialRequest, TrialResult
from sitl.world import World

RigPort = PtyPort | TcpPort
CONNECT_DEADLINE_S = 40.0
STOP_DEADLINE_S = 5.0
# Further behind than this and "wall time" is no longer true; the flight is then not worth judging.
BEHIND_LIMIT_S = 2.0


@dataclass
class Shadow:
    """What passes over the two ports, seen from outside: echo rows and setpoints, for the flight log."""

    world: World
    source: InProcessSource = field(default_factory=InProcessSource)
    runtime: str | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    setpoints: int = 0
    heard_companion: bool = False

    def __post_init__(self) -> None:
        self._images = {role: EchoImage() for role in self.world.geometry.positions_m}
        self._c_m_s = sound_speed_m_s(self.world.scene.weather.temperature_c)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._command = HOLD

    def saw_echoes(self, data: bytes) -> None:
        self.source.feed(data)
        for cycle in self.source.poll(0.0):
            for role, frame in cycle.frames.items():
                self._images[role].push(frame, self._c_m_s)

    def saw_mavlink(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(data) or []:
            self.heard_companion = True
            if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                self.setpoints += 1
                values = (message.vx, message.vy, message.vz, message.yaw_rate)
                self._command = VelocityCommand(*values) if all(map(isfinite, values)) else HOLD

    def decision(self, t_us: int) -> Decision:
        return Decision(t_us, self._command, images={role: image.envelope for role, image in self._images.items()})


class CompanionProcess:
    """`python -m saranga run` as a subprocess that dies with us."""

    def __init__(self, request: TrialRequest, speed_m_s: float, temperature_c: float, echoes: str, vehicle: str,
                 folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.console = folder / "companion.txt"
        command = [sys.executable, "-m", "saranga", "run", "--echoes", echoes, "--vehicle", vehicle,
                   "--denoiser", request.denoiser, "--stack", request.stack, "--sonar", request.sonar,
                   "--speed", f"{speed_m_s:g}", "--temperature", f"{temperature_c:g}",
                   "--log", str(folder / "companion.jsonl")]
        with self.console.open("wb") as console:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=console,
                                             stderr=subprocess.STDOUT, preexec_fn=die_with_parent,
                                             start_new_session=True)

    def last_line(self) -> str:
        lines = self.console.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def last_fault(self) -> str | None:
        _, found, fault = self.last_line().partition("FAULT ")
        return fault if found else None

    def check(self) -> None:
        """Raises DeviceError when it has ended."""
        code = self._process.poll()
        if code is not None:
            raise DeviceError(f"companion process ended (exit code {code}): {self.last_line()}")

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(STOP_DEADLINE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def refuse_faults_inside_stack(faults: Faults) -> None:
    """What acts inside the companion cannot be planted in another process.

    Raises:
        UsageError: such a fault was asked for; ignored, it would look as if the flight had survived it.
    """
    inside = [name for name, module in fault_modules().items() if getattr(module, "INSIDE_STACK", False)]
    for name in ("nan_policy_at_s", "setpoint_delay_ms", *inside):
        if name in faults.to_dict():
            raise UsageError(f"fault {name} acts inside the stack, which is its own process here: fly it in lockstep")


def run_live_trial(request: TrialRequest, progress: Progress | None = None, cancel: Cancel | None = None,
             echoes: str = "pty") -> TrialResult:
    """Fly one trial in wall time with the stack in its own process.

    Args:
        request, progress, cancel: as `run_trial`.
        echoes: how they travel, "pty" (as from a USB serial port) or "tcp".

    Raises:
        UsageError: as `run_trial`, or another way for the echoes.
        DeviceError: autopilot or companion cannot be started.
    """
    if echoes not in ("pty", "tcp"):
        raise UsageError(f"echoes over {echoes!r}: must be pty or tcp")
    faults = request.faults or Faults()
    refuse_faults_inside_stack(faults)
    if is_cold():
        run_trial(replace(request, autopilot="embedded", faults=None, workdir=None, keep_log=False))
    scene = build_scene(load_scene(request.scene), request.seed)
    wall_start = time.perf_counter()
    with contextlib.ExitStack() as stack:
        folder = request.workdir or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="saranga-live-")))
        autopilot, parameters = make_autopilot(request.autopilot, request.seed, folder)
        stack.callback(autopilot.close)
        world = World(scene, autopilot, request.sonar, request.shield, request.seed, faults, parameters)
        rig_port: RigPort = PtyPort() if echoes == "pty" else TcpPort()
        stack.callback(rig_port.close)
        mav_port = stack.enter_context(contextlib.closing(TcpServer(port=0)))
        companion = stack.enter_context(contextlib.closing(CompanionProcess(
            request, scene.course.speed_m_s, scene.weather.temperature_c, rig_port.url, mav_port.url, folder)))
        shadow = Shadow(world)
        recorder = FlightRecorder(scene, world.volume) if request.keep_log else None
        _connect(world, companion, shadow, rig_port, mav_port)
        world.start()
        loop_start = time.perf_counter()
        cause = _fly(request, world, companion, shadow, recorder, rig_port, mav_port, progress, cancel)
        loop_s = time.perf_counter() - loop_start
    result = collect(request, world, shadow, recorder, cause, loop_s, time.perf_counter() - wall_start)
    result.determinism_hash = ""
    result.link_counters |= {"setpoints": shadow.setpoints, "rig_dropped_bytes": rig_port.dropped_bytes}
    return result


def _serve_rig(world: World, shadow: Shadow, rig_port: RigPort) -> None:
    asked = rig_port.read()
    if asked:
        answer = world.rig.receive(asked, world.t_us)
        rig_port.write(answer)
        shadow.source.feed(answer)


def _connect(world: World, companion: CompanionProcess, shadow: Shadow, rig_port: RigPort,
             mav_port: TcpServer) -> None:
    """Simulated time stands still until the companion has started the rig and spoken MAVLink."""
    deadline = time.monotonic() + CONNECT_DEADLINE_S
    while not (world.rig.running and shadow.heard_companion):
        companion.check()
        if time.monotonic() > deadline:
            raise DeviceError(f"companion did not connect within {CONNECT_DEADLINE_S:g} s; its last line: "
                              f"{companion.last_line()!r}")
        _serve_rig(world, shadow, rig_port)
        shadow.saw_mavlink(mav_port.poll())
        time.sleep(0.005)


def _fly(request: TrialRequest, world: World, companion: CompanionProcess, shadow: Shadow,
         recorder: FlightRecorder | None, rig_port: RigPort, mav_port: TcpServer, progress: Progress | None,
         cancel: Cancel | None) -> tuple[str, str] | None:
    report = Periodic(PROGRESS_US)
    started = time.perf_counter()
    pace_from: tuple[float, int] | None = None
    try:
        while True:
            spoken = mav_port.poll()
            shadow.saw_mavlink(spoken)
            _serve_rig(world, shadow, rig_port)
            tick = world.tick(spoken)
            if tick.mavlink:
                mav_port.send(tick.mavlink)
            if tick.echoes:
                rig_port.write(tick.echoes)
                shadow.saw_echoes(tick.echoes)
            if world.phase in (Phase.START, Phase.READY):
                pace_from = None
            elif pace_from is None:
                pace_from = (time.perf_counter(), tick.t_us)
            if pace_from is not None:
                _pace(pace_from, tick.t_us)
            if not tick.stack_due:
                continue
            companion.check()
            if recorder is not None:
                recorder.add(world, shadow.decision(tick.t_us))
            cause = ended(world, None, tick.t_us, request.max_sim_s)
            if cause is not None:
                return cause
            if world.phase is Phase.DONE or (world.judge.finished and not world.judge.reached_goal):
                return _with_fault(world, companion)
            if report.due(tick.t_us):
                if cancel is not None and cancel():
                    return "interrupted", "interrupted by the operator"
                if progress is not None:
                    progress(progress_of(world, started))
    except DeviceError as error:
        return "infrastructure", str(error)


def _pace(pace_from: tuple[float, int], t_us: int) -> None:
    ahead_s = (t_us - pace_from[1]) / 1e6 - (time.perf_counter() - pace_from[0])
    if ahead_s > 0.001:
        time.sleep(ahead_s)
    elif ahead_s < -BEHIND_LIMIT_S:
        raise DeviceError(f"the simulation is {-ahead_s:.1f} s behind wall time (limit {BEHIND_LIMIT_S:g} s): this "
                          "machine is too busy for live mode")


def _with_fault(world: World, companion: CompanionProcess) -> tuple[str, str] | None:
    """A flight that ended while the companion was reporting a fault ended because of it."""
    fault = companion.last_fault()
    if fault is None or world.judge.reached_goal:
        return None
    return "infrastructure", f"companion: {fault} ({world.judge.result().cause})"
