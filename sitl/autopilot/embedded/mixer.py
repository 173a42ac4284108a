"""Thrust, roll, pitch and yaw to four motor outputs, after ArduPilot's AP_MotorsMatrix."""

import math

import numpy as np
from numba import njit

from sitl.airframe import MOTOR_SIGN_X, MOTOR_SIGN_Y, MOTOR_YAW_SIGN
from sitl.autopilot.embedded.parameters import gain_index

EXPO, SPIN_MIN, SPIN_MAX = (gain_index(n) for n in ("MOT_THST_EXPO", "MOT_SPIN_MIN", "MOT_SPIN_MAX"))
SX, SY, SYAW = np.array(MOTOR_SIGN_X), np.array(MOTOR_SIGN_Y), np.array(MOTOR_YAW_SIGN)
YAW_HEADROOM = 0.2


@njit(cache=True)
def mix(p, thrust, roll, pitch, yaw, throttle):  # type: ignore[no-untyped-def]
    """Motor outputs 0..1; roll and pitch come first, then yaw, then thrust gives way."""
    tilt = np.empty(4)
    low, high = 0.0, 0.0
    for i in range(4):
        tilt[i] = -0.5 * SY[i] * roll + 0.5 * SX[i] * pitch
        low, high = min(low, tilt[i]), max(high, tilt[i])
    scale = 1.0 / (high - low) if high - low > 1.0 else 1.0
    room = max(0.5 * (1.0 - (high - low) * scale), YAW_HEADROOM)
    yaw = min(max(0.5 * yaw, -room), room)
    low, high = 0.0, 0.0
    for i in range(4):
        tilt[i] = tilt[i] * scale + SYAW[i] * yaw
        low, high = min(low, tilt[i]), max(high, tilt[i])
    if high - low > 1.0:
        for i in range(4):
            tilt[i] /= high - low
        low, high = low / (high - low), high / (high - low)
    thrust = min(max(thrust, -low), 1.0 - high)
    e = p[EXPO]
    for i in range(4):
        f = min(max(thrust + tilt[i], 0.0), 1.0)
        x = f if e < 1e-6 else (math.sqrt((1.0 - e) * (1.0 - e) + 4.0 * e * f) - (1.0 - e)) / (2.0 * e)
        throttle[i] = p[SPIN_MIN] + (p[SPIN_MAX] - p[SPIN_MIN]) * x
