"""Vibration and clipping with the motors still: what is left is the sensor's own, or a loose mount on a running fan."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "vibration"
LIMITS = (("vibration_m_s2", "m/s^2"), ("accelerometer_clips", "1"))
ACTION = "look for what shakes it; check the autopilot's mount and its accelerometers"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("VIBRATION")
    if not heard:
        return [Finding(name, None, unit, ACTION, blocked="it sent no VIBRATION") for name, unit in LIMITS]
    worst = max(float(h.fields[f"vibration_{axis}"]) for h in heard for axis in "xyz")
    clips = sum(float(heard[-1].fields[f"clipping_{k}"]) - float(heard[0].fields[f"clipping_{k}"]) for k in range(3))
    return [
        Finding("vibration_m_s2", worst, "m/s^2", ACTION, samples=len(heard), heard_s=heard[-1].t_s),
        Finding("accelerometer_clips", clips, "1", ACTION, samples=len(heard), heard_s=heard[-1].t_s),
    ]
