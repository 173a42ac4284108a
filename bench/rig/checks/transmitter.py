"""Is the transmitter alive, and does it ring as one with a horn does?

A resonator of bandwidth B rings out as exp(-pi B t); the horn loads it. Without the horn it rings longer.
"""

import math
from collections.abc import Callable

import numpy as np

from bench.rig.evidence import Evidence, Finding

NAME = "transmitter"
FLOOR_FACTOR = 4.0
FIT_BELOW_COUNTS = 12_000.0
FIT_OVER_FLOOR = 6.0


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    role = evidence.transmitter
    if role is None:
        return [Finding("transmit_counts", None, "counts", "no sensor of HELLO transmits: check the firmware's roles")]
    blocked = evidence.silent()
    alive = evidence.alive_counts()
    length_s, ratio = (None, None) if blocked else _ring_down(evidence, role)
    horn = "its horn is missing, loose or another one (ring-down changed), or water is in it"
    return [
        Finding("transmit_counts", alive, "counts", of=role, samples=len(evidence.frames(evidence.loud, role)),
                blocked=blocked if alive is None else "",
                cause=f"the transmitter ({role}) makes no sound (dead): check its supply and its transmit setting"),
        Finding("ring_down_ms", None if length_s is None else length_s * 1e3, "ms", of=role, blocked=blocked,
                cause=f"the {role} sensor rings too long or too short: {horn}"),
        Finding("ring_down_ratio", ratio, "1", of=role, blocked=blocked,
                cause=f"the {role} sensor's ring-down dies away at another rate than its bandwidth says: {horn}"),
    ]


def _ring_down(evidence: Evidence, role: str) -> tuple[float | None, float | None]:
    """(seconds until it meets four times the floor, measured over expected time constant)."""
    record = evidence.mean_record(role)
    noise = evidence.noise_rms_counts(role)
    if record is None or not noise:
        return None, None
    envelope = np.abs(record)
    rate = evidence.rate_hz(role)
    below = np.flatnonzero(envelope[1:] < FLOOR_FACTOR * noise)
    if not len(below):
        return None, None
    end = 1 + int(below[0])
    fit = [n for n in range(1, end) if FIT_OVER_FLOOR * noise < envelope[n] < FIT_BELOW_COUNTS]
    if len(fit) < 3:
        return end / rate, None
    slope = float(np.polyfit(np.array(fit) / rate, np.log(envelope[fit]), 1)[0])
    bandwidth_hz = next(s.bandwidth_hz for s in evidence.hello.sensors if s.role == role)
    return end / rate, -math.pi * bandwidth_hz / slope if slope < 0.0 else None
