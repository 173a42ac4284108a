"""One flight, from scene and seed to outcome: a plain function of its inputs, safe to run in any worker."""

import contextlib
import math
from collections.abc import Callable
from math import isfinite
from time import perf_counter
from typing import TYPE_CHECKING, Any

from saranga.denoise import load_denoiser
from saranga.denoise.model_file import weights_sha256
from saranga.errors import DeviceError
from saranga.navigate import EchoPolicy, Policy, VelocityCommand, load_policy
from saranga.side_by_side import more_of
from saranga.sources import InProcessSource
from saranga.stack import Decision, Stack
from saranga.vehicle import VehicleLink, version_text
from sitl.aftermath import aftermath
from sitl.autopilot import make_autopilot
from sitl.causes import label_of
from sitl.clock import Delayed, Periodic
from sitl.flight_log import FlightRecorder
from sitl.ground_control import Phase
from sitl.measures import measures_of
from sitl.scene import build_scene, load_scene
from sitl.trial_types import Faults, TrialProgress, TrialRequest, TrialResult
from sitl.world import World

if TYPE_CHECKING:
    from sitl.live import Shadow

# Two network inferences of 14.57 ms on the paper's Edge TPU, plus localisation and navigation.
COMPUTE_LATENCY_US = 30_000
FAULT_PATIENCE_US = 1_000_000
HEARTBEAT_US = 1_000_000
PROGRESS_US = 500_000

Progress = Callable[[TrialProgress], None]
Cancel = Callable[[], bool]


class _NanPolicy:
    """The policy under test until `at_s` after the course began, then not a number (fault injection)."""

    def __init__(self, inner: Policy, at_s: float) -> None:
        self.name = inner.name
        self._inner = inner
        self._at_us = round(at_s * 1e6)
        self.course_us: int | None = None

    def reset(self) -> None:
        self._inner.reset()

    def decide(self, obstacles: Any, t_us: int) -> VelocityCommand:
        if self.course_us is not None and t_us - self.course_us >= self._at_us:
            return VelocityCommand(float("nan"), 0.0, 0.0)
        return self._inner.decide(obstacles, t_us)


class _NanEchoPolicy(_NanPolicy):
    """The same around a policy that reads echoes."""

    def decide_echoes(self, images: Any, t_us: int) -> VelocityCommand:
        command = self.decide((), t_us)
        assert isinstance(self._inner, EchoPolicy)
        return self._inner.decide_echoes(images, t_us) if isfinite(command.vx_m_s) else command


class _Companion:
    """The stack in the loop: echo bytes in, setpoint bytes out after the modelled compute latency."""

    def __init__(self, request: TrialRequest, world: World, faults: Faults) -> None:
        course = world.scene.course
        policy = load_policy(request.stack, desired_speed_m_s=course.speed_m_s)
        self._nan: _NanPolicy | None = None
        if faults.nan_policy_at_s is not None:
            kind = _NanEchoPolicy if isinstance(policy, EchoPolicy) else _NanPolicy
            policy = self._nan = kind(policy, faults.nan_policy_at_s)
        denoiser = load_denoiser(request.denoiser)
        self.runtime: str | None = getattr(denoiser, "runtime", None)
        self.stack = Stack(denoiser, policy, world.geometry, world.scene.weather.temperature_c,
                           helpers=more_of(request.denoiser, request.stack_threads))
        self.source = InProcessSource()
        self.source.feed(world.rig.hello())
        self.link = VehicleLink()
        self.seconds = {"wire": 0.0, "image": 0.0, "denoise": 0.0, "localise": 0.0, "navigate": 0.0}
        self.fault_cause: str | None = None
        self._latency_us = COMPUTE_LATENCY_US + round(faults.setpoint_delay_ms * 1000)
        self._delayed = Delayed()
        self._heartbeat = Periodic(HEARTBEAT_US)
        self._fault_since_us: int | None = None
        self._on_course = False
        self._echo_us = 0
        self._ages_us = [0, 0]

    @property
    def echo_to_setpoint_ms(self) -> float:
        """Mean over the course; NaN before it."""
        total, count = self._ages_us
        return total / count / 1000.0 if count else math.nan

    def outgoing(self, t_us: int) -> bytes:
        return self._delayed.take(t_us)

    def receive(self, data: bytes, t_us: int) -> None:
        if data:
            self._echo_us = t_us
            start = perf_counter()
            self.source.feed(data)
            self.seconds["wire"] += perf_counter() - start

    def step(self, t_us: int, on_course: bool, world: World) -> Decision:
        if on_course and not self._on_course:
            self._on_course = True
            self.stack.policy.reset()
            if self._nan is not None:
                self._nan.course_us = t_us
        start = perf_counter()
        cycles = self.source.poll(0.0)
        self.seconds["wire"] += perf_counter() - start
        decision = self.stack.step(cycles, world.planted.clock_us(t_us))
        for stage, spent_ms in decision.timing_ms.items():
            self.seconds[stage] += spent_ms * 1e-3
        self._watch(decision, on_course, t_us)
        if self._heartbeat.due(t_us):
            self.link.send_heartbeat()
        if on_course:
            self.link.send_velocity(decision.command, t_us)
            self._ages_us[0] += t_us + self._latency_us - self._echo_us
            self._ages_us[1] += 1
        data = self.link.take()
        if data:
            world.note_command(data)
            self._delayed.put(t_us + self._latency_us, data)
        return decision

    def _watch(self, decision: Decision, on_course: bool, t_us: int) -> None:
        if decision.fault is None or not on_course:
            self._fault_since_us = None
            return
        if self._fault_since_us is None:
            self._fault_since_us = t_us
        if t_us - self._fault_since_us >= FAULT_PATIENCE_US:
            self.fault_cause = f"stack: {decision.fault}"


def run_trial(request: TrialRequest, progress: Progress | None = None, cancel: Cancel | None = None) -> TrialResult:
    """Fly one trial in lockstep.

    Args:
        request: scene, seed, autopilot, stack and faults.
        progress: called about twice a simulated second.
        cancel: asked as often; True ends the flight with outcome "interrupted".

    Returns:
        What happened. A failure in flight is an outcome with its cause, never an exception.

    Raises:
        UsageError: unknown scene, denoiser, stack, shield, sonar or autopilot; malformed files.
        DeviceError: the autopilot cannot be started.
    """
    faults = request.faults or Faults()
    scene = build_scene(load_scene(request.scene), request.seed)
    wall_start = perf_counter()
    autopilot, parameters = make_autopilot(request.autopilot, request.seed, request.workdir)
    with contextlib.closing(autopilot):
        world = World(scene, autopilot, request.sonar, request.shield, request.seed, faults, parameters)
        companion = _Companion(request, world, faults)
        recorder = FlightRecorder(scene, world.volume) if request.keep_log else None
        world.start()
        loop_start = perf_counter()
        cause = _fly(request, world, companion, recorder, progress, cancel, loop_start)
        after = aftermath(world, companion.outgoing) if cause is not None and faults.any() else None
        loop_s = perf_counter() - loop_start
    if cause is not None and after is not None:
        cause = cause[0], f"{cause[1]}; {after}"
    return collect(request, world, companion, recorder, cause, loop_s, perf_counter() - wall_start)


def _fly(request: TrialRequest, world: World, companion: _Companion, recorder: FlightRecorder | None,
         progress: Progress | None, cancel: Cancel | None, loop_start: float) -> tuple[str, str] | None:
    """Tick until landed or judged; returns (outcome, cause) where something other than the judge ended it."""
    report = Periodic(PROGRESS_US)
    try:
        while True:
            tick = world.tick(companion.outgoing(world.t_us))
            companion.receive(tick.echoes, tick.t_us)
            if not tick.stack_due:
                continue
            decision = companion.step(tick.t_us, world.phase is Phase.COURSE, world)
            if recorder is not None:
                recorder.add(world, decision)
            cause = ended(world, companion.fault_cause, tick.t_us, request.max_sim_s)
            if cause is not None:
                return cause
            if world.phase is Phase.DONE or (world.judge.finished and not world.judge.reached_goal):
                return None
            if report.due(tick.t_us):
                if cancel is not None and cancel():
                    return "interrupted", "interrupted by the operator"
                if progress is not None:
                    progress(progress_of(world, loop_start))
    except DeviceError as error:
        return "infrastructure", str(error)


def ended(world: World, fault_cause: str | None, t_us: int, max_sim_s: float) -> tuple[str, str] | None:
    """Why the flight cannot go on, as (outcome, cause), other than by the judge."""
    ground = world.ground
    if fault_cause is not None:
        return "infrastructure", fault_cause
    if ground.phase is Phase.FAILED:
        in_air = ground.link.status.armed or any(text == "phase course" for _, text in ground.events)
        return ("estimator_failure" if in_air else "infrastructure"), ground.cause or "ground station failed"
    if t_us > max_sim_s * 1e6:
        return "infrastructure", f"no end after {max_sim_s:g} s simulated (phase {ground.phase.value})"
    return None


def progress_of(world: World, loop_start: float) -> TrialProgress:
    """Where the flight is now; `loop_start` is of `perf_counter`."""
    elapsed_s = max(perf_counter() - loop_start, 1e-9)
    return TrialProgress(world.t_us / 1e6, world.phase.value, float(world.physics.state.pos_m[0]),
                         world.scene.course.goal_x_m, world.t_us / 1e6 / elapsed_s)


def collect(request: TrialRequest, world: World, companion: "_Companion | Shadow", recorder: FlightRecorder | None,
            stopped: tuple[str, str] | None, loop_s: float, wall_s: float) -> TrialResult:
    """The result of a flight that has ended; `stopped` is what ended it where the judge did not."""
    if stopped is not None:
        world.judge.fail(*stopped)
    elif (never := world.fault_that_never_came()) is not None:
        world.judge.fail("infrastructure", never)
    judgement = world.judge.result()
    outcome, cause = judgement.outcome, judgement.cause
    landed = world.phase is Phase.DONE
    status = world.ground.link.status
    kind = world.autopilot.kind
    version = version_text(status.firmware_version)
    timing = {**world.seconds, **companion.seconds}
    timing["other"] = max(loop_s - sum(timing.values()), 0.0)
    sim_s = world.t_us / 1e6
    log = recorder.finish(world.ground.all_events()) if recorder is not None and not recorder.empty else None
    label = label_of(outcome, cause, judgement.part, judgement.obstacle_index, log)
    along_m = float(world.physics.state.pos_m[0]) - world.scene.course.start_m[0]
    return TrialResult(
        scene=request.scene, seed=request.seed, outcome=outcome, cause=cause, part=judgement.part,
        success_strict=outcome == "clean" and landed,
        success_lenient=(outcome == "clean" and landed) or outcome == "net_hit",
        min_clearance_m=judgement.min_clearance_m, duration_s=judgement.duration_s, sim_s=sim_s, wall_s=wall_s,
        realtime_factor=sim_s / loop_s if loop_s > 0 else float("nan"),
        determinism_hash=world.determinism_hash(outcome), landed=landed,
        autopilot={"kind": kind, "version": f"{version} {status.firmware_hash}".strip()},
        denoiser=request.denoiser, stack=request.stack, shield=request.shield,
        link_counters=companion.source.counters.__dict__.copy(), timing=timing,
        weights_sha256=weights_sha256(request.denoiser), runtime=companion.runtime,
        label=label.name, label_reason=label.reason, path_length_m=judgement.path_length_m,
        path_excess=judgement.path_length_m / along_m if along_m > 0.5 else math.nan,
        shield_noise=world.acoustics.noise_provenance(), log=log,
        measures=measures_of(log, getattr(companion, "echo_to_setpoint_ms", math.nan)))
