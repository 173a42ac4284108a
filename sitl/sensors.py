"""The sensors that reach the autopilot as MAVLink: optical flow and the downward range finder.

Both autopilots get the same bytes, so losing them degrades both. ArduPilot's MAVLink flow driver takes
the rate as int16 `flow_x`, `flow_y` times the interval between messages: at 50 Hz one count is 0.02 rad/s,
too coarse alone, so the rounding error is carried into the next message (error feedback).

Sign convention (ArduPilot): flow rate = body rate plus the apparent motion of the ground,
flow_x = gyro_x - v_y / range, flow_y = gyro_y + v_x / range, with v the sensor's velocity in the body frame.
"""

import math

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.clock import Periodic
from sitl.physics import VehicleState

FLOW_PERIOD_US = 20_000
RANGE_PERIOD_US = 50_000
FLOW_COUNT_RAD_S = 0.02
FLOW_NOISE_RAD_S = 0.02
FLOW_MAX_RAD_S = 7.0
RANGE_NOISE_M = 0.004
RANGE_MIN_M = 0.02
RANGE_MAX_M = 5.0
MOUNT_HEIGHT_M = 0.03
SENSOR_COMPONENT = mavlink.MAV_COMP_ID_PERIPHERAL


class FlightSensors:
    """Makes OPTICAL_FLOW (50 Hz) and DISTANCE_SENSOR (20 Hz) from the physics' truth plus seeded noise.

    Args:
        seed: of the noise.
        system_id: the vehicle's own, so that the messages count as coming from aboard.

    Attributes:
        flow_enabled, range_enabled, flow_quality (0..255), flow_every (only each n-th comes), range_offset_m: what
            a fault changes.
    """

    def __init__(self, seed: int, system_id: int = 1) -> None:
        self._rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5E45]))
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=SENSOR_COMPONENT)
        self._flow_timer = Periodic(FLOW_PERIOD_US)
        self._range_timer = Periodic(RANGE_PERIOD_US)
        self._rate_sum = [0.0, 0.0]
        self._samples = 0
        self._carry = [0.0, 0.0]
        self.flow_enabled = True
        self.range_enabled = True
        self.flow_quality = 255
        self.flow_every = 1
        self.range_offset_m = 0.0
        self._flows = 0

    def step(self, state: VehicleState) -> bytes:
        """Bytes due at this physics tick, mostly none."""
        w, x, y, z = state.quat.tolist()
        v_north, v_east, v_down = state.vel_m_s.tolist()
        body_vx = (1 - 2 * (y * y + z * z)) * v_north + 2 * (x * y + w * z) * v_east + 2 * (x * z - w * y) * v_down
        body_vy = 2 * (x * y - w * z) * v_north + (1 - 2 * (x * x + z * z)) * v_east + 2 * (y * z + w * x) * v_down
        cos_tilt = 1 - 2 * (x * x + y * y)
        height_m = max(-float(state.pos_m[2]), 0.0)
        range_m = max(height_m / max(cos_tilt, 0.2), MOUNT_HEIGHT_M)
        self._rate_sum[0] += float(state.rates_rad_s[0]) - body_vy / range_m
        self._rate_sum[1] += float(state.rates_rad_s[1]) + body_vx / range_m
        self._samples += 1
        out = b""
        if self._flow_timer.due(state.t_us):
            out += self._flow(state.t_us, range_m)
        if self._range_timer.due(state.t_us):
            out += self._distance(state.t_us, range_m)
        return out

    def _flow(self, t_us: int, range_m: float) -> bytes:
        noise = self._rng.standard_normal(2)
        counts = []
        for axis in (0, 1):
            rate = self._rate_sum[axis] / self._samples + FLOW_NOISE_RAD_S * float(noise[axis])
            wanted = max(-FLOW_MAX_RAD_S, min(FLOW_MAX_RAD_S, rate)) / FLOW_COUNT_RAD_S + self._carry[axis]
            count = math.floor(wanted + 0.5)
            self._carry[axis] = wanted - count
            counts.append(count)
        self._rate_sum = [0.0, 0.0]
        self._samples = 0
        self._flows += 1
        if not self.flow_enabled or self._flows % self.flow_every:
            return b""
        message = mavlink.MAVLink_optical_flow_message(t_us, 0, counts[0], counts[1], 0.0, 0.0, self.flow_quality,
                                                       range_m)
        return message.pack(self._mav)

    def _distance(self, t_us: int, range_m: float) -> bytes:
        noise_m = RANGE_NOISE_M * float(self._rng.standard_normal())
        measured_m = max(range_m + self.range_offset_m + noise_m, RANGE_MIN_M)
        if not self.range_enabled:
            return b""
        message = mavlink.MAVLink_distance_sensor_message(
            (t_us // 1000) & 0xFFFFFFFF, round(RANGE_MIN_M * 100), round(RANGE_MAX_M * 100),
            min(round(measured_m * 100), round(RANGE_MAX_M * 100) + 1), mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 1,
            mavlink.MAV_SENSOR_ROTATION_PITCH_270, 0)
        return message.pack(self._mav)
