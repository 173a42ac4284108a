"""The compiled tick: noisy inertial sensors from the truth, then estimator, then controller."""

import math

import numpy as np
from numba import njit

from sitl.autopilot.embedded.control import control
from sitl.autopilot.embedded.estimator import estimate

NOISE_COLUMNS = 8  # gyro 3, accelerometer 3, barometer, compass
GYRO_NOISE_RAD_S = 0.005
ACCEL_NOISE_M_S2 = 0.10
BARO_NOISE_M = 0.05
COMPASS_NOISE_RAD = 0.01


@njit(cache=True)
def tick(s, c, p, rates, accel, quat, pos, noise, bias, throttle, dt):  # type: ignore[no-untyped-def]
    """One autopilot tick.

    Args:
        s, c, p: state, command and gains (`layout`, `parameters.GAINS`).
        rates, accel, quat, pos: truth of the physics.
        noise: (8,) unit normal numbers of this tick.
        bias: (3,) the gyros' constant error, rad/s.
        throttle: (4,) out.
        dt: s.
    """
    gyro = np.empty(3)
    force = np.empty(3)
    for i in range(3):
        gyro[i] = rates[i] + bias[i] + GYRO_NOISE_RAD_S * noise[i]
        force[i] = accel[i] + ACCEL_NOISE_M_S2 * noise[3 + i]
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    estimate(s, c, p, gyro, force, -pos[2] + BARO_NOISE_M * noise[6], yaw + COMPASS_NOISE_RAD * noise[7], dt)
    control(s, c, p, throttle, dt)
