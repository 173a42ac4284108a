"""Attitude, velocity, position and biases from gyro, accelerometer, compass, flow and range: a fixed-gain observer.

Strapdown integration with corrections from the innovations of each sensor (an observer with constant gains in
place of the covariances of a Kalman filter). A horizontal velocity innovation corrects velocity, tilt (a
tilt error d makes a velocity error grow as g x d) and gyro bias; the range does the same for height, climb
rate and the vertical accelerometer bias. Flow is compared with the mean prediction over the interval it was
integrated over, so the delay of half an interval costs nothing.
"""

import math

from numba import njit

from sitl.airframe import GRAVITY_M_S2
from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.parameters import gain_index

Q, V, P, BIAS, ACC_BIAS, RATE = at.Q, at.V, at.P, at.BIAS, at.ACC_BIAS, at.RATE
SUM_GYRO, SUM_V, SUM_N, RANGE_Z = at.SUM_GYRO, at.SUM_V, at.SUM_N, at.RANGE_Z
BARO, BARO_OFFSET = at.BARO, at.BARO_OFFSET
FLOW_AGE, RANGE_AGE, ACCEL_W, GYRO_FILTER = at.FLOW_AGE, at.RANGE_AGE, at.ACCEL_W, at.GYRO_FILTER
FLOW_SEEN, RANGE_SEEN = at.FLOW_SEEN, at.RANGE_SEEN
NEW_FLOW, FLOW_X, FLOW_Y, NEW_RANGE, RANGE_M, AIDING = (
    at.NEW_FLOW, at.FLOW_X, at.FLOW_Y, at.NEW_RANGE, at.RANGE_M, at.AIDING)
G = GRAVITY_M_S2
K_V, K_T, K_B = gain_index("EMB_KV"), gain_index("EMB_KT"), gain_index("EMB_KB")
K_Z, K_VZ, K_BZ, K_YAW = (gain_index(n) for n in ("EMB_KZ", "EMB_KVZ", "EMB_KBZ", "EMB_KYAW"))
K_GYRO, K_CLEAR = gain_index("INS_GYRO_FILTER"), gain_index("RNGFND1_GNDCLR")

RANGE_TIMEOUT_S = 0.5  # as ArduPilot's range finder driver
BARO_RATE_HZ = 2.0  # of the low-pass
FLOW_INTERVAL_S = 0.02
RANGE_INTERVAL_S = 0.05
ZERO_VELOCITY_RATE = 0.5  # 1/s, pull to no velocity while nothing aids
MAX_BIAS = 0.1
MAX_ACC_BIAS = 1.0


@njit(cache=True)
def level(s):  # type: ignore[no-untyped-def]
    """(roll, pitch, yaw) of the estimated attitude, rad."""
    w, x, y, z = s[Q], s[Q + 1], s[Q + 2], s[Q + 3]
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


@njit(cache=True)
def turn(s, rx, ry, rz):  # type: ignore[no-untyped-def]
    """Rotate the attitude estimate by a small world-frame rotation vector."""
    w, x, y, z = s[Q], s[Q + 1], s[Q + 2], s[Q + 3]
    hx, hy, hz = 0.5 * rx, 0.5 * ry, 0.5 * rz
    nw = w - hx * x - hy * y - hz * z
    nx = x + hx * w + hy * z - hz * y
    ny = y - hx * z + hy * w + hz * x
    nz = z + hx * y - hy * x + hz * w
    norm = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    s[Q], s[Q + 1], s[Q + 2], s[Q + 3] = nw * norm, nx * norm, ny * norm, nz * norm


@njit(cache=True)
def correct_velocity(s, p, en, ee, kv, kt, kb, dt):  # type: ignore[no-untyped-def]
    """Spread a horizontal velocity innovation (m/s) that stands for `dt` seconds over velocity, tilt and bias."""
    s[V] += kv * dt * en
    s[V + 1] += kv * dt * ee
    tilt_x, tilt_y = kt * dt * ee / G, -kt * dt * en / G
    turn(s, tilt_x, tilt_y, 0.0)
    # A world-frame tilt that keeps coming back is a gyro bias of the other sign, in the body frame.
    bx, by = -kb * dt * ee / G, kb * dt * en / G
    w, x, y, z = s[Q], s[Q + 1], s[Q + 2], s[Q + 3]
    s[BIAS] += (1 - 2 * (y * y + z * z)) * bx + 2 * (x * y + w * z) * by
    s[BIAS + 1] += 2 * (x * y - w * z) * bx + (1 - 2 * (x * x + z * z)) * by
    for i in range(2):
        s[BIAS + i] = min(max(s[BIAS + i], -MAX_BIAS), MAX_BIAS)


@njit(cache=True)
def estimate(s, c, p, gyro, accel, baro_m, compass_rad, dt):  # type: ignore[no-untyped-def]
    """One step of `dt` seconds. gyro, accel (3,) body; writes the state `s`, clears NEW_FLOW and NEW_RANGE in `c`."""
    blend = 1.0 - math.exp(-2.0 * math.pi * p[K_GYRO] * dt)
    for i in range(3):
        s[GYRO_FILTER + i] += blend * (gyro[i] - s[GYRO_FILTER + i])
        s[RATE + i] = s[GYRO_FILTER + i] - s[BIAS + i]

    # Attitude.
    wx, wy, wz = gyro[0] - s[BIAS], gyro[1] - s[BIAS + 1], gyro[2] - s[BIAS + 2]
    w, x, y, z = s[Q], s[Q + 1], s[Q + 2], s[Q + 3]
    hx, hy, hz = 0.5 * wx * dt, 0.5 * wy * dt, 0.5 * wz * dt
    nw = w - x * hx - y * hy - z * hz
    nx = x + w * hx + y * hz - z * hy
    ny = y + w * hy - x * hz + z * hx
    nz = z + w * hz + x * hy - y * hx
    norm = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    w, x, y, z = nw * norm, nx * norm, ny * norm, nz * norm
    s[Q], s[Q + 1], s[Q + 2], s[Q + 3] = w, x, y, z
    _, _, yaw = level(s)
    error = compass_rad - yaw
    error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
    turn(s, 0.0, 0.0, p[K_YAW] * dt * error)
    w, x, y, z = s[Q], s[Q + 1], s[Q + 2], s[Q + 3]

    # Velocity and position.
    r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    an = r00 * accel[0] + r01 * accel[1] + r02 * accel[2]
    ae = r10 * accel[0] + r11 * accel[1] + r12 * accel[2]
    ad = r20 * accel[0] + r21 * accel[1] + r22 * accel[2] + G - s[ACC_BIAS]
    s[ACCEL_W], s[ACCEL_W + 1], s[ACCEL_W + 2] = an, ae, ad
    aided = c[AIDING] > 0.0
    s[V] += an * dt
    s[V + 1] += ae * dt
    s[V + 2] += ad * dt
    if aided:
        s[P] += s[V] * dt
        s[P + 1] += s[V + 1] * dt
    s[P + 2] += s[V + 2] * dt

    # Flow.
    s[FLOW_AGE] += dt
    s[SUM_GYRO] += wx
    s[SUM_GYRO + 1] += wy
    s[SUM_V] += r00 * s[V] + r10 * s[V + 1] + r20 * s[V + 2]
    s[SUM_V + 1] += r01 * s[V] + r11 * s[V + 1] + r21 * s[V + 2]
    s[SUM_N] += 1.0
    if c[NEW_FLOW] > 0.0:
        c[NEW_FLOW] = 0.0
        n = s[SUM_N]
        distance = max(-s[P + 2], p[K_CLEAR]) / max(r22, 0.3)
        ex = (c[FLOW_Y] - s[SUM_GYRO + 1] / n) * distance - s[SUM_V] / n
        ey = -(c[FLOW_X] - s[SUM_GYRO] / n) * distance - s[SUM_V + 1] / n
        span = min(n * dt, 0.1)
        if aided and r22 > 0.3:
            correct_velocity(s, p, r00 * ex + r01 * ey, r10 * ex + r11 * ey, p[K_V], p[K_T], p[K_B], span)
        s[FLOW_AGE] = 0.0
        s[FLOW_SEEN] += 1.0
        s[SUM_GYRO] = s[SUM_GYRO + 1] = s[SUM_V] = s[SUM_V + 1] = s[SUM_N] = 0.0
    elif s[SUM_N] * dt > 0.2:
        s[SUM_GYRO] = s[SUM_GYRO + 1] = s[SUM_V] = s[SUM_V + 1] = s[SUM_N] = 0.0
    if not aided:
        correct_velocity(s, p, -s[V], -s[V + 1], ZERO_VELOCITY_RATE, ZERO_VELOCITY_RATE, 0.0, dt)

    # Height: the range when there is one, the barometer otherwise.
    s[BARO] += (1.0 - math.exp(-2.0 * math.pi * BARO_RATE_HZ * dt)) * (baro_m - s[BARO])
    s[RANGE_AGE] += dt
    innovation, span = 0.0, 0.0
    if c[NEW_RANGE] > 0.0:
        c[NEW_RANGE] = 0.0
        height = c[RANGE_M] * r22
        s[RANGE_AGE] = 0.0
        s[RANGE_Z] = height
        s[RANGE_SEEN] += 1.0
        s[BARO_OFFSET] += min(0.05, 1.0) * (s[BARO] - height - s[BARO_OFFSET])
        if s[RANGE_SEEN] == 1.0:
            s[BARO_OFFSET] = s[BARO] - height
            s[P + 2] = -height
        innovation, span = -height - s[P + 2], RANGE_INTERVAL_S
    elif s[RANGE_AGE] > RANGE_TIMEOUT_S:
        innovation, span = -(s[BARO] - s[BARO_OFFSET]) - s[P + 2], dt
    if span > 0.0:
        s[P + 2] += p[K_Z] * span * innovation
        s[V + 2] += p[K_VZ] * span * innovation
        bias = s[ACC_BIAS] - p[K_BZ] * span * innovation
        s[ACC_BIAS] = min(max(bias, -MAX_ACC_BIAS), MAX_ACC_BIAS)
