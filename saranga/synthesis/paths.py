"""Geometry and strength of echoes: how the vehicle moves, how long the way of the sound is, how much comes back.

The suite's centre (middle of left and right sensor) at the newest cycle is the origin; axes are body FRD, and the
heading is fixed, so obstacles only shift as the vehicle moves. Amplitudes are over the source's at 1 m
(acoustics.md, "Echo amplitude"), bistatic by path lengths.
"""

import math

from numba import njit

PLANE, CYLINDER, EDGE, POINT, IDEAL = 0, 1, 2, 3, 4
KINDS = ("plane", "cylinder", "edge", "point", "ideal")
"""Reflectors: a large flat mirror across the line of sight, an upright pole, a hard edge (Keller), a small sphere,
and the paper's own, a spike of strength 1 at any range."""
HOVER, STRAIGHT, ARC, COSINE = 0, 1, 2, 3
PATHS = ("hover", "straight", "arc", "cosine")


@njit(cache=True)
def arc_displacement(distance, heading, curvature):  # type: ignore[no-untyped-def]
    """(x, y) after `distance` metres along a circular arc that starts at `heading`; curvature 1/rho, 0 is straight.

    A negative distance is where the vehicle came from. Exact form of paper eqs 2-3.
    """
    turn = curvature * distance
    if abs(turn) < 1e-6:
        return distance * math.cos(heading + 0.5 * turn), distance * math.sin(heading + 0.5 * turn)
    return ((math.sin(heading + turn) - math.sin(heading)) / curvature,
            (math.cos(heading) - math.cos(heading + turn)) / curvature)


@njit(cache=True)
def point_legs(x, y, z, tx, rx):  # type: ignore[no-untyped-def]
    """Distances transmitter - point and point - receiver."""
    return (math.sqrt((x - tx[0]) ** 2 + (y - tx[1]) ** 2 + (z - tx[2]) ** 2),
            math.sqrt((x - rx[0]) ** 2 + (y - rx[1]) ** 2 + (z - rx[2]) ** 2))


@njit(cache=True)
def plane_legs(nx, ny, distance, tx, rx):  # type: ignore[no-untyped-def]
    """Half the way each, transmitter - upright mirror - receiver: to the transmitter's image.

    The mirror is `distance` from the origin along its normal (nx, ny, 0).
    """
    shift = 2.0 * (distance - nx * tx[0] - ny * tx[1])
    if shift <= 0.0:
        return 0.0, 0.0
    dx, dy, dz = tx[0] + shift * nx - rx[0], tx[1] + shift * ny - rx[1], tx[2] - rx[2]
    half = 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)
    return half, half


@njit(cache=True)
def cylinder_legs(cx, cy, radius, tx, rx):  # type: ignore[no-untyped-def]
    """Distances to and from an upright pole with its axis at (cx, cy).

    The mirror point is taken on the bisector of the directions to both sensors. Exact where both are equally far;
    else the path is long by less than 20 um (b = 0.1 m, 0.2 m away, 60 degrees aside), as it is the shortest one.
    """
    ax, ay, bx, by = tx[0] - cx, tx[1] - cy, rx[0] - cx, rx[1] - cy
    da, db = math.hypot(ax, ay), math.hypot(bx, by)
    if da <= radius or db <= radius:
        return 0.0, 0.0
    ux, uy = ax / da + bx / db, ay / da + by / db
    norm = math.hypot(ux, uy)
    px, py = cx + radius * ux / norm, cy + radius * uy / norm
    out, back = math.hypot(tx[0] - px, tx[1] - py), math.hypot(rx[0] - px, rx[1] - py)
    rise = (tx[2] - rx[2]) / (out + back)
    stretch = math.sqrt(1.0 + rise * rise)
    return out * stretch, back * stretch


@njit(cache=True)
def strength(kind, out, back, size, wavenumber):  # type: ignore[no-untyped-def]
    """Amplitude over the source's at 1 m, without absorption, beam and reflectivity.

    `size` is the radius of a cylinder or sphere, and Keller's |1 + sec phi| of an edge.
    """
    if kind == PLANE:
        return 1.0 / (out + back)
    if kind == CYLINDER:
        return math.sqrt(size / (size * (out + back) + 2.0 * out * back) / (out + back))
    if kind == EDGE:
        return 0.5 * size / math.sqrt(2.0 * math.pi * wavenumber) / math.sqrt(out * back * (out + back))
    if kind == POINT:
        return size / (2.0 * out * back + size * (out + back))
    return 1.0


@njit(cache=True)
def piston(sine_h, sine_v, reach_h, reach_v):  # type: ignore[no-untyped-def]
    """One-way amplitude of a baffled elliptical piston, 2 J1(v)/v by its series, to 1e-3 at v < 4; reach is k a."""
    u = 0.25 * ((reach_h * sine_h) ** 2 + (reach_v * sine_v) ** 2)
    return 1.0 + u * (-1 / 2 + u * (1 / 12 + u * (-1 / 144 + u * (1 / 2880 + u * (-1 / 86400 + u / 3628800)))))


@njit(cache=True)
def beam(x, y, z, sensor, reach_h, reach_v):  # type: ignore[no-untyped-def]
    """Piston's amplitude from a sensor towards a point; nothing behind the mouth of the horn."""
    dx, dy, dz = x - sensor[0], y - sensor[1], z - sensor[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    if dx <= 0.0 or r == 0.0:
        return 0.0
    return max(piston(dy / r, dz / r, reach_h, reach_v), 0.0)
