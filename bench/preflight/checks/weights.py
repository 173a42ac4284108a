"""The network's weights are the ones that were trained, tested and published, byte by byte."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding

NAME = "weights"
ACTION = "restore fixtures/models from the repository"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    stack = evidence.stack
    if stack is None or not stack.weights_expected:
        why = evidence.why_not("stack") if stack is None else stack.failed or "the model's metadata could not be read"
        return [Finding("weights_wrong", None, "1", ACTION, blocked=why)]
    wrong = [precision for precision, expected in stack.weights_expected.items()
             if stack.weights_found.get(precision) != expected]
    used = (f"{stack.denoiser} runs on {stack.runs_on} {stack.weights_found.get(stack.runs_on, '')[:12]}"
            if stack.runs_on else f"{stack.denoiser} has no weights")
    return [Finding("weights_wrong", float(len(wrong)), "1", ACTION, samples=len(stack.weights_expected),
                    heard_s=stack.heard_s, seen=f"{', '.join(wrong)} differ" if wrong else used)]
