"""The compiled inner loop of the physics: forces, contact and integration on one flat array.

The model is described in `sitl.physics`, which packs the airframe into `p` and owns the state `s`.
"""

import math

import numpy as np
from numba import njit

from sitl.airframe import GRAVITY_M_S2, MOTOR_SIGN_X, MOTOR_SIGN_Y, MOTOR_YAW_SIGN

# Places in the flat state array: rotor speeds are parts of the full one, anchors are how far each foot's
# sticking point has been stretched (x, y for four feet), charge is 0..1, ground is 1 while a foot touches.
POS, VEL, QUAT, RATES, ACCEL, ROTOR, ANCHOR, THRUST = 0, 3, 6, 10, 13, 16, 20, 28
CHARGE, VOLTAGE, CURRENT, GROUND = 32, 33, 34, 35
SIZE = 36

_SX, _SY, _YAW = np.array(MOTOR_SIGN_X), np.array(MOTOR_SIGN_Y), np.array(MOTOR_YAW_SIGN)


@njit(cache=True)
def advance(s, p, curve, throttle, scale, wind, rpm, dt_us, substep_us):  # type: ignore[no-untyped-def]
    """Advance the flat state `s` (see the places above) by `dt_us`; writes `rpm` (4,)."""
    mass, ixx, iyy, izz, arm, max_thrust, expo = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    spin_min, spin_max, idle, lag = p[7], p[8], p[9], p[10]
    torque_ratio, rotor_inertia, full_speed = p[11], p[12], p[13]
    hover_speed = p[17]
    foot_x, foot_y, foot_h, stiffness, damping, friction = p[24], p[25], p[26], p[27], p[28], p[29]
    cells, capacity, resistance, rotor_power, base_power, reference, exponent = (
        p[30], p[31], p[32], p[33], p[34], p[35], p[36])

    steps = max(1, -(-dt_us // substep_us))
    dt = dt_us * 1e-6 / steps

    # Battery: power drawn by the thrust of the last step at the loaded voltage, once a step.
    charge = s[32]
    open_voltage = cells * np.interp(charge, curve[0], curve[1])
    power = base_power
    for i in range(4):
        power += rotor_power * s[28 + i] ** 1.5
    # V I = P with V = Voc - I R: the smaller root; where the pack cannot give P, its maximum.
    root = open_voltage * open_voltage - 4.0 * resistance * power
    voltage = 0.5 * (open_voltage + math.sqrt(root)) if root > 0.0 else 0.5 * open_voltage
    current = power / voltage
    s[32] = max(charge - current * dt * steps / 3600.0 / capacity, 0.0)
    s[33] = voltage
    s[34] = current
    strength = max_thrust * (voltage / reference) ** exponent if charge > 0.0 else 0.0

    decay = math.exp(-dt / lag)
    target = np.empty(4)
    for i in range(4):
        u = throttle[i]
        if not u > 0.0:
            u = 0.0
        u = min(u, 1.0)
        x = min(max((u - spin_min) / (spin_max - spin_min), 0.0), 1.0)
        low = idle * min(u / spin_min, 1.0)
        target[i] = max(math.sqrt((1.0 - expo) * x + expo * x * x), low)

    px, py, pz = s[0], s[1], s[2]
    vx, vy, vz = s[3], s[4], s[5]
    qw, qx, qy, qz = s[6], s[7], s[8], s[9]
    wx, wy, wz = s[10], s[11], s[12]
    sum_ax, sum_ay, sum_az = 0.0, 0.0, 0.0
    touching = False

    for _ in range(steps):
        r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
        r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
        r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)

        # Rotors.
        lift, tx, ty, tz, mean_speed = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(4):
            before = s[16 + i]
            after = target[i] + (before - target[i]) * decay
            s[16 + i] = after
            thrust = strength * after * after * scale[i]
            s[28 + i] = thrust
            lift += thrust
            mean_speed += 0.25 * after * math.sqrt(max(scale[i], 0.0))
            tx -= _SY[i] * arm * thrust
            ty += _SX[i] * arm * thrust
            tz += _YAW[i] * (torque_ratio * thrust + rotor_inertia * full_speed * (after - before) / dt)

        # Air, in the body frame.
        ax, ay, az = vx - wind[0], vy - wind[1], vz - wind[2]
        bx = r00 * ax + r10 * ay + r20 * az
        by = r01 * ax + r11 * ay + r21 * az
        bz = r02 * ax + r12 * ay + r22 * az
        spin = mean_speed / hover_speed
        speed = math.sqrt(bx * bx + by * by + bz * bz)
        fx = -(p[14] * spin + p[18] * speed) * bx
        fy = -(p[15] * spin + p[19] * speed) * by
        fz = -(p[16] * spin + p[20] * speed) * bz - lift
        tx -= p[21] * wx
        ty -= p[22] * wy
        tz -= p[23] * wz
        gx = r00 * fx + r01 * fy + r02 * fz
        gy = r10 * fx + r11 * fy + r12 * fz
        gz = r20 * fx + r21 * fy + r22 * fz

        # Feet.
        touching = False
        if pz > -(foot_h + foot_x + foot_y):
            for i in range(4):
                ox, oy, oz = _SX[i] * foot_x, _SY[i] * foot_y, foot_h
                dx = r00 * ox + r01 * oy + r02 * oz
                dy = r10 * ox + r11 * oy + r12 * oz
                dz = r20 * ox + r21 * oy + r22 * oz
                depth = pz + dz
                if depth <= 0.0:
                    s[20 + 2 * i] = 0.0
                    s[21 + 2 * i] = 0.0
                    continue
                cx, cy, cz = wy * oz - wz * oy, wz * ox - wx * oz, wx * oy - wy * ox
                ux = vx + r00 * cx + r01 * cy + r02 * cz
                uy = vy + r10 * cx + r11 * cy + r12 * cz
                uz = vz + r20 * cx + r21 * cy + r22 * cz
                normal = max(stiffness * depth + damping * uz, 0.0)
                hx = s[20 + 2 * i] + ux * dt
                hy = s[21 + 2 * i] + uy * dt
                kx = -stiffness * hx - damping * ux
                ky = -stiffness * hy - damping * uy
                grip = friction * normal
                pull = math.sqrt(kx * kx + ky * ky)
                if pull > grip:
                    kx *= grip / pull
                    ky *= grip / pull
                    hx = -kx / stiffness
                    hy = -ky / stiffness
                s[20 + 2 * i] = hx
                s[21 + 2 * i] = hy
                gx += kx
                gy += ky
                gz -= normal
                # Torque about the reference point, world frame turned into the body's.
                mx, my, mz = -dy * normal - dz * ky, dz * kx + dx * normal, dx * ky - dy * kx
                tx += r00 * mx + r10 * my + r20 * mz
                ty += r01 * mx + r11 * my + r21 * mz
                tz += r02 * mx + r12 * my + r22 * mz
                touching = True

        gx /= mass
        gy /= mass
        gz /= mass
        sum_ax += gx
        sum_ay += gy
        sum_az += gz
        vx += gx * dt
        vy += gy * dt
        vz += (gz + GRAVITY_M_S2) * dt
        px += vx * dt
        py += vy * dt
        pz += vz * dt

        nx = wx + dt * (tx - (izz - iyy) * wy * wz) / ixx
        ny = wy + dt * (ty - (ixx - izz) * wz * wx) / iyy
        nz = wz + dt * (tz - (iyy - ixx) * wx * wy) / izz
        wx, wy, wz = nx, ny, nz
        angle = math.sqrt(wx * wx + wy * wy + wz * wz) * dt
        half = 0.5 * dt * (1.0 - angle * angle / 24.0) if angle < 1e-3 else math.sin(0.5 * angle) * dt / angle
        ew = math.cos(0.5 * angle)
        ex, ey, ez = wx * half, wy * half, wz * half
        tw = qw * ew - qx * ex - qy * ey - qz * ez
        tqx = qw * ex + qx * ew + qy * ez - qz * ey
        tqy = qw * ey - qx * ez + qy * ew + qz * ex
        tqz = qw * ez + qx * ey - qy * ex + qz * ew
        norm = 1.0 / math.sqrt(tw * tw + tqx * tqx + tqy * tqy + tqz * tqz)
        qw, qx, qy, qz = tw * norm, tqx * norm, tqy * norm, tqz * norm

    s[0], s[1], s[2] = px, py, pz
    s[3], s[4], s[5] = vx, vy, vz
    s[6], s[7], s[8], s[9] = qw, qx, qy, qz
    s[10], s[11], s[12] = wx, wy, wz
    fx, fy, fz = sum_ax / steps, sum_ay / steps, sum_az / steps
    s[13] = (1 - 2 * (qy * qy + qz * qz)) * fx + 2 * (qx * qy + qw * qz) * fy + 2 * (qx * qz - qw * qy) * fz
    s[14] = 2 * (qx * qy - qw * qz) * fx + (1 - 2 * (qx * qx + qz * qz)) * fy + 2 * (qy * qz + qw * qx) * fz
    s[15] = 2 * (qx * qz + qw * qy) * fx + 2 * (qy * qz - qw * qx) * fy + (1 - 2 * (qx * qx + qy * qy)) * fz
    s[35] = 1.0 if touching else 0.0
    to_rpm = full_speed * 60.0 / (2.0 * math.pi)
    for i in range(4):
        rpm[i] = s[16 + i] * to_rpm
