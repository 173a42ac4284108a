"""The embedded autopilot: a small guided-mode copter that answers the MAVLink an ArduCopter answers.

It identifies itself as ArduPilot so that ground stations treat it alike, and by banner, version and custom
version ("EMBEDDED") says what it is. Ready to arm about 4 simulated seconds after boot (ArduCopter: 23 s).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.arming import prearm_problems
from sitl.autopilot.embedded.failsafes import Failsafes
from sitl.autopilot.embedded.inner import NOISE_COLUMNS, tick
from sitl.autopilot.embedded.messages import BANNER, BUILDERS, CUSTOM_VERSION, Schedule
from sitl.autopilot.embedded.modes import Modes, Setpoint
from sitl.autopilot.embedded.parameters import Parameters
from sitl.autopilot.embedded.requests import Requests
from sitl.autopilot.embedded.setpoints import (
    Refusal,
    read_flow,
    read_local,
    read_range,
    refuse,
    target_systems,
)
from sitl.autopilot.embedded.vehicle import INFO, WARNING, Vehicle
from sitl.autopilot.frames import Frame, FrameReader
from sitl.physics import VehicleState

VERSION = "0.1.0"
TICK_US = 2_500
SLOW_TICKS = 8  # modes, failsafes and telemetry run at 50 Hz
NOISE_ROWS = 2048
PREARM_TEXT_US = 30_000_000
GYRO_BIAS_RAD_S = 0.002
TEXT_BYTES = 50


class EmbeddedAutopilot:
    """Implements `sitl.autopilot.base.Autopilot`.

    Args:
        seed: of the inertial sensors' noise and biases.
        parameters: values that differ from the defaults of `parameters.DEFINITIONS`.

    Raises:
        UsageError: an unknown parameter or a value outside its limits.
    """

    kind = "embedded"
    tick_us = TICK_US

    def __init__(self, seed: int = 0, parameters: Mapping[str, float] | None = None) -> None:
        self.version = f"{VERSION} {CUSTOM_VERSION.decode()}"
        self.parameters = Parameters(parameters)
        self._seed = seed
        self._dead: str | None = None
        self._boot()

    def _boot(self) -> None:
        self._rng = np.random.default_rng(np.random.SeedSequence([self._seed, 0xE3BED]))
        self._gyro_bias = GYRO_BIAS_RAD_S * self._rng.standard_normal(3)
        self._noise = np.empty((0, NOISE_COLUMNS))
        self._row = 0
        self._ticks = 0
        self._start_us = 0
        self.vehicle = Vehicle(self.parameters)
        self.modes = Modes(self.vehicle)
        self.schedule = Schedule()
        self.failsafes = Failsafes(self.vehicle, self.modes)
        self.requests = Requests(self.vehicle, self.modes, self.schedule, self._send)
        self.reader = FrameReader()
        self._system = int(self.parameters["SYSID_THISMAV"])
        self._mav = mavlink.MAVLink(None, srcSystem=self._system, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._out = bytearray()
        self._throttle = np.zeros(4)
        self._pending: list[tuple[int, Setpoint | None]] = []
        self._flow_us: int | None = None
        self._text_id = 0
        self._prearm_us = 0
        self._calibrating = np.zeros(3)

    # ---- life ------------------------------------------------------------------------------------
    def start(self, state: VehicleState) -> None:
        """Boot afresh at the time of `state`."""
        self._boot()
        self._start_us = state.t_us
        self.vehicle.say(INFO, f"{BANNER} {VERSION}")
        self.vehicle.say(INFO, "Frame: QUAD/X")

    def health(self) -> str | None:
        return self._dead

    def close(self) -> None:
        """Nothing to leave behind."""

    def kill(self) -> None:
        """Stop for good (fault campaigns): from the next tick on the motors stand still and nothing is said."""
        self._dead = "embedded autopilot was killed"

    # ---- one tick --------------------------------------------------------------------------------
    def step(self, state: VehicleState, mavlink_in: bytes) -> tuple[NDArray[np.float64], bytes]:
        """See `Autopilot.step`. Never raises on rubbish in `mavlink_in`.

        Raises:
            DeviceError: after `kill`.
        """
        if self._dead is not None:
            from saranga.errors import DeviceError

            raise DeviceError(self._dead)
        vehicle = self.vehicle
        vehicle.t_us = state.t_us - self._start_us
        if mavlink_in:
            for frame in self.reader.feed(mavlink_in):
                self._take(frame)
        if self._pending and self._pending[0][0] <= vehicle.t_us:
            self._apply_setpoints()
        if self._row >= len(self._noise):
            self._noise = self._rng.standard_normal((NOISE_ROWS, NOISE_COLUMNS))
            self._row = 0
        tick(vehicle.estimate, vehicle.command, self.parameters.gains, state.rates_rad_s, state.accel_body_m_s2,
             state.quat, state.pos_m, self._noise[self._row], self._gyro_bias, self._throttle, TICK_US * 1e-6)
        self._row += 1
        if self._ticks % SLOW_TICKS == 0:
            self._slow(state)
        self._ticks += 1
        if not self._out:
            return self._throttle, b""
        out = bytes(self._out)
        self._out.clear()
        return self._throttle, out

    def _slow(self, state: VehicleState) -> None:
        vehicle = self.vehicle
        dt_s = SLOW_TICKS * TICK_US * 1e-6
        vehicle.voltage_v = state.voltage_v
        vehicle.current_a = state.current_a
        vehicle.used_mah += state.current_a * dt_s / 3.6
        if not vehicle.estimator_ready:
            self._calibrate()
        elif vehicle.origin is None and (self.parameters["AHRS_ORIG_LAT"] or self.parameters["AHRS_ORIG_LON"]):
            vehicle.set_origin(*(self.parameters[f"AHRS_ORIG_{n}"] for n in ("LAT", "LON", "ALT")))
        vehicle.update_aiding()
        self.failsafes.update(dt_s)
        self.modes.update(dt_s)
        self.requests.update()
        if not vehicle.armed and vehicle.t_us - self._prearm_us >= PREARM_TEXT_US:
            self._prearm_us = vehicle.t_us
            for problem in prearm_problems(vehicle):
                vehicle.say(WARNING, f"PreArm: {problem}")
        for message_id in self.schedule.due(vehicle.t_us):
            message = BUILDERS[message_id](vehicle)
            if message is not None:
                self._send(message)
        while vehicle.texts:
            self._send_text(*vehicle.texts.popleft())

    def _calibrate(self) -> None:
        """While standing still after boot: gyro bias from the mean, heading from the compass."""
        estimate = self.vehicle.estimate
        if not self.vehicle.gyros_ready:
            self._calibrating += 0.08 * (estimate[at.GYRO_FILTER:at.GYRO_FILTER + 3] - self._calibrating)
            estimate[at.BIAS:at.BIAS + 3] = self._calibrating

    # ---- bytes out -------------------------------------------------------------------------------
    def _send(self, message: object) -> None:
        self._out += message.pack(self._mav)  # type: ignore[attr-defined]

    def _send_text(self, severity: int, text: str) -> None:
        """STATUSTEXT, in chunks where it is longer than one."""
        data = text.encode("ascii", "replace")
        if len(data) <= TEXT_BYTES:
            self._send(mavlink.MAVLink_statustext_message(severity, data))
            return
        self._text_id = self._text_id % 65535 + 1
        for number, start in enumerate(range(0, len(data) + 1, TEXT_BYTES)):
            self._send(mavlink.MAVLink_statustext_message(severity, data[start:start + TEXT_BYTES], self._text_id,
                                                          number))

    # ---- bytes in --------------------------------------------------------------------------------
    def _take(self, frame: Frame) -> None:
        vehicle = self.vehicle
        kind = frame.message_id
        if kind == mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW:
            if self._flow_us is not None:
                read_flow(vehicle, frame.payload, (vehicle.t_us - self._flow_us) * 1e-6)
            self._flow_us = vehicle.t_us
        elif kind == mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR:
            read_range(vehicle, frame.payload)
        elif kind == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            system, component = target_systems(frame.payload)
            if system in (0, self._system) and component in (0, mavlink.MAV_COMP_ID_AUTOPILOT1):
                self._take_setpoint(frame.payload)
        elif kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            if frame.system == int(self.parameters["SYSID_MYGCS"]):
                self.failsafes.gcs_heard_us = vehicle.t_us
        elif frame.system != self._system or frame.component != mavlink.MAV_COMP_ID_AUTOPILOT1:
            message = self.reader.decode(frame)
            if message is not None:
                self.requests.handle(message)

    def _take_setpoint(self, payload: bytes) -> None:
        setpoint = read_local(self.vehicle, payload)
        delay_us = round(self.parameters["EMB_CMD_DELAY"] * 1000)
        if isinstance(setpoint, Refusal):
            refuse(self.vehicle, setpoint)
            self._pending.append((self.vehicle.t_us + delay_us, None))
        else:
            self._pending.append((self.vehicle.t_us + delay_us, setpoint))

    def _apply_setpoints(self) -> None:
        while self._pending and self._pending[0][0] <= self.vehicle.t_us:
            _, setpoint = self._pending.pop(0)
            if setpoint is None:
                self.modes.stop()
            else:
                self.modes.set_target(setpoint)
        self.modes.update(0.0)
