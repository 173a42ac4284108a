"""A reflector at a known place was set up for the rig: without it range, roles and side stay open."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding

NAME = "rig reflector"
ACTION = "put a pole 0.8 m ahead, 30 degrees to the right, or say where it is with --reflector"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    rig = evidence.rig
    if rig is None:
        return [Finding("reflector_given", None, "1", ACTION, blocked=evidence.why_not("rig"))]
    found = rig.evidence
    given = found.reflector_range_m is not None and found.reflector != "none"
    return [Finding("reflector_given", 1.0 if given else None, "1", ACTION, heard_s=rig.heard_s,
                    blocked="" if given else "--reflector none: range and sides were not checked",
                    seen=f"{found.reflector_range_m} m on the {found.reflector}" if given else "")]
