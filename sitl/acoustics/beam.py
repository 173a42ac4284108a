"""Directivity of a sensor with its horn: baffled elliptical piston, 2 J1(v) / v with
v = k sqrt((a_h sin az)^2 + (a_v sin el)^2) (acoustics.md, "Directivity").

sin az and sin el are the direction cosines along body y and z. It is kept as a grid over them, so that a measured
pattern can take the piston's place.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import j1

GRID = 129
"""Nodes along each direction cosine, -1 to 1; the linear interpolation errs by less than 1e-3."""
BEHIND_RAD = 0.2
"""Behind the plane of the horn's mouth the amplitude falls as exp(-(angle / 0.2 rad)^2): an assumption, a piston in
a baffle says nothing there."""


def piston_gain(sine_h: NDArray[np.float64] | float, sine_v: NDArray[np.float64] | float, wavenumber_rad_m: float,
                a_h_m: float, a_v_m: float) -> NDArray[np.float64]:
    """One-way amplitude towards direction cosines along body y and z; 1 on axis, negative in odd side lobes."""
    v = wavenumber_rad_m * np.hypot(a_h_m * np.asarray(sine_h), a_v_m * np.asarray(sine_v))
    safe = np.maximum(v, 1e-9)
    return np.where(v < 1e-6, 1.0, 2.0 * j1(safe) / safe)


def piston_grid(wavenumber_rad_m: float, a_h_m: float, a_v_m: float) -> NDArray[np.float64]:
    """The piston on the grid, (GRID, GRID): first index along body y, second along body z."""
    node = np.linspace(-1.0, 1.0, GRID)
    return np.ascontiguousarray(piston_gain(node[:, None], node[None, :], wavenumber_rad_m, a_h_m, a_v_m))


@njit(cache=True)
def beam_gain(grid, x, y, z):  # type: ignore[no-untyped-def]
    """One-way amplitude towards the unit vector (x, y, z) in body FRD, boresight along x; bilinear on the grid."""
    half = 0.5 * (GRID - 1)
    p = min(max((y + 1.0) * half, 0.0), GRID - 1.000001)
    q = min(max((z + 1.0) * half, 0.0), GRID - 1.000001)
    i, j = int(p), int(q)
    p -= i
    q -= j
    gain = ((1.0 - p) * ((1.0 - q) * grid[i, j] + q * grid[i, j + 1])
            + p * ((1.0 - q) * grid[i + 1, j] + q * grid[i + 1, j + 1]))
    if x < 0.0:
        behind = np.arcsin(min(-x, 1.0)) / BEHIND_RAD
        gain *= np.exp(-behind * behind)
    return gain
