"""Where an echo comes from: mirror points of facets, cylinders, spheres and edges for one transmitter and receiver."""

import math

from numba import njit

NEWTON_STEPS = 8
NEAREST_M = 0.005
"""A sensor nearer to a surface than this, or behind it, hears no mirror."""
WIDEST_TURN_RAD = 2.5
"""Transmitter and receiver on opposite sides of a cylinder have no mirror point between them."""


@njit(cache=True)
def facet_point(row, tx, rx, point):  # type: ignore[no-untyped-def]
    """Image source. Writes the mirror point (3,); returns d1, d2, its coordinates along u and v.

    d1 is 0 where the plane passes between the two, or touches one of them.
    """
    n0 = row[4] * row[8] - row[5] * row[7]
    n1 = row[5] * row[6] - row[3] * row[8]
    n2 = row[3] * row[7] - row[4] * row[6]
    height_t = (tx[0] - row[0]) * n0 + (tx[1] - row[1]) * n1 + (tx[2] - row[2]) * n2
    height_r = (rx[0] - row[0]) * n0 + (rx[1] - row[1]) * n1 + (rx[2] - row[2]) * n2
    if height_t * height_r <= NEAREST_M * NEAREST_M:
        return 0.0, 0.0, 0.0, 0.0
    share = height_t / (height_t + height_r)
    u = v = length = 0.0
    for i in range(3):
        n = n0 if i == 0 else (n1 if i == 1 else n2)
        step = rx[i] - 2.0 * height_r * n - tx[i]
        length += step * step
        point[i] = tx[i] + share * step
        u += (point[i] - row[i]) * row[3 + i]
        v += (point[i] - row[i]) * row[6 + i]
    length = math.sqrt(length)
    return share * length, (1.0 - share) * length, u, v


@njit(cache=True)
def mirror_angle(rho_t, rho_r, turn, radius):  # type: ignore[no-untyped-def]
    """Angle from the transmitter's side, 0 to `turn`, at which a circle mirrors: the shortest path (Newton)."""
    near, far = rho_t - radius, rho_r - radius
    angle = turn * near / (near + far)
    for _ in range(NEWTON_STEPS):
        slope = bend = 0.0
        for k in range(2):
            rho = rho_t if k == 0 else rho_r
            phi = angle if k == 0 else angle - turn
            length = math.sqrt(rho * rho + radius * radius - 2.0 * rho * radius * math.cos(phi))
            rise = rho * radius * math.sin(phi)
            slope += rise / length
            bend += (rho * radius * math.cos(phi) - rise * rise / (length * length)) / length
        if bend <= 0.0:
            break
        step = slope / bend
        angle -= step
        if abs(step) < 1e-10:
            break
    return min(max(angle, min(0.0, turn)), max(0.0, turn))


@njit(cache=True)
def cylinder_point(a, w, radius, tx, rx, point):  # type: ignore[no-untyped-def]
    """Shortest path over a cylinder of axis point `a` and unit direction `w`.

    Across the axis the circle's mirror point, along it the point that divides the way as the unrolled straight line
    does. Writes the point (3,); returns d1, d2, the coordinate along the axis from `a`, and the cosine of incidence in
    the plane across the axis (the axial part is small for sensors a hand apart). d1 is 0 where there is none. A
    radius of 0 is the line itself: where an edge diffracts.
    """
    z_t = z_r = 0.0
    for i in range(3):
        z_t += (tx[i] - a[i]) * w[i]
        z_r += (rx[i] - a[i]) * w[i]
    rho_t = rho_r = along = 0.0
    for i in range(3):
        t = tx[i] - a[i] - z_t * w[i]
        r = rx[i] - a[i] - z_r * w[i]
        rho_t += t * t
        rho_r += r * r
        along += t * r
    rho_t, rho_r = math.sqrt(rho_t), math.sqrt(rho_r)
    if min(rho_t, rho_r) <= radius + NEAREST_M:
        return 0.0, 0.0, 0.0, 0.0
    along /= rho_t
    side = math.sqrt(max(rho_r * rho_r - along * along, 0.0))
    angle = 0.0
    if side > 1e-7 and radius > 0.0:
        turn = math.atan2(side, along)
        if turn > WIDEST_TURN_RAD:
            return 0.0, 0.0, 0.0, 0.0
        angle = mirror_angle(rho_t, rho_r, turn, radius)
        side = 1.0 / side
    else:
        side = 0.0
    c, s = radius * math.cos(angle), radius * math.sin(angle) * side
    flat_1 = flat_2 = 0.0
    for i in range(3):
        t = tx[i] - a[i] - z_t * w[i]
        r = rx[i] - a[i] - z_r * w[i]
        foot = c * t / rho_t + s * (r - along * t / rho_t)
        point[i] = foot
        flat_1 += (t - foot) * (t - foot)
        flat_2 += (r - foot) * (r - foot)
    flat_1, flat_2 = math.sqrt(flat_1), math.sqrt(flat_2)
    z = z_t + (z_r - z_t) * flat_1 / (flat_1 + flat_2)
    for i in range(3):
        point[i] += a[i] + z * w[i]
    d1 = math.sqrt(flat_1 * flat_1 + (z - z_t) ** 2)
    d2 = math.sqrt(flat_2 * flat_2 + (z - z_r) ** 2)
    cosine = (rho_t * math.cos(angle) - radius) / flat_1
    return d1, d2, z, max(cosine, 0.0)


@njit(cache=True)
def sphere_point(row, tx, rx, point):  # type: ignore[no-untyped-def]
    """Mirror point of a sphere (centre (3), radius): that of the circle in the plane of both sensors and the centre.

    Writes the point (3,); returns d1, d2 and the cosine of incidence. d1 is 0 where there is none.
    """
    radius = row[3]
    rho_t = rho_r = along = 0.0
    for i in range(3):
        t, r = tx[i] - row[i], rx[i] - row[i]
        rho_t += t * t
        rho_r += r * r
        along += t * r
    rho_t, rho_r = math.sqrt(rho_t), math.sqrt(rho_r)
    if min(rho_t, rho_r) <= radius + NEAREST_M:
        return 0.0, 0.0, 0.0
    along /= rho_t
    side = math.sqrt(max(rho_r * rho_r - along * along, 0.0))
    angle, per_side = 0.0, 0.0
    if side > 1e-7:
        turn = math.atan2(side, along)
        if turn > WIDEST_TURN_RAD:
            return 0.0, 0.0, 0.0
        angle = mirror_angle(rho_t, rho_r, turn, radius)
        per_side = 1.0 / side
    c, s = radius * math.cos(angle), radius * math.sin(angle) * per_side
    d1 = d2 = 0.0
    for i in range(3):
        t, r = tx[i] - row[i], rx[i] - row[i]
        foot = c * t / rho_t + s * (r - along * t / rho_t)
        point[i] = row[i] + foot
        d1 += (t - foot) * (t - foot)
        d2 += (r - foot) * (r - foot)
    d1, d2 = math.sqrt(d1), math.sqrt(d2)
    return d1, d2, max((rho_t * math.cos(angle) - radius) / d1, 0.0)
