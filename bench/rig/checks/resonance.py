"""The operating frequency: as HELLO says, the same for all sensors, and at rest."""

from collections.abc import Callable

import numpy as np

from bench.rig.evidence import Evidence, Finding

NAME = "resonance"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    found, means = [], []
    for sensor in evidence.hello.sensors:
        frames = evidence.frames(evidence.loud, sensor.role) + evidence.frames(evidence.quiet, sensor.role)
        if not sensor.role or not frames:
            continue
        fop = np.array([f.fop_hz for f in frames])
        t_s = np.array([f.device_time_us for f in frames]) * 1e-6
        moving = len(fop) > 10 and t_s[-1] - t_s[0] > 1.0
        slope = float(np.polyfit(t_s - t_s[0], fop, 1)[0]) if moving else None
        means.append(float(fop.mean()))
        role = sensor.role
        found += [
            Finding("fop_drift_hz_s", slope, "Hz/s", of=role, samples=len(fop),
                    cause=f"the {role} sensor's fop is drifting: let it warm up, keep draught and sun off, check its "
                          "RTC calibration"),
            Finding("fop_offset_hz", float(fop.mean()) - sensor.fop_hz, "Hz", of=role, samples=len(fop),
                    cause=f"the {role} sensor's fop is not what it said at the start: switch the rig off and on"),
        ]
    if len(means) > 1:
        found.append(Finding("fop_spread_hz", max(means) - min(means), "Hz",
                             "the sensors work at different fop: pitch-catch needs a common one"))
    return found
