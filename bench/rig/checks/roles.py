"""Left is left: a reflector that the operator puts to one side is heard first by the sensor of that side."""

import math
from collections.abc import Callable

from bench.rig.evidence import HEARD_OVER_NOISE, Evidence, Finding, reflector_lag_s

NAME = "roles"
LEAST_SINE = 0.15
"""Nearer to straight ahead than 9 degrees the sides are not told apart."""


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    if not evidence.pair or evidence.reflector == "none":
        return []
    cause = "the left and the right sensor are swapped: exchange their plugs, or their roles in the firmware"
    blocked = evidence.silent() or _late_sensors(evidence)
    lag = None if blocked else reflector_lag_s(evidence)
    base_s = evidence.sonar.baseline_h_m / evidence.c_m_s
    if not blocked and (lag is None or lag[1] < HEARD_OVER_NOISE):
        blocked = ("no reflector is heard: put a pole 0.4 to 1.2 m ahead, 20 to 45 degrees to the "
                   f"{evidence.reflector}, or say --reflector none to leave this check out")
    sine = None
    if not blocked and lag is not None:
        sine = lag[0] / base_s * (1.0 if evidence.reflector == "right" else -1.0)
        if abs(sine) < LEAST_SINE:
            blocked = (f"the reflector is {math.degrees(math.asin(abs(sine))):.0f} degrees from straight ahead: put it "
                       f"further to the {evidence.reflector}")
        elif abs(sine) > 1.2:
            blocked = "the sensors hear the reflector further apart in time than they are apart: mend synchronisation"
    frames = len(evidence.frames(evidence.loud, "left"))
    return [Finding("reflector_side", sine, "1", cause, samples=max(frames, 1), blocked=blocked)]


def _late_sensors(evidence: Evidence) -> str:
    for role in ("left", "right"):
        if not evidence.frames(evidence.loud, role):
            return f"the {role} sensor sent no records"
    return ""
