"""The airframe as spheres fixed to the body, and their least distances while the body moves between two poses.

A sphere every few millimetres is within 2.5 mm of the true outline, even for a 20 mm pole against a propeller's
rim. Between poses the body is moved in steps in which no sphere goes further than STEP_M, so nothing is jumped
over at any speed.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sitl.solids import solid_distance

Floats = NDArray[np.float64]

STEP_M = 0.005
# Places in the memory of `sweep`: last pose, least distances so far, last speed, path length.
SEEN, POS, QUAT, OBSTACLE, NET, SPEED, PATH = 0, 1, 4, 8, 9, 10, 11
MEMORY = 12
BODY, PROPELLER = 0, 1
RIM_POINTS = 16
PROPELLER_HALF_THICKNESS_M = 0.005
ARM_HALF_THICKNESS_M = 0.006
BODY_SPHERE_M = 0.010
BODY_SPACING_M = 0.015
PROPELLER_NAMES = ("front right propeller", "rear left propeller", "front left propeller", "rear right propeller")


@dataclass(frozen=True)
class AirframeVolume:
    """What of an X quad can touch something. Metres, body FRD; defaults are the 160 mm frame's.

    Attributes:
        wheelbase_m: motor axis to motor axis across the diagonal.
        prop_diameter_m: of each propeller disc.
        prop_z_m: plane of the discs, negative above the reference point.
        body_size_m: length, width, height of the body between the arms, centred on the reference point.
    """

    wheelbase_m: float = 0.160
    prop_diameter_m: float = 0.0762
    prop_z_m: float = -0.025
    body_size_m: tuple[float, float, float] = (0.070, 0.070, 0.045)


@dataclass(frozen=True)
class Spheres:
    """The spheres of a volume: `table` (K, 4) x, y, z, radius; `part` (K,) BODY or PROPELLER; `label` (K,) names."""

    volume: AirframeVolume

    @cached_property
    def _rows(self) -> list[tuple[float, float, float, float, int, str]]:
        return [*_body_rows(self.volume), *_propeller_rows(self.volume)]

    @cached_property
    def table(self) -> Floats:
        return np.array([row[:4] for row in self._rows])

    @cached_property
    def part(self) -> NDArray[np.int64]:
        return np.array([row[4] for row in self._rows])

    @cached_property
    def label(self) -> list[str]:
        return [row[5] for row in self._rows]

    @cached_property
    def reach_m(self) -> float:
        """Furthest point of the volume from the reference point."""
        return float((np.linalg.norm(self.table[:, :3], axis=1) + self.table[:, 3]).max())


def _body_rows(volume: AirframeVolume) -> list[tuple[float, float, float, float, int, str]]:
    """Spheres under the skin of the body box, and along the four arms."""
    radius = min(BODY_SPHERE_M, *(size / 2 for size in volume.body_size_m))
    ticks = []
    for size in volume.body_size_m:
        half = size / 2 - radius
        ticks.append(np.linspace(-half, half, max(1, math.ceil(2 * half / BODY_SPACING_M)) + 1) if half > 0 else [0.0])
    last = [len(t) - 1 for t in ticks]
    rows = [(float(x), float(y), float(z), radius, BODY, "body")
            for i, x in enumerate(ticks[0]) for j, y in enumerate(ticks[1]) for k, z in enumerate(ticks[2])
            if i in (0, last[0]) or j in (0, last[1]) or k in (0, last[2])]
    arm = volume.wheelbase_m / 2
    for sx, sy in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
        for along in np.arange(0.03, arm + 0.001, 0.01):
            share = along / math.sqrt(2.0)
            rows.append((sx * share, sy * share, 0.0, ARM_HALF_THICKNESS_M, BODY, "arm"))
    return rows


def _propeller_rows(volume: AirframeVolume) -> list[tuple[float, float, float, float, int, str]]:
    """Rim, middle ring and hub of each disc, ArduCopter's motor order."""
    thick = PROPELLER_HALF_THICKNESS_M
    rim = volume.prop_diameter_m / 2 - thick
    offset = volume.wheelbase_m / 2 / math.sqrt(2.0)
    rows = []
    for name, sx, sy in zip(PROPELLER_NAMES, (1, -1, 1, -1), (1, -1, -1, 1), strict=True):
        for count, radius in ((RIM_POINTS, rim), (RIM_POINTS // 2, rim / 2), (1, 0.0)):
            for k in range(count):
                turn = 2 * math.pi * k / count
                rows.append((sx * offset + radius * math.cos(turn), sy * offset + radius * math.sin(turn),
                             volume.prop_z_m, thick, PROPELLER, name))
    return rows


def new_memory() -> Floats:
    """Nothing seen yet."""
    memory = np.zeros(MEMORY)
    memory[QUAT] = 1.0
    memory[OBSTACLE] = memory[NET] = np.inf
    return memory


@njit(cache=True)
def rotate(quat, x, y, z):  # type: ignore[no-untyped-def]
    """A body vector in world axes; quat (4,) w,x,y,z of unit length."""
    w, a, b, c = quat[0], quat[1], quat[2], quat[3]
    tx, ty, tz = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return (x + w * tx + (b * tz - c * ty), y + w * ty + (c * tx - a * tz), z + w * tz + (a * ty - b * tx))


@njit(cache=True)
def sweep(spheres, reach, solids, net, memory, pos1, quat1, dt_s):  # type: ignore[no-untyped-def]
    """Move from the pose in memory to pose 1, stopping at the first touch, and remember pose 1.

    Args:
        spheres: (K, 4) body FRD. reach: furthest of them. solids: (S, 16).
        net: (5,) x low, x high, y low, y high, z of the ceiling; infinite where there is none.
        memory: (MEMORY,), made by `new_memory`, updated in place.
        pos1 (3,), quat1 (4,): quat1 of any length but 0.
        dt_s: since the pose in memory.

    Returns:
        What was hit: (code, sphere, solid or net side, share of the way): code 0 nothing, 1 obstacle, 2 net,
        -1 the pose is not a number (memory is left alone).
    """
    norm = math.sqrt(quat1[0] ** 2 + quat1[1] ** 2 + quat1[2] ** 2 + quat1[3] ** 2)
    if not (np.isfinite(pos1[0] + pos1[1] + pos1[2]) and np.isfinite(norm) and norm > 1e-6):
        return -1, 0, 0, 0.0
    first = memory[SEEN] == 0.0
    if first:
        memory[SEEN] = 1.0
        memory[POS:POS + 3] = pos1
        memory[QUAT:QUAT + 4] = quat1 / norm
    dot = 0.0
    way = 0.0
    for k in range(4):
        dot += memory[QUAT + k] * quat1[k] / norm
    for k in range(3):
        way += (pos1[k] - memory[POS + k]) ** 2
    way = math.sqrt(way)
    sign = 1.0 if dot >= 0.0 else -1.0
    travel = way + 2.0 * math.acos(min(abs(dot), 1.0)) * reach
    steps = max(1, math.ceil(travel / STEP_M))
    memory[SPEED] = 0.0 if first else way / dt_s
    p0x, p0y, p0z = memory[POS], memory[POS + 1], memory[POS + 2]
    q0w, q0x, q0y, q0z = memory[QUAT], memory[QUAT + 1], memory[QUAT + 2], memory[QUAT + 3]
    pos, quat = memory[POS:POS + 3], memory[QUAT:QUAT + 4]
    for step in range(1, steps + 1):
        share = step / steps
        new = sign * share / norm
        old = 1.0 - share
        quat[0], quat[1] = old * q0w + new * quat1[0], old * q0x + new * quat1[1]
        quat[2], quat[3] = old * q0y + new * quat1[2], old * q0z + new * quat1[3]
        length = math.sqrt(quat[0] ** 2 + quat[1] ** 2 + quat[2] ** 2 + quat[3] ** 2)
        for k in range(4):
            quat[k] /= length
        pos[0] = old * p0x + share * pos1[0]
        pos[1] = old * p0y + share * pos1[1]
        pos[2] = old * p0z + share * pos1[2]
        code, sphere, what = _touch(spheres, reach, solids, net, memory, pos, quat)
        if code != 0:
            memory[PATH] += share * way
            return code, sphere, what, share
    memory[PATH] += way
    return 0, 0, 0, 1.0


@njit(cache=True)
def _touch(spheres, reach, solids, net, memory, pos, quat):  # type: ignore[no-untyped-def]
    """(code, sphere, solid or net side) at one pose; lowers the least distances in memory."""
    x, y, z = pos[0], pos[1], pos[2]
    for s in range(solids.shape[0]):
        # No sphere is nearer than this, so a far obstacle costs one evaluation.
        if solid_distance(solids[s], x, y, z) - reach >= max(memory[OBSTACLE], 0.0):
            continue
        for k in range(spheres.shape[0]):
            dx, dy, dz = rotate(quat, spheres[k, 0], spheres[k, 1], spheres[k, 2])
            d = solid_distance(solids[s], x + dx, y + dy, z + dz) - spheres[k, 3]
            if d < memory[OBSTACLE]:
                memory[OBSTACLE] = d
            if d <= 0.0:
                return 1, k, s
    if nearest_net(net, x, y, z)[1] - reach < max(memory[NET], 0.0):
        for k in range(spheres.shape[0]):
            dx, dy, dz = rotate(quat, spheres[k, 0], spheres[k, 1], spheres[k, 2])
            side, room = nearest_net(net, x + dx, y + dy, z + dz)
            d = room - spheres[k, 3]
            if d < memory[NET]:
                memory[NET] = d
            if d <= 0.0:
                return 2, k, side
    return 0, 0, 0


@njit(cache=True)
def nearest_net(net, x, y, z):  # type: ignore[no-untyped-def]
    """(side, distance) of the nearest net: 0 rear, 1 front, 2 left, 3 right, 4 ceiling."""
    side, best = 0, x - net[0]
    if net[1] - x < best:
        side, best = 1, net[1] - x
    if y - net[2] < best:
        side, best = 2, y - net[2]
    if net[3] - y < best:
        side, best = 3, net[3] - y
    if z - net[4] < best:
        side, best = 4, z - net[4]
    return side, best
