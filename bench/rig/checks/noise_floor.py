"""Each sensor's own noise, nothing transmitted and no propeller turning."""

from collections.abc import Callable

from bench.rig.evidence import Evidence, Finding

NAME = "noise floor"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    return [Finding("noise_floor_counts", evidence.noise_rms_counts(role), "counts", of=role,
                    blocked="" if evidence.frames(evidence.quiet, role) else f"the {role} sensor sent no records",
                    samples=len(evidence.frames(evidence.quiet, role)),
                    cause=f"the {role} sensor is too loud (something sounds, or its supply is noisy) or too quiet "
                          "(deaf): try it in a silent room, then with another cable")
            for role in evidence.roles]
