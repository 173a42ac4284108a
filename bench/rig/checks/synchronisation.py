"""Do the sensors record from the same trigger on? The sound that goes from one to the next tells, in every cycle.

It travels the distance between two sensors; a sensor that starts late finds it early, one that runs free finds it at
another phase each time.
"""

import math
from collections.abc import Callable

import numpy as np

from bench.rig.evidence import HEARD_OVER_NOISE, Evidence, Finding, as_complex, peak_place

NAME = "synchronisation"
WINDOW_S = 0.4e-3
"""How far from its place the direct sound is looked for."""


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    transmitter = evidence.transmitter
    if transmitter is None:
        return []
    blocked = evidence.silent()
    found = []
    for role in evidence.roles:
        if role != transmitter and role in evidence.sonar.positions_m:
            found += _against(evidence, transmitter, role, blocked)
    return [*found, _stamps(evidence)] if found else []


def _against(evidence: Evidence, transmitter: str, role: str, blocked: str) -> list[Finding]:
    cause = (f"the {role} sensor does not record from the common trigger on (desynchronised): check its trigger line "
             "(INT), and that all share one fop")
    record, noise = evidence.mean_record(role), evidence.noise_rms_counts(role)
    frames = evidence.frames(evidence.loud, role)
    if record is None or noise is None:
        blocked = blocked or f"the {role} sensor sent no records"
    if blocked or record is None or noise is None:
        return [Finding("sync_offset_us", None, "us", cause, role, blocked=blocked),
                Finding("sync_coherence", None, "1", cause, role, blocked=blocked)]
    rate = evidence.rate_hz(role)
    places = evidence.sonar.positions_m
    expected_s = math.dist(places[transmitter], places[role]) / evidence.c_m_s + evidence.pulse_delay_s(role)
    last = math.ceil((expected_s + WINDOW_S) * rate) + 1
    records = np.array([as_complex(f) for f in frames])
    # By size, not by phase: where the trigger is random the phases cancel, and the sound is still there.
    size = np.sqrt(np.mean(np.abs(records) ** 2, axis=0))
    place, height = peak_place(size, 1, last)
    if height < HEARD_OVER_NOISE * noise:
        return [Finding("sync_coherence", 0.0, "1", f"the {role} sensor does not hear the transmitter directly where "
                        f"it should: {cause}; or it is deaf", role, len(frames))]
    top = min(max(round(place), 1), records.shape[1] - 1)
    coherence = abs(np.mean(records[:, top])) / max(float(np.sqrt(np.mean(np.abs(records[:, top]) ** 2))), 1e-9)
    return [Finding("sync_offset_us", (place / rate - expected_s) * 1e6, "us", cause, role, len(frames)),
            Finding("sync_coherence", float(coherence), "1", cause, role, len(frames))]


def _stamps(evidence: Evidence) -> Finding:
    spreads = [max(f.device_time_us for f in c.frames.values()) - min(f.device_time_us for f in c.frames.values())
               for c in [*evidence.loud, *evidence.quiet] if len(c.frames) > 1]
    return Finding("sync_stamps_us", float(max(spreads)) if spreads else None, "us",
                   "frames of one trigger carry different times (desynchronised): the sensors are not triggered "
                   "together", samples=max(len(spreads), 1), blocked="" if spreads else "no two sensors sent records")
