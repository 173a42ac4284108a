"""The device's clock, and whether it triggers as often as it is told."""

import itertools
from collections.abc import Callable

from bench.rig.evidence import Evidence, Finding

NAME = "timing"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    drift = evidence.drift
    clock = Finding("clock_drift_ppm", None if drift is None else drift.ppm, "ppm",
                    "the device's clock runs at another speed than the host's: its crystal, or a host that is too busy "
                    "to tell", samples=1 if drift is None else max(1, int(drift.span_s * 4)))
    periods = []
    for cycles in (evidence.loud, evidence.quiet):
        steps = [(b.t_us - a.t_us) / ((b.trigger - a.trigger) & 0xFFFFFFFF)
                 for a, b in itertools.pairwise(cycles) if b.trigger != a.trigger and b.t_us > a.t_us]
        if steps:
            periods.append(sum(steps) / len(steps))
    period_us = sum(periods) / len(periods) if periods else None
    error = None if period_us is None else (1e6 / period_us / evidence.asked_rate_hz - 1.0)
    return [clock, Finding("trigger_rate_error", error, "1", "the device triggers at another rate than it was told: "
                           "lower --rate, the sensors need about 13 ms a measurement",
                           samples=len(evidence.loud) + len(evidence.quiet))]
