"""Flies the embedded autopilot in process for the tests: physics, sensors, a ground station's link."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.navigate.base import VelocityCommand
from saranga.vehicle import MODE_GUIDED, VehicleLink
from sitl.airframe import load_airframe
from sitl.autopilot.embedded import EmbeddedAutopilot
from sitl.physics import Physics, SteadyWind
from sitl.sensors import FlightSensors

AIRFRAME = load_airframe()
READY_S = 4.5


class Bench:
    """One vehicle on the ground. `run` advances simulated time; `heartbeat` may be switched off."""

    def __init__(self, seed: int = 1, parameters: Mapping[str, float] | None = None,
                 wind: SteadyWind | None = None, charge: float = 1.0) -> None:
        self.physics = Physics(AIRFRAME, (0.0, 0.0, 0.0), wind or SteadyWind(), seed, charge=charge)
        self.sensors = FlightSensors(seed)
        self.autopilot = EmbeddedAutopilot(seed, parameters)
        self.link = VehicleLink(255, 190, vehicle_type=mavlink.MAV_TYPE_GCS)
        self.messages: list[object] = []
        self.heartbeat = True
        self.throttles: list[bytes] = []
        self.autopilot.start(self.physics.state)

    @property
    def vehicle(self):
        return self.autopilot.vehicle

    @property
    def height_m(self) -> float:
        return -float(self.physics.state.pos_m[2]) - AIRFRAME.foot_height_m

    @property
    def texts(self) -> list[str]:
        """What it said, long texts put together from their chunks."""
        whole: list[str] = []
        parts: dict[int, int] = {}
        for m in self.of("STATUSTEXT"):
            if m.id and m.id in parts:
                whole[parts[m.id]] += m.text
                continue
            parts[m.id] = len(whole)
            whole.append(m.text)
        return whole

    def run(self, seconds: float, command: tuple[float, ...] | None = None, extra: bytes = b"",
            until: Callable[[], bool] | None = None) -> float:
        """Advance; `command` (vx, vy, vz[, yaw rate]) is sent at 16 Hz. Returns the seconds it took."""
        began = self.physics.state.t_us
        while self.physics.state.t_us < began + round(seconds * 1e6):
            t_us = self.physics.state.t_us
            if self.heartbeat and t_us % 1_000_000 == 0:
                self.link.send_heartbeat()
            if command is not None and t_us % 62_500 == 0:
                self.link.send_velocity(VelocityCommand(*command), t_us)
            data = self.sensors.step(self.physics.state) + self.link.take() + extra
            extra = b""
            throttle, out = self.autopilot.step(self.physics.state, data)
            self.throttles.append(throttle.tobytes())
            self.messages += self.link.feed(out, t_us)
            self.physics.step(self.autopilot.tick_us, throttle)
            if until is not None and until():
                break
        return (self.physics.state.t_us - began) / 1e6

    def send(self, message: object, seconds: float = 0.1) -> None:
        self.link.send(message)
        self.run(seconds)

    def command(self, command: int, *parameters: float, seconds: float = 0.1) -> int | None:
        """Send a COMMAND_LONG; returns the result that came back, None without an answer."""
        self.link.send_command(command, *parameters)
        self.run(seconds)
        return self.link.status.acks.get(command)

    def arm(self, force: bool = False) -> int | None:
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 2989 if force else 0)

    def make_ready(self) -> None:
        self.run(3.5)
        self.link.send_origin(42.27381, -71.80989, 150.0)
        self.run(READY_S - 3.5)

    def take_off(self, height_m: float = 1.0) -> None:
        self.make_ready()
        self.link.send_mode(MODE_GUIDED)
        self.run(0.1)
        assert self.arm() == mavlink.MAV_RESULT_ACCEPTED, self.texts
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == 0, self.texts
        self.run(10.0, until=lambda: self.height_m > 0.9 * height_m)
        self.run(3.0)

    def tilt_rad(self) -> float:
        _, x, y, _ = self.physics.state.quat
        return math.acos(1 - 2 * (x * x + y * y))

    def yaw_rad(self) -> float:
        w, x, y, z = self.physics.state.quat
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def of(self, kind: str) -> list:
        return [m for m in self.messages if m.get_type() == kind]

    def speed_m_s(self) -> float:
        return float(np.linalg.norm(self.physics.state.vel_m_s[:2]))
