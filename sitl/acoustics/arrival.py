"""One echo made ready: directivity, absorption and Doppler; the row that the receiver and the provenance read."""

import math

from numba import njit

from sitl.acoustics.beam import beam_gain
from sitl.acoustics.doppler import band_loss, doppler_shift_hz, moving_delay_s
from sitl.acoustics.echoes import absorbed

ARRIVAL_COLUMNS = 8
"""delay_s, real and imaginary amplitude (p0 = 1 at 1 m, without the carrier's phase), shift_hz, path_m, kind, row,
way."""
FACET, CYLINDER, EDGE, DIRECT, SPHERE = 0.0, 1.0, 2.0, 3.0, 4.0
"""Kinds: what sent it back; `row` counts within the kind."""
STRAIGHT, DIFFUSE, BOUNCE = 0.0, 1.0, 2.0
"""Ways: mirrored or diffracted; scattered by a rough surface; mirrored and once more mirrored by a flat face."""
CLOSEST_M = 0.02
"""Distances below this count as this: the laws are far-field laws."""


@njit(cache=True)
def unit_to(origin, point, out):  # type: ignore[no-untyped-def]
    """Writes the unit vector from `origin` to `point`; returns their distance."""
    length = 0.0
    for i in range(3):
        out[i] = point[i] - origin[i]
        length += out[i] * out[i]
    length = max(math.sqrt(length), 1e-9)
    for i in range(3):
        out[i] /= length
    return length


@njit(cache=True)
def finish(out, n, amplitude, phase_re, phase_im, d1, d2, to_t, to_r, rotation, velocity, setting, grid, floor,  # type: ignore[no-untyped-def]
           kind, row, way):
    """Fills row n of `out` and returns 1, or 0 where the echo is too weak.

    Args:
        to_t, to_r: (3,) unit vectors in which the sound leaves the transmitter, and from the receiver towards where it
            comes from, world; the other arguments as `tracing.trace`.
    """
    fop, c, neper, bandwidth = setting[0], setting[1], setting[2], setting[3]
    gain = amplitude * absorbed(d1 + d2, neper)
    if abs(gain) < floor:
        return 0
    speed_t = speed_r = 0.0
    tx_x = tx_y = tx_z = rx_x = rx_y = rx_z = 0.0
    for i in range(3):
        speed_t += velocity[i] * to_t[i]
        speed_r += velocity[i] * to_r[i]
        tx_x += rotation[i, 0] * to_t[i]
        tx_y += rotation[i, 1] * to_t[i]
        tx_z += rotation[i, 2] * to_t[i]
        rx_x += rotation[i, 0] * to_r[i]
        rx_y += rotation[i, 1] * to_r[i]
        rx_z += rotation[i, 2] * to_r[i]
    gain *= beam_gain(grid, tx_x, tx_y, tx_z) * beam_gain(grid, rx_x, rx_y, rx_z)
    if abs(gain) < floor:
        return 0
    shift = doppler_shift_hz(fop, c, speed_t, speed_r)
    gain *= band_loss(shift, bandwidth)
    out[n, 0] = moving_delay_s(d1, d2, speed_r, c)
    out[n, 1] = gain * phase_re
    out[n, 2] = gain * phase_im
    out[n, 3] = shift
    out[n, 4] = d1 + d2
    out[n, 5], out[n, 6], out[n, 7] = kind, row, way
    return 1


@njit(cache=True)
def fade(out, n, share):  # type: ignore[no-untyped-def]
    """What stands in the way leaves `share` of the amplitude of row n."""
    out[n, 1] *= share
    out[n, 2] *= share
