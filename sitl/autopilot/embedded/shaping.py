"""Two small functions that every stage of the controller uses."""

import math

from numba import njit


@njit(cache=True)
def alpha(hz, dt):  # type: ignore[no-untyped-def]
    """Weight of a new sample in a first-order low-pass."""
    return 1.0 - math.exp(-2.0 * math.pi * hz * dt)


@njit(cache=True)
def sqrt_controller(error, p, limit, dt):  # type: ignore[no-untyped-def]
    """Proportional near zero, then the square root that decelerating at `limit` allows (AP_Math control.cpp)."""
    linear = limit / (p * p) if p > 0.0 else 1e30
    if error > linear:
        rate = math.sqrt(2.0 * limit * (error - 0.5 * linear))
    elif error < -linear:
        rate = -math.sqrt(2.0 * limit * (-error - 0.5 * linear))
    else:
        rate = error * p
    bound = abs(error) / dt
    return min(max(rate, -bound), bound)
