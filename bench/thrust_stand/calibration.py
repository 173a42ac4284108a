"""From what a load cell says to thrust: sign, scale and tare; and the check that thrust has the right sign."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.thrust_stand.protocol import StandReading
from saranga.errors import DeviceError

TARE_READINGS = 25
TARE_TIMEOUT_S = 5.0
TARE_SPREAD_N = 0.05
STILL_RPM = 100.0
SPINNING_RPM = 1_000.0
SIGN_MARGIN_N = 0.05

Read = Callable[[float], list[StandReading]]


class Calibration:
    """thrust = sign * scale * raw - offset.

    Args:
        thrust_scale: above 0; 1 where the device is calibrated itself.
        thrust_sign: -1 for a load cell, or a propeller, mounted the other way round.

    Raises:
        ValueError: a scale that is not above 0, or another sign.
    """

    def __init__(self, thrust_scale: float = 1.0, thrust_sign: int = 1) -> None:
        if not isinstance(thrust_scale, int | float) or not (math.isfinite(thrust_scale) and thrust_scale > 0.0):
            raise ValueError(f"thrust_scale is {thrust_scale!r}: it must be above 0, or limits on thrust would never "
                             "trip; for a load cell mounted the other way round use thrust_sign=-1")
        if thrust_sign not in (1, -1):
            raise ValueError(f"thrust_sign is {thrust_sign!r}: it must be 1 or -1")
        self._factor = float(thrust_scale) * thrust_sign
        self.offset_n = 0.0

    def __call__(self, raw_n: float) -> float:
        """Thrust, NaN for anything that is not finite."""
        return self._factor * raw_n - self.offset_n if math.isfinite(raw_n) else math.nan

    def tare(self, url: str, read: Read) -> float:
        """Take the mean of the next readings as zero; returns the offset now taken off, N.

        Raises:
            DeviceError: too few readings, thrust is NaN, the motor turns, or the load cell is not at rest.
        """
        taken = _collect(url, read)
        for reading in taken:
            if reading.rpm > STILL_RPM or reading.throttle > 0.0:
                raise DeviceError(f"{url}: cannot tare while the motor turns ({reading.rpm:g} rpm, throttle "
                                  f"{reading.throttle:g}): stop it first")
            if not math.isfinite(reading.thrust_n):
                raise DeviceError(f"{url}: cannot tare: thrust is {reading.thrust_n:g}: check the load cell and its "
                                  "amplifier")
        values = np.array([reading.thrust_n for reading in taken])
        if values.std() > TARE_SPREAD_N:
            raise DeviceError(f"{url}: cannot tare: thrust spreads by {values.std():.3f} N, at rest at most "
                              f"{TARE_SPREAD_N:g} N: wait until the stand is still, and check the wiring")
        self.offset_n += float(values.mean())
        return self.offset_n

    def shifted(self, reading: StandReading, by_n: float) -> StandReading:
        """A reading made before a tare of `by_n`, as it would read after it."""
        return replace(reading, thrust_n=reading.thrust_n - by_n)


def _collect(url: str, read: Read) -> list[StandReading]:
    read(0.0)  # what came before the request
    end_s = time.monotonic() + TARE_TIMEOUT_S
    taken: list[StandReading] = []
    while len(taken) < TARE_READINGS:
        left_s = end_s - time.monotonic()
        if left_s <= 0.0:
            raise DeviceError(f"{url}: cannot tare: {len(taken)} readings in {TARE_TIMEOUT_S:g} s, {TARE_READINGS} are "
                              "needed: check that the stand streams")
        taken += read(min(left_s, 0.5))
    return taken


def negative_thrust(readings: list[StandReading]) -> str | None:
    """What is wrong with the thrust's sign, None where nothing is: a propeller at speed pulls."""
    fast = [r.thrust_n for r in readings if r.rpm > SPINNING_RPM and math.isfinite(r.thrust_n)]
    if not fast or float(np.median(fast)) >= -SIGN_MARGIN_N:
        return None
    return (f"thrust is {float(np.median(fast)):.3f} N while the propeller turns: its calibration is negative, or load "
            "cell or propeller are mounted the other way round; correct it, or say thrust_sign=-1")
