"""A reflector at a known distance, ranged at the speed of sound of the air's temperature."""

from collections.abc import Callable

import numpy as np

from bench.rig.evidence import HEARD_OVER_NOISE, RECORD_BEGINS_S, Evidence, Finding, peak_place

NAME = "range"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    role = evidence.transmitter
    if evidence.reflector_range_m is None or role is None:
        return []
    blocked = evidence.silent()
    cause = "the reflector is ranged wrongly: check its distance, the air's temperature and fop"
    record, noise = evidence.mean_record(role), evidence.noise_rms_counts(role)
    if blocked or record is None or noise is None:
        return [Finding("reflector_range_error_m", None, "m", cause, role, blocked=blocked or "no records")]
    rate = evidence.rate_hz(role)
    place, height = peak_place(np.abs(record), int(RECORD_BEGINS_S * rate) + 1, len(record))
    frames = len(evidence.frames(evidence.loud, role))
    if height * frames**0.5 < HEARD_OVER_NOISE * noise:
        return [Finding("reflector_range_error_m", None, "m", cause, role, blocked="no reflector is heard")]
    range_m = (place / rate - evidence.pulse_delay_s(role)) * evidence.c_m_s / 2.0
    return [Finding("reflector_range_error_m", range_m - evidence.reflector_range_m, "m", cause, role, frames)]
