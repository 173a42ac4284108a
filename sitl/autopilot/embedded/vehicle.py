"""What the parts of the embedded autopilot share: estimates, commands, flags, time, and a voice."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.parameters import Parameters

GYROS_READY_US = 1_000_000
ESTIMATOR_READY_US = 2_000_000
AIDING_FROM_US = 3_000_000
FLOW_LOST_S = 0.9
RANGE_LOST_S = 5.4
MIN_FLOW_MESSAGES, MIN_RANGES = 25, 5
REPEAT_TEXT_US = 1_000_000
EARTH_RADIUS_M = 6378137.0

EMERGENCY, ALERT, CRITICAL, ERROR, WARNING, NOTICE, INFO = range(7)
STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, BRAKE = 0, 2, 4, 5, 9, 17
MODE_NAMES = {STABILIZE: "STABILIZE", ALT_HOLD: "ALT_HOLD", GUIDED: "GUIDED", LOITER: "LOITER", LAND: "LAND",
              BRAKE: "BRAKE"}


class Vehicle:
    """State of the vehicle as the autopilot knows it.

    Attributes:
        estimate, command: arrays of `layout`.
        t_us: since boot.
        armed, landed, mode: what they say; `landed` is ArduPilot's land_complete.
        landing, taking_off: for EXTENDED_SYS_STATE.
        flow_quality, flow_rate_rad_s: as the sensor last said; None before it did.
        origin: (latitude deg, longitude deg, altitude m) or None.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self.estimate: NDArray[np.float64] = np.zeros(at.STATE_SIZE)
        self.estimate[at.Q] = 1.0
        self.estimate[at.RANGE_Z] = math.nan
        self.estimate[at.FLOW_AGE] = self.estimate[at.RANGE_AGE] = 1e6
        self.command: NDArray[np.float64] = np.zeros(at.COMMAND_SIZE)
        self.t_us = 0
        self.armed = False
        self.landed = True
        self.landing = False
        self.taking_off = False
        self.mode = STABILIZE
        self.origin: tuple[float, float, float] | None = None
        self.home_height_m = 0.0
        self.voltage_v = 0.0
        self.current_a = 0.0
        self.used_mah = 0.0
        self.failsafe = ""
        self.flow_quality = 0
        self.flow_rate_rad_s: tuple[float, float] | None = None
        self.texts: deque[tuple[int, str]] = deque(maxlen=100)
        self._said: dict[str, int] = {}

    # ---- voice -----------------------------------------------------------------------------------
    def say(self, severity: int, text: str) -> None:
        """Queue a STATUSTEXT; the same text is not repeated within a second."""
        last = self._said.get(text)
        if last is not None and self.t_us - last < REPEAT_TEXT_US:
            return
        if len(self._said) > 200:
            self._said.clear()
        self._said[text] = self.t_us
        self.texts.append((severity, text))

    # ---- estimates -------------------------------------------------------------------------------
    @property
    def height_m(self) -> float:
        """Above the ground under the range finder, less what it reads when parked."""
        return -float(self.estimate[at.P + 2]) - self.parameters["RNGFND1_GNDCLR"]

    @property
    def velocity_m_s(self) -> tuple[float, float, float]:
        v = self.estimate
        return float(v[at.V]), float(v[at.V + 1]), float(v[at.V + 2])

    @property
    def position_m(self) -> tuple[float, float, float]:
        """NED from the origin: z is zero on the ground."""
        v = self.estimate
        return float(v[at.P]), float(v[at.P + 1]), -self.height_m

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        w, x, y, z = (float(v) for v in self.estimate[at.Q:at.Q + 4])
        return (math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
                math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
                math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    @property
    def rates_rad_s(self) -> tuple[float, float, float]:
        v = self.estimate
        return float(v[at.RATE]), float(v[at.RATE + 1]), float(v[at.RATE + 2])

    @property
    def gyros_ready(self) -> bool:
        return self.t_us >= GYROS_READY_US

    @property
    def estimator_ready(self) -> bool:
        return self.t_us >= ESTIMATOR_READY_US

    @property
    def flow_fresh(self) -> bool:
        return float(self.estimate[at.FLOW_AGE]) < FLOW_LOST_S

    @property
    def range_fresh(self) -> bool:
        return float(self.estimate[at.RANGE_AGE]) < RANGE_LOST_S

    @property
    def aided(self) -> bool:
        """Flow and range give a horizontal velocity."""
        return bool(self.command[at.AIDING] > 0.0)

    def update_aiding(self) -> None:
        """Start or stop using flow, saying so."""
        seen = (self.estimate[at.FLOW_SEEN] >= MIN_FLOW_MESSAGES and self.estimate[at.RANGE_SEEN] >= MIN_RANGES)
        wanted = self.t_us >= AIDING_FROM_US and seen and self.flow_fresh and self.range_fresh
        if wanted and not self.aided:
            self.command[at.AIDING] = 1.0
            self.command[at.RESET] = 1.0
            self.say(INFO, "EKF3 IMU0 started relative aiding")
        elif self.aided and not wanted:
            self.command[at.AIDING] = 0.0
            self.say(WARNING, "EKF3 IMU0 stopped aiding: " + ("no optical flow" if self.range_fresh else "no range"))

    # ---- geography -------------------------------------------------------------------------------
    def set_origin(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> bool:
        """Once; returns whether it was taken."""
        good = all(map(math.isfinite, (latitude_deg, longitude_deg, altitude_m)))
        if self.origin is not None or not self.estimator_ready or not good:
            return False
        if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0 or (latitude_deg == 0.0 == longitude_deg):
            return False
        self.origin = (latitude_deg, longitude_deg, altitude_m)
        self.say(INFO, "EKF3 IMU0 origin set")
        return True

    def latitude_longitude_deg(self) -> tuple[float, float]:
        """Of the estimated position; (0, 0) without an origin."""
        if self.origin is None:
            return 0.0, 0.0
        north, east, _ = self.position_m
        latitude = self.origin[0] + math.degrees(north / EARTH_RADIUS_M)
        return latitude, self.origin[1] + math.degrees(east / (EARTH_RADIUS_M * math.cos(math.radians(latitude))))

    def local_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east of the origin.

        Raises:
            ValueError: no origin.
        """
        if self.origin is None:
            raise ValueError("no origin set")
        scale = EARTH_RADIUS_M * math.cos(math.radians(latitude_deg))
        return (math.radians(latitude_deg - self.origin[0]) * EARTH_RADIUS_M,
                math.radians(longitude_deg - self.origin[1]) * scale)
