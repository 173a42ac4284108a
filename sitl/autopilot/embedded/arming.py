"""Whether the vehicle may arm, and why not, in the words ArduCopter uses where it has the check."""

import math

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.vehicle import (
    ALT_HOLD,
    CRITICAL,
    GUIDED,
    INFO,
    LOITER,
    MODE_NAMES,
    STABILIZE,
    Vehicle,
)

ARMABLE = (STABILIZE, ALT_HOLD, GUIDED, LOITER)
NEEDS_POSITION = (GUIDED, LOITER)
MAX_LEAN_RAD = math.radians(20.0)
MAX_RATE_RAD_S = 0.2


def prearm_problems(vehicle: Vehicle) -> list[str]:
    """Reasons not to arm in the present mode, most basic first; empty when ready."""
    parameters = vehicle.parameters
    problems = []
    if not vehicle.gyros_ready:
        problems.append("Gyros not calibrated")
    if not vehicle.estimator_ready:
        problems.append("AHRS: not healthy")
    elif vehicle.origin is None:
        problems.append("AHRS: waiting for home")
    if parameters["ARMING_CHECK"] > 0:
        age = float(vehicle.estimate[at.RANGE_AGE])
        if parameters["RNGFND1_TYPE"] > 0 and age > 0.5:
            problems.append("Rangefinder 1: No Data")
        if parameters["FLOW_TYPE"] > 0 and not vehicle.flow_fresh:
            problems.append("Optical flow: not healthy")
        least = parameters["BATT_ARM_VOLT"]
        if vehicle.voltage_v < least:
            problems.append(f"Battery 1 at {vehicle.voltage_v:.1f} V, needs {least:.1f} V")
        if any(abs(rate) > MAX_RATE_RAD_S for rate in vehicle.rates_rad_s):
            problems.append("Gyros moving")
    roll, pitch, _ = vehicle.attitude_rad
    if max(abs(roll), abs(pitch)) > MAX_LEAN_RAD:
        problems.append("Leaning")
    if vehicle.mode in NEEDS_POSITION and not vehicle.aided:
        problems.append("Need Position Estimate")
    if vehicle.failsafe:
        problems.append(f"{vehicle.failsafe} failsafe on")
    return problems


def arm(vehicle: Vehicle, forced: bool) -> str | None:
    """Arm; returns the reason why not, or None. Forcing skips the checks but not the mode's."""
    if vehicle.armed:
        return None
    if vehicle.mode not in ARMABLE:
        return f"Arm: {MODE_NAMES[vehicle.mode]} mode not armable"
    problems = prearm_problems(vehicle)
    if problems and not forced:
        return f"PreArm: {problems[0]}"
    if not vehicle.estimator_ready:
        return "PreArm: AHRS: not healthy"
    vehicle.armed = True
    vehicle.landed = True
    vehicle.home_height_m = vehicle.height_m
    vehicle.say(INFO, "Arming motors")
    return None


def disarm(vehicle: Vehicle, forced: bool) -> str | None:
    """Stop the motors; returns the reason why not, or None. In the air only by force."""
    if not vehicle.armed:
        return None
    if not vehicle.landed and not forced:
        return "Disarm: in the air (land first, or force it)"
    vehicle.armed = False
    vehicle.landed = True
    vehicle.landing = vehicle.taking_off = False
    vehicle.command[at.CONTROL] = at.STOPPED
    vehicle.say(CRITICAL if forced else INFO, "Disarming motors")
    return None
