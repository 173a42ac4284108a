"""One simulated world in the one event order of `clock.py`: physics, sensors, autopilot, rig, judge, ground station.

The lockstep trial and live mode both drive `tick`; they differ only in who gives the companion's bytes and
whether wall time is waited for.
"""

from dataclasses import dataclass, field
from hashlib import sha256
from time import perf_counter

import numpy as np

from saranga.echo import SonarGeometry, load_sonar
from saranga.errors import UsageError
from sitl.acoustics.shield import load_shielding
from sitl.acoustics.sonar import AcousticModel
from sitl.airframe import load_airframe
from sitl.autopilot.base import Autopilot
from sitl.autopilot.parameters import Parameter
from sitl.clock import ECHO_CYCLE_US, STACK_TICK_US, Delayed, Periodic
from sitl.faults.planted import PlantedFaults
from sitl.ground_control import Flight, GroundControl, Phase
from sitl.judge import Judge
from sitl.physics import Physics
from sitl.rig import RigFaults, VirtualRig
from sitl.scene import Scene
from sitl.sensors import FlightSensors
from sitl.swept_volume import AirframeVolume
from sitl.trial_types import Faults

# A cycle reaches the companion after its record (9.7 ms) and the transfer over USB.
ECHO_ARRIVAL_US = 12_000
# ArduPilot's own parameters are the ones checked; the embedded autopilot answers to the same names.
AIRBORNE = (Phase.TAKEOFF, Phase.COURSE, Phase.LAND)


@dataclass
class Tick:
    """What one physics tick brought: MAVLink from the autopilot, echo bytes that arrived, whether the stack is due."""

    t_us: int
    mavlink: bytes
    echoes: bytes
    stack_due: bool


@dataclass
class World:
    """Everything that is not the stack.

    Raises:
        UsageError: unknown sonar or shield.
    """

    scene: Scene
    autopilot: Autopilot
    sonar: str
    shield: str
    seed: int
    faults: Faults
    parameters: list[Parameter] = field(default_factory=list)

    def __post_init__(self) -> None:
        scene, seed = self.scene, self.seed
        self.geometry: SonarGeometry = load_sonar(self.sonar)
        self.airframe = load_airframe()
        self.physics = Physics(self.airframe, np.asarray(scene.course.start_m, float), scene.wind, seed)
        self.sensors = FlightSensors(seed)
        shield = load_shielding(self.shield)
        self.acoustics = AcousticModel(scene.primitives, scene.weather, self.geometry, shield, seed)
        self.rig = VirtualRig(self.acoustics, self.geometry)
        frame = self.airframe
        self.volume = AirframeVolume(frame.wheelbase_m, frame.propeller_diameter_m, -frame.propeller_height_m,
                                     frame.body_size_m)
        self.judge = Judge(scene, self.volume)
        self.ground = GroundControl(Flight(
            scene.course.height_m, self.parameters, needs_arducopter=self.autopilot.kind == "arducopter"))
        self.seconds: dict[str, float] = dict.fromkeys(("autopilot", "physics", "echoes", "judge", "ground"), 0.0)
        self._digest = sha256()
        self._echo_timer = Periodic(ECHO_CYCLE_US)
        self._stack_timer = Periodic(STACK_TICK_US)
        self._echo_queue = Delayed()
        self._trigger = 0
        self._course_us: int | None = None
        self._fired: set[str] = set()
        self.planted = PlantedFaults(self.faults.planted)
        self._check_faults()

    def _check_faults(self) -> None:
        """A fault that cannot happen here would make a flight look as if it had survived it."""
        faults = self.faults
        if faults.dead_sensor is not None and faults.dead_sensor not in self.geometry.positions_m:
            raise UsageError(f"fault dead_sensor={faults.dead_sensor}: sonar {self.sonar!r} has only "
                             f"{', '.join(self.geometry.positions_m)}; choose one of them or another --sonar")
        if faults.physics_socket_lost_at_s is not None and not hasattr(self.autopilot, "lose_physics_socket"):
            raise UsageError(f"fault physics_socket_lost_at_s: autopilot {self.autopilot.kind!r} has no physics "
                             "socket; use --autopilot arducopter")

    # ---- life ------------------------------------------------------------------------------------
    def start(self) -> None:
        """Boot the autopilot.

        Raises:
            DeviceError: it cannot be started.
        """
        self.autopilot.start(self.physics.state)

    def close(self) -> None:
        self.autopilot.close()

    @property
    def t_us(self) -> int:
        return self.physics.state.t_us

    @property
    def phase(self) -> Phase:
        return self.ground.phase

    @property
    def height_m(self) -> float:
        return -float(self.physics.state.pos_m[2])

    # ---- one tick --------------------------------------------------------------------------------
    def tick(self, companion: bytes) -> Tick:
        """Advance by one physics tick.

        Args:
            companion: MAVLink bytes of the stack or of other programs that take effect now.

        Raises:
            DeviceError: the autopilot died or stopped answering.
        """
        physics, seconds = self.physics, self.seconds
        state = physics.state
        start = perf_counter()
        mavlink_in = self.sensors.step(state) + self.ground.take() + self.planted.setpoints(companion)
        lap = perf_counter()
        seconds["ground"] += lap - start
        throttle, mavlink_out = self.autopilot.step(state, mavlink_in)
        start = perf_counter()
        seconds["autopilot"] += start - lap
        physics.step(self.autopilot.tick_us, throttle)
        self._digest.update(throttle.tobytes())
        lap = perf_counter()
        seconds["physics"] += lap - start
        t_us = state.t_us
        if self.phase in AIRBORNE:
            self.judge.update(t_us, state.pos_m, state.quat)
        start = perf_counter()
        seconds["judge"] += start - lap
        while self._echo_timer.due(t_us):
            self._ping(t_us)
        echoes = self._echo_queue.take(t_us)
        lap = perf_counter()
        seconds["echoes"] += lap - start
        self.ground.feed(mavlink_out, t_us)
        stack_due = self._stack_timer.due(t_us)
        if stack_due:
            self._supervise(t_us)
        seconds["ground"] += perf_counter() - lap
        return Tick(t_us, mavlink_out, echoes, stack_due)

    def _ping(self, t_us: int) -> None:
        """One cycle; its trigger lies within the last tick, so the pose is carried back to it."""
        trigger_us = self._trigger * ECHO_CYCLE_US
        state = self.physics.state
        pos_m = state.pos_m - state.vel_m_s * ((t_us - trigger_us) * 1e-6)
        data = self.rig.cycle(self._trigger, trigger_us, pos_m, state.quat, state.vel_m_s, state.thrust_n)
        self._echo_queue.put(trigger_us + ECHO_ARRIVAL_US, data)
        self._trigger += 1

    def _supervise(self, t_us: int) -> None:
        """The slow loop at the stack's tick: ground station, start and end of the course, faults that are due."""
        before = self.phase
        self.ground.tick(t_us, self.height_m)
        state = self.physics.state
        if self.phase is Phase.COURSE and before is not Phase.COURSE:
            self._course_us = t_us
            self.judge.start_course(t_us)
        if self.phase is Phase.COURSE:
            if self.judge.finished:
                self.ground.land(t_us)
            elif state.on_ground:
                self.judge.fail("estimator_failure", "touched the ground during the course")
        if self._course_us is not None:
            self._inject((t_us - self._course_us) / 1e6)

    def _inject(self, course_s: float) -> None:
        faults = self.faults
        if "rig" not in self._fired:
            self._fired.add("rig")
            at = self._course_us or 0

            def after(delay_s: float | None) -> int | None:
                return None if delay_s is None else at + round(delay_s * 1e6)

            self.rig.faults = RigFaults(
                silent_after_us=after(faults.echo_silent_at_s), dead_role=faults.dead_sensor,
                dead_after_us=after(faults.dead_sensor_at_s if faults.dead_sensor else None),
                corrupt_probability=faults.corrupt_probability, drop_probability=faults.drop_probability)
        self.planted.step(self, course_s)
        for name, at_s, action in (("kill", faults.kill_autopilot_at_s, "kill"),
                                   ("socket", faults.physics_socket_lost_at_s, "lose_physics_socket")):
            if at_s is not None and course_s >= at_s and name not in self._fired:
                self._fired.add(name)
                getattr(self.autopilot, action)()

    def fault_that_never_came(self) -> str | None:
        """A timed fault whose moment lay after the end of the course: the flight says nothing about it."""
        course_s = (self.judge.result().t_us - self._course_us) / 1e6 if self._course_us is not None else 0.0
        for name, at_s in self.faults.to_dict().items():
            if name.endswith("_at_s") and at_s > course_s:
                return f"fault {name}={at_s:g} never happened: the course ended after {course_s:.1f} s"
        for planting in self.faults.planted:
            if planting.at_s > course_s:
                return (f"fault {planting.name}={planting.text} never happened: the course ended after "
                        f"{course_s:.1f} s")
        return None

    def change_shield(self, name: str) -> None:
        """Fly on behind another shield (fault campaigns)."""
        self.acoustics = AcousticModel(self.scene.primitives, self.scene.weather, self.geometry, load_shielding(name),
                                       self.seed)
        self.rig.change_model(self.acoustics)

    # ---- result ----------------------------------------------------------------------------------
    def note_command(self, data: bytes) -> None:
        """Bytes the stack sent belong to what makes a flight itself."""
        self._digest.update(data)

    def determinism_hash(self, outcome: str) -> str:
        """SHA-256 over every motor output, every stack command and the outcome, in order."""
        digest = self._digest.copy()
        digest.update(outcome.encode())
        return digest.hexdigest()
