"""The vehicle's clock: it goes forward, at the pace of this computer's, without jumps."""

import itertools
from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "clock"
LIMITS = (("clock_rate_error", "1"), ("clock_jump_s", "s"), ("vehicle_up_s", "s"))
ACTION = "power the vehicle up anew; a vehicle whose clock jumps must not fly"
SIMULATED = "clock_rate_error_simulated"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("SYSTEM_TIME")
    if len(heard) < 5:
        return [Finding(name, None, unit, ACTION, blocked=f"only {len(heard)} SYSTEM_TIME came")
                for name, unit in LIMITS]
    boot = [float(h.fields["time_boot_ms"]) * 1e-3 for h in heard]
    host_s = heard[-1].t_s - heard[0].t_s
    steps = [b - a for a, b in itertools.pairwise(boot)]
    gaps = [b.t_s - a.t_s for a, b in itertools.pairwise(heard)]
    jump = max(max(step - gap for step, gap in zip(steps, gaps, strict=True)), -min(min(steps), 0.0))
    name = "clock_rate_error" if vehicle.origin == "measured" else SIMULATED
    return [
        Finding(name, (boot[-1] - boot[0]) / host_s - 1.0 if host_s > 0 else None, "1", ACTION, samples=len(heard),
                heard_s=heard[-1].t_s, seen="against this computer's"),
        Finding("clock_jump_s", jump, "s", ACTION, samples=len(heard), heard_s=heard[-1].t_s),
        Finding("vehicle_up_s", boot[-1], "s", "wait: gyros and estimate settle after power-up", heard_s=heard[-1].t_s),
    ]
