"""Reference echo R: a recording of one object that `python -m saranga synthesise` takes as a response.

The recording is the rig's own MCAP; what is checked here is what synthesis will need: one echo that stands out, where
the object stands, at a steady phase.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from bench.procedures.echo_bench import EchoBench, Place, mean_record, mean_size, range_of_sample
from bench.procedures.plan import EchoPlan
from saranga.echo import FULL_SCALE, sound_speed_m_s
from saranga.errors import DeviceError
from saranga.pulse import pulse_peak_delay_s

TEMPERATURE_C = 20.0
LEAST_OVER_MEDIAN = 5.0
"""As `saranga.synthesis.responses` asks for."""
SATURATION = 20_500.0


def capture_echo(plan: EchoPlan, bench: EchoBench, recording: Path) -> dict[str, Any]:
    """Record, and check that it can be used.

    Raises:
        DeviceError: no echo stands out, it stands elsewhere, or it saturates; the recording is kept.
    """
    cycles = bench.cycles(Place(plan.distance_m), plan.rig.frames)
    bench.close()
    row, rate_hz = mean_record(cycles, plan.rig.sensor)
    c = sound_speed_m_s(TEMPERATURE_C)
    size = np.abs(row)
    blank = len(size) // 8
    peak = blank + int(np.argmax(size[blank:]))
    loud = mean_size(cycles, plan.rig.sensor)
    over = float(loud[peak] / max(float(np.median(loud[blank:])), 1e-9))
    range_m = range_of_sample(peak, rate_hz, c) - 0.5 * c * pulse_peak_delay_s(3980.0)
    if over < LEAST_OVER_MEDIAN:
        raise DeviceError(f"no echo stands out: the strongest is {over:.1f} times the median, {LEAST_OVER_MEDIAN:g} "
                          f"are needed: propellers off, object at {plan.distance_m:g} m? The recording is kept: "
                          f"{recording}")
    if abs(range_m - plan.distance_m) > plan.tolerance_m:
        raise DeviceError(f"the strongest echo is at {range_m:.2f} m, and {plan.object!r} was to stand at "
                          f"{plan.distance_m:g} m (within {plan.tolerance_m:g}): move it, or what else reflects. The "
                          f"recording is kept: {recording}")
    frames = [x.frames[plan.rig.sensor] for x in cycles if plan.rig.sensor in x.frames]
    loudest = max(float(np.abs(f.iq[blank:].astype(np.float64)).max()) for f in frames)
    if loudest >= SATURATION:
        raise DeviceError(f"the echo saturates ({loudest:.0f} counts): move the object away. The recording is kept: "
                          f"{recording}")
    return {"object": plan.object, "recording": str(recording), "range_m": range_m, "over_median": over,
            "level_db": 20.0 * math.log10(size[peak] / FULL_SCALE), "frames": len(frames), "origin": bench.origin,
            "sensor": plan.rig.sensor, "use": "[echo] responses = [{ name = \"" + plan.object + "\", file = \""
            + str(recording) + "\" }] in a synthesis recipe"}
