"""The stack on this computer: how long a step takes, and what is left of the 16 Hz tick."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, percentile

NAME = "stack"
LIMITS = (("stack_step_ms", "ms"), ("tick_headroom", "1"))
ACTION = "close other programs, or choose a faster --denoiser or computer"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    stack = evidence.stack
    if stack is None or stack.failed or not stack.step_ms:
        why = evidence.why_not("stack") if stack is None else stack.failed or "no step was timed"
        return [Finding(name, None, unit, ACTION, blocked=why) for name, unit in LIMITS]
    slow = percentile(stack.step_ms, 0.99)
    what = f"{stack.policy} with {stack.denoiser} on {stack.cpu}"
    return [
        Finding("stack_step_ms", percentile(stack.step_ms, 0.5), "ms", ACTION, samples=len(stack.step_ms),
                heard_s=stack.heard_s, seen=f"median; {what}"),
        Finding("tick_headroom", 1.0 - slow / stack.tick_ms, "1", ACTION, samples=len(stack.step_ms),
                heard_s=stack.heard_s, seen=f"99th percentile {slow:.1f} of {stack.tick_ms:g} ms"),
    ]
