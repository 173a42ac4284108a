"""The sensor's own part: pulse, gain, ring-down, noise, saturation, int16.

`record_of` does it all in one call; the rest are its parts.

The pulse is `saranga.pulse`: p(t) = exp(-(t - 2.5 s)^2 / (2 s^2)), s = 66.6 us at 3.98 kHz. An echo with delay tau
reads A p(t - tau) exp(-2j pi fop tau) and, moving, turns with its Doppler shift about its peak; sample n lies at
t = n / iq_rate. Gain: a large plane at 1 m on axis, in standard air, reads `counts_at_1m`.
"""

import math

import numpy as np
from numba import njit

WINDOW_SIGMAS = 4.0
"""Samples further from the peak are left out: 3e-4 of it."""
RING_PHASE_RAD = 0.7
INT16_MAX = 32767.0
TURN_RAD = 2.0 * math.pi / 2.0**64
"""A full turn over the numbers that are drawn."""


def gain_counts(counts_at_1m: float, absorption_db_m: float) -> float:
    """Counts for an amplitude of 1 (p0 at 1 m): a plane at 1 m is 1/2, less 2 m of absorption."""
    return counts_at_1m * 2.0 * 10.0 ** (2.0 * absorption_db_m / 20.0)


@njit(cache=True)
def add_echoes(record, arrivals, count, gain, fop_hz, iq_rate_hz, sigma_s, peak_s):  # type: ignore[no-untyped-def]
    """Add `count` rows of `arrivals` (see `tracing.py`) to `record` (n,) complex128, exact to any part of a sample."""
    q = math.exp(-1.0 / (iq_rate_hz * sigma_s) ** 2)
    for k in range(count):
        tau = arrivals[k, 0]
        peak = (tau + peak_s) * iq_rate_hz
        half = WINDOW_SIGMAS * sigma_s * iq_rate_hz
        first = max(math.ceil(peak - half), 0)
        last = min(math.floor(peak + half), record.shape[0] - 1)
        if first > last:
            continue
        x = (first - peak) / (iq_rate_hz * sigma_s)
        step = 1.0 / (iq_rate_hz * sigma_s)
        height = gain * math.exp(-0.5 * x * x)
        ratio = math.exp(-x * step - 0.5 * step * step)
        turns = fop_hz * tau
        angle = -2.0 * math.pi * (turns - math.floor(turns))
        spin = 2.0 * math.pi * arrivals[k, 3] / iq_rate_hz
        angle += spin * (first - peak)
        value = complex(arrivals[k, 1], arrivals[k, 2]) * complex(math.cos(angle), math.sin(angle))
        turn = complex(math.cos(spin), math.sin(spin))
        # exp(-x^2/2) at equal steps: each value from the last by a ratio that itself falls by q.
        for n in range(first, last + 1):
            record[n] += height * value
            height *= ratio
            ratio *= q
            value *= turn


@njit(cache=True)
def add_noise(record, row, start, rms, phase_rad):  # type: ignore[no-untyped-def]
    """Add a row of the noise bank, read around from `start`, times `rms`, turned by `phase_rad`."""
    n = record.shape[0]
    factor = rms * complex(math.cos(phase_rad), math.sin(phase_rad))
    for k in range(n):
        j = start + k
        if j >= n:
            j -= n
        record[k] += factor * row[j]


@njit(cache=True)
def add_swinging_noise(record, row, start, rms, phase_rad, swing, turn_rad, swing_phase_rad):  # type: ignore[no-untyped-def]
    """As `add_noise`, its power swinging by 1 + sum_m swing_m cos(n turn_m + phase_m): blades that pass.

    Args:
        swing: (4,) depth of each motor times its share of the power; turn_rad: (4,) a sample; swing_phase_rad: (4,).
    """
    n = record.shape[0]
    motors = swing.shape[0]
    factor = rms * complex(math.cos(phase_rad), math.sin(phase_rad))
    hand = np.empty(motors, np.complex128)
    step = np.empty(motors, np.complex128)
    for m in range(motors):
        hand[m] = swing[m] * complex(math.cos(swing_phase_rad[m]), math.sin(swing_phase_rad[m]))
        step[m] = complex(math.cos(turn_rad[m]), math.sin(turn_rad[m]))
    for k in range(n):
        power = 1.0
        for m in range(motors):
            power += hand[m].real
            hand[m] *= step[m]
        j = start + k
        if j >= n:
            j -= n
        record[k] += factor * math.sqrt(max(power, 0.0)) * row[j]


@njit(cache=True)
def add_ring_down(record, floor_counts, ring_down_samples, iq_rate_hz, bandwidth_hz):  # type: ignore[no-untyped-def]
    """The transmitter ringing out: a resonator of bandwidth B decays as exp(-pi B t), here so that it meets the
    quiet floor at `ring_down_samples`."""
    decay = math.pi * bandwidth_hz / iq_rate_hz
    turn = complex(math.cos(RING_PHASE_RAD), math.sin(RING_PHASE_RAD))
    for n in range(record.shape[0]):
        height = floor_counts * math.exp(min(decay * (ring_down_samples - n), 60.0))
        if height < 0.01 * floor_counts:
            break
        record[n] += height * turn


@njit(cache=True)
def digitise(record, saturation_counts, out):  # type: ignore[no-untyped-def]
    """|IQ| limited to the saturation with its phase kept, rounded to int16 pairs, **Q first**; sample 0 reads 0."""
    limit = min(saturation_counts, INT16_MAX)
    for n in range(record.shape[0]):
        re, im = record[n].real, record[n].imag
        size = math.sqrt(re * re + im * im)
        if size > limit:
            re *= limit / size
            im *= limit / size
        out[n, 0] = np.int16(round(im))
        out[n, 1] = np.int16(round(re))
    out[0, 0] = 0
    out[0, 1] = 0


RECEIVER_FIELDS = ("gain_counts", "fop_hz", "iq_rate_hz", "sigma_s", "peak_s", "quiet_floor_counts",
                   "ring_down_samples", "bandwidth_hz", "saturation_counts", "blade_pass_modulation")
"""Of the array `record_of` takes."""


@njit(cache=True)
def record_of(arrivals, count, rings, receiver, bank, draws, first, power, turn_rad, swing_phase_rad, record, out):  # type: ignore[no-untyped-def]
    """One sensor's record of a cycle.

    Args:
        arrivals, count: what is heard (see `add_echoes`); rings: whether this sensor transmits.
        receiver: see RECEIVER_FIELDS.
        bank: (rows, n) complex64; draws: uint64, of which `first` and the next two choose row, start and phase.
        power: (4,) mean |IQ|^2 of each motor's noise; turn_rad, swing_phase_rad: see `add_swinging_noise`.
        record: (n,) complex128, overwritten; out: (n, 2) int16.
    """
    gain, fop_hz, iq_rate_hz, sigma_s, peak_s, floor, ring_down_samples, bandwidth_hz, saturation, modulation = receiver
    record[:] = 0.0
    if count > 0:
        add_echoes(record, arrivals, count, gain, fop_hz, iq_rate_hz, sigma_s, peak_s)
    if rings:
        add_ring_down(record, floor, ring_down_samples, iq_rate_hz, bandwidth_hz)
    whole = 0.0
    for m in range(power.shape[0]):
        whole += power[m]
    whole += floor * floor
    swing = power * (modulation / max(whole, 1e-9))
    row = bank[draws[first] % np.uint64(bank.shape[0])]
    start = np.int64(draws[first + 1] % np.uint64(record.shape[0]))
    phase_rad = np.float64(draws[first + 2]) * TURN_RAD
    add_swinging_noise(record, row, start, math.sqrt(whole), phase_rad, swing, turn_rad, swing_phase_rad)
    digitise(record, saturation, out)
