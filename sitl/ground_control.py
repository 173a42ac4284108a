"""The ground station of a trial: checks, arms, takes off, hands the course to the stack, lands. Simulators only.

A small sequence ticked in simulated time, so that it is the same over in-process bytes and over a socket.
Every phase has a deadline; when one passes, the cause names what was awaited and the vehicle's last word.
"""

from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.vehicle import MODE_GUIDED, MODE_LAND, VehicleLink, version_text
from sitl.autopilot.parameters import Parameter, mismatches
from sitl.clock import Periodic

LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = 42.27381, -71.80989, 150.0
ORIGIN_FROM_US = 3_000_000
SETTLED_S = 1.0
PARAMETER_BATCH = 8


class Phase(Enum):
    """Where the flight is."""

    START = "start"
    READY = "ready"
    TAKEOFF = "takeoff"
    COURSE = "course"
    LAND = "land"
    DONE = "done"
    FAILED = "failed"


DEADLINE_S = {Phase.START: 15.0, Phase.READY: 60.0, Phase.TAKEOFF: 20.0, Phase.LAND: 25.0}


@dataclass(frozen=True)
class Flight:
    """What the ground station is asked to do."""

    height_m: float
    parameters: list[Parameter]
    needs_arducopter: bool


class GroundControl:
    """Steps through START, READY, TAKEOFF, COURSE, LAND, DONE.

    `tick` at about 16 Hz, `feed` with what the vehicle says.

    `cause` is set when the phase becomes FAILED. While `hold` is True it does not arm: `ready_to_arm` says that only
    that is left.
    """

    def __init__(self, flight: Flight) -> None:
        self.link = VehicleLink(255, mavlink.MAV_COMP_ID_MISSIONPLANNER, vehicle_type=mavlink.MAV_TYPE_GCS)
        self.flight = flight
        self.phase = Phase.START
        self.cause: str | None = None
        self.hold = False
        self.ready_to_arm = False
        self.events: list[tuple[int, str]] = []
        self._entered_us = 0
        self._heartbeat = Periodic(1_000_000)
        self._slow = Periodic(1_000_000)
        self._reached_us: int | None = None
        self._asked_streams = False

    # ---- bytes -----------------------------------------------------------------------------------
    def feed(self, data: bytes, t_us: int) -> None:
        """Take the vehicle's bytes; its texts become events of the flight."""
        self.link.feed(data, t_us)

    def all_events(self) -> list[tuple[int, str]]:
        """Phases and the vehicle's own texts, in order of time."""
        texts = [(t_us, text) for t_us, _, text in self.link.status.texts]
        return sorted([*self.events, *texts], key=lambda event: event[0])

    def take(self) -> bytes:
        return self.link.take()

    # ---- sequence --------------------------------------------------------------------------------
    def tick(self, t_us: int, height_m: float) -> None:
        """Advance.

        Args:
            t_us: simulated time.
            height_m: true height above ground, used to say that take-off is complete.
        """
        if self._heartbeat.due(t_us):
            self.link.send_heartbeat()
        slow = self._slow.due(t_us)
        if self.phase is Phase.START:
            self._start(slow, t_us)
        elif self.phase is Phase.READY:
            self._ready(slow, t_us)
        elif self.phase is Phase.TAKEOFF:
            self._takeoff(slow, t_us, height_m)
        elif self.phase is Phase.COURSE:
            self._course(t_us)
        elif self.phase is Phase.LAND:
            self._land(slow, t_us)
        limit_s = DEADLINE_S.get(self.phase)
        if limit_s is not None and t_us - self._entered_us > limit_s * 1e6:
            self._fail(t_us, f"{self.phase.value} not complete after {limit_s:g} s simulated: {self._waiting_for()}")

    def land(self, t_us: int) -> None:
        """End the course: land where we are."""
        if self.phase in (Phase.TAKEOFF, Phase.COURSE):
            self.link.send_mode(MODE_LAND)
            self._enter(Phase.LAND, t_us)

    def _enter(self, phase: Phase, t_us: int) -> None:
        self.phase = phase
        self._entered_us = t_us
        self.events.append((t_us, f"phase {phase.value}"))

    def _fail(self, t_us: int, cause: str) -> None:
        self.cause = cause
        self._enter(Phase.FAILED, t_us)

    def _waiting_for(self) -> str:
        status = self.link.status
        if self.phase is Phase.START:
            if status.heartbeat_us is None:
                return "no heartbeat from system 1; is the right program on this port?"
            wrong = self._mismatches()
            return "; ".join(wrong[:5]) if wrong else "no AUTOPILOT_VERSION"
        if self.phase is Phase.READY:
            reason = status.last_text("prearm", "arm:") or status.last_text()
            return (f"prearm {'ok' if status.prearm_ok else 'refused'}, EKF flags {status.ekf_flags}, "
                    f"mode {status.mode_name}, armed {status.armed}; last word: {reason!r}")
        return f"mode {status.mode_name}, armed {status.armed}; last word: {status.last_text()!r}"

    def _mismatches(self) -> list[str]:
        version = self.link.status.firmware_version
        if version is None:
            return []
        return mismatches(self.flight.parameters, (version >> 24 & 0xFF, version >> 16 & 0xFF),
                          self.link.status.parameters)

    def _start(self, slow: bool, t_us: int) -> None:
        status = self.link.status
        if status.heartbeat_us is None:
            return
        if self.flight.needs_arducopter and (
            status.autopilot_type != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            or status.vehicle_type != mavlink.MAV_TYPE_QUADROTOR
        ):
            kind = mavlink.enums["MAV_TYPE"].get(status.vehicle_type)
            named = kind.name if kind else status.vehicle_type
            self._fail(t_us, f"wrong firmware: it says it is a {named} of autopilot type {status.autopilot_type}, "
                             "not an ArduCopter quadrotor; point ARDUCOPTER at an arducopter binary")
            return
        if slow and not self._asked_streams:
            self._asked_streams = True
            for message_id, rate_hz in (
                (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 2), (mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 2),
                (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 2), (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 4),
            ):
                self.link.send_message_interval(message_id, rate_hz)
        if status.firmware_version is None:
            if slow:
                self.link.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            return
        version = (status.firmware_version >> 24 & 0xFF, status.firmware_version >> 16 & 0xFF)
        missing = [name for name, _ in (p.spelling(version) for p in self.flight.parameters)
                   if name not in status.parameters]
        for name in missing[:PARAMETER_BATCH]:
            self.link.request_parameter(name)
        if missing:
            return
        wrong = self._mismatches()
        if wrong:
            self._fail(t_us, f"parameters differ after start: {'; '.join(wrong[:5])}")
            return
        self.events.append((t_us, f"autopilot {version_text(status.firmware_version)} {status.firmware_hash}, "
                                  f"{len(self.flight.parameters)} parameters read back"))
        self._enter(Phase.READY, t_us)

    def _ready(self, slow: bool, t_us: int) -> None:
        status = self.link.status
        if status.armed:
            self._reached_us = None
            self._enter(Phase.TAKEOFF, t_us)
            self.link.send_command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, self.flight.height_m)
            return
        if not slow or t_us < ORIGIN_FROM_US:
            return
        ready = status.prearm_ok and status.flow_aiding
        if not ready:
            self.link.send_origin(LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M)
        elif status.mode != MODE_GUIDED:
            self.link.send_mode(MODE_GUIDED)
        else:
            self.ready_to_arm = True
            if not self.hold:
                self.link.send_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def _takeoff(self, slow: bool, t_us: int, height_m: float) -> None:
        if slow and self._off_guided(t_us):
            return
        if slow and height_m < 0.2 and self.link.status.acks.get(mavlink.MAV_CMD_NAV_TAKEOFF) != 0:
            self.link.send_command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, self.flight.height_m)
        if height_m < 0.9 * self.flight.height_m:
            self._reached_us = None
        elif self._reached_us is None:
            self._reached_us = t_us
        elif t_us - self._reached_us >= SETTLED_S * 1e6:
            self._enter(Phase.COURSE, t_us)

    def _course(self, t_us: int) -> None:
        self._off_guided(t_us)

    def _off_guided(self, t_us: int) -> bool:
        """The autopilot left guided mode, or disarmed, on its own: that ends the flight, with its reason."""
        status = self.link.status
        if status.armed and status.mode == MODE_GUIDED:
            return False
        if t_us - self._entered_us < 2_000_000 and self.phase is Phase.TAKEOFF:
            return False
        reason = status.last_text("failsafe", "variance", "error", "crash", "disarm", "ekf") or status.last_text()
        self._fail(t_us, f"autopilot left guided flight (mode {status.mode_name}, armed {status.armed}): {reason!r}")
        return True

    def _land(self, slow: bool, t_us: int) -> None:
        status = self.link.status
        if not status.armed:
            self._enter(Phase.DONE, t_us)
        elif slow and status.mode != MODE_LAND:
            self.link.send_mode(MODE_LAND)
