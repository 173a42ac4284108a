"""This computer: room for the recording, and a clock that dates it."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding

NAME = "computer"
LIMITS = (("disk_free_gb", "GB"), ("clock_year", "year"))
ACTION = "free some space, or give another folder with --out"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    stack = evidence.stack
    if stack is None:
        return [Finding(name, None, unit, ACTION, blocked=evidence.why_not("stack")) for name, unit in LIMITS]
    return [
        Finding("disk_free_gb", stack.free_bytes / 1e9, "GB", ACTION, heard_s=stack.heard_s),
        Finding("clock_year", float(stack.utc_year), "year", "set this computer's clock", heard_s=stack.heard_s),
    ]
