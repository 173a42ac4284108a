"""Thin film under the propellers' wash: it swings as a taut membrane, and with it the mirror that it is.

Displacement of the first modes of a rectangle held at its edges, w = A sum a_mn sin(m pi x / L) sin(n pi y / H)
sin(2 pi f_mn t + phase), f_mn ~ sqrt((m/L)^2 + (n/H)^2). The wash is a jet along the floor: its speed falls with the
distance, its pressure with the square, and a film yields in proportion: A = flutter_m (thrust / hover) / distance^2.
At the foot of the sensor the film is a plane with the local displacement and slope; its curvature focuses or spreads
the echo as that of a cylinder does. What is heard: phase that turns from cycle to cycle, a bearing that wanders by the
slope, and fading. How strongly is a guess of the material (`flutter_m`); the paper only says that it was seen
("continuously fluctuating obstacle localization due to film vibrations induced by propeller downwash").
"""

import math
from zlib import crc32

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FLUTTER = 13
MODES = ((1, 1), (2, 1), (1, 2), (3, 1), (2, 2), (3, 2))
FIRST_MODE_HZ = 4.5
"""0.5 sqrt(T / m) sqrt(1/L^2 + 1/H^2): 20 N/m of tension, 0.4 kg/m2 of air that swings along, 1.3 x 1.3 m; the film's
own 0.02 kg/m2 hardly counts."""
NEAREST_M = 0.5
STRONGEST_FOCUS = 2.0
"""Most by which curvature raises the amplitude: at a focus the ray law has no bound."""


def films_of(facets: Floats) -> NDArray[np.int64]:
    """Rows that flutter."""
    return np.flatnonzero(facets[:, FLUTTER] > 0.0)


def mode_phases(row: Floats) -> Floats:
    """Phase of each mode (len(MODES),), the film's own."""
    return np.random.default_rng(crc32(row.tobytes())).uniform(0.0, 2.0 * math.pi, len(MODES))


@njit(cache=True)
def shape_at(row, u, v, t_s, phases):  # type: ignore[no-untyped-def]
    """w, dw/du, dw/dv, d2w/du2, d2w/dv2 over the amplitude at a place (u, v) of the film, in 1, 1/m and 1/m2."""
    long, high = 2.0 * row[9], 2.0 * row[10]
    x, y = u + 0.5 * long, v + 0.5 * high
    lowest = math.hypot(1.0 / long, 1.0 / high)
    w = wu = wv = wuu = wvv = 0.0
    for k in range(len(MODES)):
        m, n = MODES[k]
        ku, kv = m * math.pi / long, n * math.pi / high
        frequency = FIRST_MODE_HZ * math.hypot(m / long, n / high) / lowest
        swing = math.sin(2.0 * math.pi * frequency * t_s + phases[k]) / (m * n)
        su, cu, sv, cv = math.sin(ku * x), math.cos(ku * x), math.sin(kv * y), math.cos(kv * y)
        w += swing * su * sv
        wu += swing * ku * cu * sv
        wv += swing * kv * su * cv
        wuu -= swing * ku * ku * su * sv
        wvv -= swing * kv * kv * su * sv
    return w, wu, wv, wuu, wvv


@njit(cache=True)
def flutter(facets, still, films, phases, sensor_m, t_s, thrust_over_hover):  # type: ignore[no-untyped-def]
    """Sets the rows `films` of `facets` to how each film stands at this moment, seen from `sensor_m` (3,).

    Args:
        still: the facets as the scene has them; phases: (len(films), modes).
    """
    normal = np.empty(3)
    for f in range(films.shape[0]):
        row, out = still[films[f]], facets[films[f]]
        normal[0] = row[4] * row[8] - row[5] * row[7]
        normal[1] = row[5] * row[6] - row[3] * row[8]
        normal[2] = row[3] * row[7] - row[4] * row[6]
        height = at_u = at_v = 0.0
        for i in range(3):
            away = sensor_m[i] - row[i]
            height += away * normal[i]
            at_u += away * row[3 + i]
            at_v += away * row[6 + i]
        over_u, over_v = at_u, at_v
        at_u = min(max(at_u, -row[9]), row[9])
        at_v = min(max(at_v, -row[10]), row[10])
        distance = max(math.sqrt(height * height + (over_u - at_u) ** 2 + (over_v - at_v) ** 2), NEAREST_M)
        amplitude = row[FLUTTER] * max(thrust_over_hover, 0.0) / (distance * distance)
        w, wu, wv, wuu, wvv = shape_at(row, at_u, at_v, t_s, phases[f])
        w, wu, wv, wuu, wvv = amplitude * w, amplitude * wu, amplitude * wv, amplitude * wuu, amplitude * wvv
        long_u, lean = math.sqrt(1.0 + wu * wu), wu * wv / (1.0 + wu * wu)
        size = 0.0
        for i in range(3):
            out[3 + i] = (row[3 + i] + wu * normal[i]) / long_u
            out[6 + i] = row[6 + i] + wv * normal[i] - lean * (row[3 + i] + wu * normal[i])
            size += out[6 + i] * out[6 + i]
        size = math.sqrt(size)
        for i in range(3):
            out[6 + i] /= size
            foot = row[i] + at_u * row[3 + i] + at_v * row[6 + i]
            out[i] = foot + w * normal[i] - at_u * out[3 + i] - at_v * out[6 + i]
        # Convex towards the sensor spreads as a cylinder of that radius: 1 / sqrt(1 + distance x curvature).
        side = 1.0 if height >= 0.0 else -1.0
        spread = abs((1.0 - side * distance * wuu) * (1.0 - side * distance * wvv))
        out[11] = row[11] * min(1.0 / math.sqrt(max(spread, 1e-6)), STRONGEST_FOCUS)
