"""It stands level and still."""

import math
from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "attitude"
LIMITS = (("lean_deg", "deg"), ("turning_rad_s", "rad/s"))
ACTION = "put it on level ground and leave it alone; then calibrate accelerometers and level"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("ATTITUDE")
    if not heard:
        return [Finding(name, None, unit, ACTION, blocked="it sent no ATTITUDE") for name, unit in LIMITS]
    lean = max(abs(float(h.fields[axis])) for h in heard for axis in ("roll", "pitch"))
    rate = max(abs(float(h.fields[axis])) for h in heard for axis in ("rollspeed", "pitchspeed", "yawspeed"))
    return [
        Finding("lean_deg", math.degrees(lean), "deg", ACTION, samples=len(heard), heard_s=heard[-1].t_s),
        Finding("turning_rad_s", rate, "rad/s", ACTION, samples=len(heard), heard_s=heard[-1].t_s),
    ]
