"""From setpoint to motor outputs: ArduCopter's cascade in small.

Setpoints are shaped to limited acceleration and jerk, then position P, velocity PID, lean angles, attitude
with input shaping and rate feed-forward, rate PID, mixer. The structure and the default gains follow
ArduPilot's AC_PosControl and AC_AttitudeControl, so that its parameters mean here what they mean there.
"""

import math

import numpy as np
from numba import njit

from sitl.airframe import GRAVITY_M_S2
from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.estimator import level
from sitl.autopilot.embedded.mixer import mix
from sitl.autopilot.embedded.parameters import gain_index
from sitl.autopilot.embedded.shaping import alpha, sqrt_controller

Q, V, P, RATE, ACCEL_W = at.Q, at.V, at.P, at.RATE, at.ACCEL_W
PD, VD, AD, IV, EV, DV, IZ = at.PD, at.VD, at.AD, at.IV, at.EV, at.DV, at.IZ
ATT, ATT_RATE, IR, RATE_TARGET, RATE_D, RATE_E = at.ATT, at.ATT_RATE, at.IR, at.RATE_TARGET, at.RATE_D, at.RATE_E
THRUST, SPOOL, LIMIT_LOW, ANGLE_ERROR, ACCEL_Z_ERROR = (
    at.THRUST, at.SPOOL, at.LIMIT_LOW, at.ANGLE_ERROR, at.ACCEL_Z_ERROR)
CONTROL, HORIZONTAL, VERTICAL, COMMAND_V, COMMAND_P = at.CONTROL, at.HORIZONTAL, at.VERTICAL, at.COMMAND_V, at.COMMAND_P
YAW_MODE, COMMAND_YAW, CLIMB_LIMIT, RESET = at.YAW_MODE, at.COMMAND_YAW, at.CLIMB_LIMIT, at.RESET
STOPPED, IDLE, FLYING = at.STOPPED, at.IDLE, at.FLYING
LEVEL, POSITION, Z_POSITION = at.LEVEL, at.POSITION, at.Z_POSITION

G = GRAVITY_M_S2
ACCEL_XY, SPEED_XY, JERK_XY, POS_P = (
    gain_index(n) for n in ("WPNAV_ACCEL", "WPNAV_SPEED", "PSC_JERK_XY", "PSC_POSXY_P"))
VEL_P, VEL_I, VEL_D, VEL_FLTE, VEL_FLTD, VEL_IMAX = (
    gain_index(f"PSC_VELXY_{n}") for n in ("P", "I", "D", "FLTE", "FLTD", "IMAX"))
SPEED_UP, SPEED_DN, ACCEL_Z, JERK_Z = (
    gain_index(n) for n in ("WPNAV_SPEED_UP", "WPNAV_SPEED_DN", "WPNAV_ACCEL_Z", "PSC_JERK_Z"))
POSZ_P, VELZ_P, ACCZ_P, ACCZ_I, ACCZ_FLTE = (
    gain_index(n) for n in ("PSC_POSZ_P", "PSC_VELZ_P", "PSC_ACCZ_P", "PSC_ACCZ_I", "PSC_ACCZ_FLTE"))
ANGLE_MAX, INPUT_TC = gain_index("ANGLE_MAX"), gain_index("ATC_INPUT_TC")
ANG_P, ACCEL_MAX = gain_index("ATC_ANG_RLL_P"), gain_index("ATC_ACCEL_R_MAX")
RATE_P = np.array([gain_index(f"ATC_RAT_{n}_P") for n in ("RLL", "PIT", "YAW")])
RATE_I = np.array([gain_index(f"ATC_RAT_{n}_I") for n in ("RLL", "PIT", "YAW")])
RATE_DG = np.array([gain_index("ATC_RAT_RLL_D"), gain_index("ATC_RAT_PIT_D"), -1])
RATE_FLTT, RATE_FLTD = gain_index("ATC_RAT_RLL_FLTT"), gain_index("ATC_RAT_RLL_FLTD")
HOVER, SPIN_ARM, SPOOL_TIME = (gain_index(n) for n in ("MOT_THST_HOVER", "MOT_SPIN_ARM", "MOT_SPOOL_TIME"))
POSITION_LEASH_M = 2.0
RATE_IMAX = 0.25
MIN_VERTICAL_THRUST = 0.02
LIFT_PART = 0.5  # of the hover thrust, at the end of the spool-up


@njit(cache=True)
def shape_horizontal(s, vn, ve, accel_max, jerk, dt):  # type: ignore[no-untyped-def]
    """Move the desired velocity towards (vn, ve) within acceleration and jerk; the position target goes along."""
    en, ee = vn - s[VD], ve - s[VD + 1]
    size = math.sqrt(en * en + ee * ee)
    an, ae = 0.0, 0.0
    if size > 1e-9:
        wanted = min(sqrt_controller(size, jerk / accel_max, jerk, dt), accel_max)
        an, ae = wanted * en / size, wanted * ee / size
    jn, je = (an - s[AD]) / dt, (ae - s[AD + 1]) / dt
    size = math.sqrt(jn * jn + je * je)
    if size > jerk:
        jn, je = jn * jerk / size, je * jerk / size
    s[AD] += jn * dt
    s[AD + 1] += je * dt
    for i in range(2):
        s[VD + i] += s[AD + i] * dt
        s[PD + i] += s[VD + i] * dt


@njit(cache=True)
def horizontal(s, c, p, dt):  # type: ignore[no-untyped-def]
    """Wanted horizontal acceleration (north, east) m/s^2."""
    if c[HORIZONTAL] == LEVEL:
        for i in range(2):
            s[PD + i], s[VD + i], s[AD + i] = s[P + i], s[V + i], 0.0
            s[IV + i] = s[EV + i] = s[DV + i] = 0.0
        return 0.0, 0.0
    vn, ve = c[COMMAND_V], c[COMMAND_V + 1]
    if c[HORIZONTAL] == POSITION:
        dn, de = c[COMMAND_P] - s[PD], c[COMMAND_P + 1] - s[PD + 1]
        size = math.sqrt(dn * dn + de * de)
        speed = min(sqrt_controller(size, p[POS_P], 0.5 * p[ACCEL_XY], dt), p[SPEED_XY]) if size > 1e-9 else 0.0
        vn, ve = (dn / size * speed, de / size * speed) if size > 1e-9 else (0.0, 0.0)
    shape_horizontal(s, vn, ve, p[ACCEL_XY], p[JERK_XY], dt)
    dn, de = s[PD] - s[P], s[PD + 1] - s[P + 1]
    size = math.sqrt(dn * dn + de * de)
    if size > POSITION_LEASH_M:
        dn, de = dn * POSITION_LEASH_M / size, de * POSITION_LEASH_M / size
        s[PD], s[PD + 1] = s[P] + dn, s[P + 1] + de
    leash = (dn, de)
    out = [0.0, 0.0]
    for i in range(2):
        error = s[VD + i] + p[POS_P] * leash[i] - s[V + i]
        before = s[EV + i]
        s[EV + i] += alpha(p[VEL_FLTE], dt) * (error - before)
        s[DV + i] += alpha(p[VEL_FLTD], dt) * ((s[EV + i] - before) / dt - s[DV + i])
        s[IV + i] += p[VEL_I] * s[EV + i] * dt
        s[IV + i] = min(max(s[IV + i], -p[VEL_IMAX]), p[VEL_IMAX])
        out[i] = s[AD + i] + p[VEL_P] * s[EV + i] + s[IV + i] + p[VEL_D] * s[DV + i]
    return out[0], out[1]


@njit(cache=True)
def vertical(s, c, p, dt):  # type: ignore[no-untyped-def]
    """Wanted thrust fraction along the vertical, before lean compensation."""
    climb = c[CLIMB_LIMIT]
    wanted = c[COMMAND_V + 2]
    if c[VERTICAL] == Z_POSITION:
        wanted = sqrt_controller(c[COMMAND_P + 2] - s[PD + 2], p[POSZ_P], 0.5 * p[ACCEL_Z], dt)
    wanted = min(max(wanted, -climb), p[SPEED_DN])
    error = wanted - s[VD + 2]
    accel = sqrt_controller(error, p[JERK_Z] / p[ACCEL_Z], p[JERK_Z], dt) if error != 0.0 else 0.0
    accel = min(max(accel, -p[ACCEL_Z]), p[ACCEL_Z])
    jerk = min(max((accel - s[AD + 2]) / dt, -p[JERK_Z]), p[JERK_Z])
    s[AD + 2] += jerk * dt
    s[VD + 2] += s[AD + 2] * dt
    s[PD + 2] += s[VD + 2] * dt
    gap = s[PD + 2] - s[P + 2]
    if abs(gap) > POSITION_LEASH_M:
        gap = min(max(gap, -POSITION_LEASH_M), POSITION_LEASH_M)
        s[PD + 2] = s[P + 2] + gap
    velocity = s[VD + 2] + p[POSZ_P] * gap
    target = s[AD + 2] + p[VELZ_P] * (velocity - s[V + 2])
    target = min(max(target, -G), G)
    s[ACCEL_Z_ERROR] += alpha(p[ACCZ_FLTE], dt) * (target - s[ACCEL_W + 2] - s[ACCEL_Z_ERROR])
    error = s[ACCEL_Z_ERROR]
    # Down is positive: more thrust is a negative error. The integrator stops while the output is at a limit.
    grown = s[IZ] - p[ACCZ_I] * error * dt
    if not (s[LIMIT_LOW] > 0.0 and grown < s[IZ]):
        s[IZ] = min(max(grown, -0.8), 0.8)
    thrust = p[HOVER] + s[IZ] - p[ACCZ_P] * error
    s[LIMIT_LOW] = 1.0 if thrust <= MIN_VERTICAL_THRUST else 0.0
    return min(max(thrust, MIN_VERTICAL_THRUST), 1.0)


@njit(cache=True)
def attitude(s, c, p, an, ae, dt):  # type: ignore[no-untyped-def]
    """Rate targets from the wanted acceleration: lean angles, input shaping, angle P and feed-forward."""
    roll, pitch, yaw = level(s)
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    forward, right = cos_yaw * an + sin_yaw * ae, -sin_yaw * an + cos_yaw * ae
    most = G * math.tan(p[ANGLE_MAX])
    size = math.sqrt(forward * forward + right * right)
    if size > most:
        forward, right = forward * most / size, right * most / size
    wanted_pitch = math.atan2(-forward, G)
    wanted_roll = math.atan2(right * math.cos(wanted_pitch), G)
    wanted = (wanted_roll, wanted_pitch)
    for i in range(2):
        rate = sqrt_controller(wanted[i] - s[ATT + i], 1.0 / max(p[INPUT_TC], 0.01), p[ACCEL_MAX + i], dt)
        change = p[ACCEL_MAX + i] * dt
        s[ATT_RATE + i] = min(max(rate, s[ATT_RATE + i] - change), s[ATT_RATE + i] + change)
        s[ATT + i] += s[ATT_RATE + i] * dt
    if c[YAW_MODE] == 0.0:
        rate = c[COMMAND_YAW]
    else:
        error = c[COMMAND_YAW] - s[ATT + 2]
        error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
        rate = sqrt_controller(error, 1.0 / max(p[INPUT_TC], 0.01), p[ACCEL_MAX + 2], dt)
    change = p[ACCEL_MAX + 2] * dt
    s[ATT_RATE + 2] = min(max(rate, s[ATT_RATE + 2] - change), s[ATT_RATE + 2] + change)
    s[ATT + 2] += s[ATT_RATE + 2] * dt

    # Rotation from the estimated to the target attitude, in the body frame.
    hr, hp, hy = 0.5 * s[ATT], 0.5 * s[ATT + 1], 0.5 * s[ATT + 2]
    cr, sr, cp, sp, cy, sy = math.cos(hr), math.sin(hr), math.cos(hp), math.sin(hp), math.cos(hy), math.sin(hy)
    tw, tx = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    ty, tz = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    w, x, y, z = s[Q], s[Q + 1], s[Q + 2], s[Q + 3]
    ew = w * tw + x * tx + y * ty + z * tz
    ex = w * tx - x * tw - y * tz + z * ty
    ey = w * ty + x * tz - y * tw - z * tx
    ez = w * tz - x * ty + y * tx - z * tw
    if ew < 0.0:
        ew, ex, ey, ez = -ew, -ex, -ey, -ez
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    angle = 2.0 * math.atan2(length, ew)
    scale = angle / length if length > 1e-9 else 2.0
    s[ANGLE_ERROR] = 2.0 * math.atan2(math.sqrt(ex * ex + ey * ey), math.sqrt(ew * ew + ez * ez))
    errors = (ex * scale, ey * scale, ez * scale)
    # Feed-forward: the target's Euler rates seen from the body.
    sp, cp, sr, cr = math.sin(pitch), math.cos(pitch), math.sin(roll), math.cos(roll)
    dr, dp, dy = s[ATT_RATE], s[ATT_RATE + 1], s[ATT_RATE + 2]
    forward_rates = (dr - sp * dy, cr * dp + sr * cp * dy, -sr * dp + cr * cp * dy)
    out = [0.0, 0.0, 0.0]
    for i in range(3):
        out[i] = forward_rates[i] + sqrt_controller(errors[i], p[ANG_P + i], 0.5 * p[ACCEL_MAX + i], dt)
    return out[0], out[1], out[2]


@njit(cache=True)
def rates(s, p, targets, dt):  # type: ignore[no-untyped-def]
    """Rate PID: roll, pitch, yaw in thrust fractions."""
    out = [0.0, 0.0, 0.0]
    for i in range(3):
        s[RATE_TARGET + i] += alpha(p[RATE_FLTT], dt) * (targets[i] - s[RATE_TARGET + i])
        error = s[RATE_TARGET + i] - s[RATE + i]
        s[RATE_D + i] += alpha(p[RATE_FLTD], dt) * ((error - s[RATE_E + i]) / dt - s[RATE_D + i])
        s[RATE_E + i] = error
        s[IR + i] = min(max(s[IR + i] + p[RATE_I[i]] * error * dt, -RATE_IMAX), RATE_IMAX)
        out[i] = p[RATE_P[i]] * error + s[IR + i]
        if RATE_DG[i] >= 0:
            out[i] += p[RATE_DG[i]] * s[RATE_D + i]
    return out[0], out[1], out[2]


@njit(cache=True)
def start_from_estimate(s, keep_motion):  # type: ignore[no-untyped-def]
    """Targets at the estimate; integrators and filters empty unless the vehicle flies on (`keep_motion`)."""
    for i in range(3):
        s[PD + i] = s[P + i]
        s[VD + i] = s[V + i] if keep_motion else 0.0
        s[AD + i] = 0.0
    if keep_motion:
        return
    s[PD + 2] = s[P + 2]
    roll, pitch, yaw = level(s)
    s[ATT], s[ATT + 1], s[ATT + 2] = roll, pitch, yaw
    s[IZ] = 0.0
    s[ACCEL_Z_ERROR] = 0.0
    for i in range(2):
        s[IV + i] = s[EV + i] = s[DV + i] = 0.0
    for i in range(3):
        s[ATT_RATE + i] = s[IR + i] = s[RATE_TARGET + i] = s[RATE_D + i] = 0.0
        s[RATE_E + i] = -s[RATE + i]


@njit(cache=True)
def control(s, c, p, throttle, dt):  # type: ignore[no-untyped-def]
    """One step: commands `c` and estimates in `s` to motor outputs `throttle` (4,)."""
    if c[CONTROL] != FLYING:
        idle = p[SPIN_ARM] if c[CONTROL] == IDLE else 0.0
        for i in range(4):
            throttle[i] = idle
        s[THRUST] = 0.0
        s[SPOOL] = 0.0
        s[LIMIT_LOW] = 1.0
        s[ANGLE_ERROR] = 0.0
        c[RESET] = 0.0
        start_from_estimate(s, False)
        return
    if c[RESET] > 0.0:
        c[RESET] = 0.0
        start_from_estimate(s, True)
    if s[SPOOL] < 1.0:
        # Still on the ground: rotors speed up, nothing is regulated but the attitude's starting point.
        s[SPOOL] = min(s[SPOOL] + dt / p[SPOOL_TIME], 1.0)
        start_from_estimate(s, False)
        s[IZ] = -(1.0 - LIFT_PART) * p[HOVER]
        s[THRUST] = s[SPOOL] * LIFT_PART * p[HOVER]
        mix(p, s[THRUST], 0.0, 0.0, 0.0, throttle)
        return
    an, ae = horizontal(s, c, p, dt)
    thrust = vertical(s, c, p, dt)
    w_rate, p_rate, y_rate = attitude(s, c, p, an, ae, dt)
    roll, pitch, yaw = rates(s, p, (w_rate, p_rate, y_rate), dt)
    x, y = s[Q + 1], s[Q + 2]
    lean = 1 - 2 * (x * x + y * y)
    thrust = min(thrust / max(lean, 0.5), 1.0)
    s[THRUST] = thrust
    mix(p, thrust, roll, pitch, yaw, throttle)
