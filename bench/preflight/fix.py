"""`--fix-parameters`: show the difference, ask, write, read back. Never on an armed vehicle."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from bench.preflight.collect import Conversation
from bench.preflight.guard import GuardedLink
from bench.preflight.parameter_difference import TOLERANCE, Difference, difference
from saranga.errors import UsageError
from sitl.autopilot.parameters import Parameter

WORD = "WRITE"
Ask = Callable[[str], str]


@dataclass
class Fixed:
    """What was written and reads back right, what did not, and whether the operator agreed."""

    agreed: bool = False
    written: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)


def ask_on_terminal(prompt: str) -> str:
    """The operator's answer; the prompt goes to standard error.

    Raises:
        UsageError: nobody can answer.
    """
    print(prompt, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line:
        raise UsageError("--fix-parameters needs somebody who confirms: run it in a terminal")
    return line.strip()


def fix_parameters(conversation: Conversation, link: GuardedLink, wanted: Sequence[Parameter],
                   ask: Ask = ask_on_terminal) -> Fixed:
    """Write what differs, after a typed confirmation; the evidence then has what was read back.

    Raises:
        UsageError: nobody can confirm. DeviceError: the link was lost.
    """
    evidence, out = conversation.evidence, Fixed()
    found = difference(evidence, wanted).different
    if not found or evidence.stopped:
        return out
    lines = [f"  {d.name:<16} {d.found:g} -> {d.wanted:g}   {d.why}" for d in found]
    print("\n".join(["Parameters that differ:", *lines]), file=sys.stderr)
    out.agreed = ask(f"Type {WORD} to set these {len(found)} on the vehicle, anything else to leave it alone: ") == WORD
    if not out.agreed:
        return out
    conversation.pump(1.2)  # a fresh heartbeat: it may have been armed while we waited for the answer
    link.parameters_open = True
    try:
        for change in found:
            if evidence.stopped:
                out.failed.append(f"{change.name}: {evidence.stopped}")
                continue
            _set(conversation, change, out)
    finally:
        link.parameters_open = False
    return out


def _set(conversation: Conversation, change: Difference, out: Fixed) -> None:
    got = conversation.set_parameter(change.name, change.wanted)
    if got is not None and abs(got - change.wanted) <= TOLERANCE * max(1.0, abs(change.wanted)):
        out.written.append(f"{change.name} {change.found:g} -> {got:g}")
    else:
        out.failed.append(f"{change.name}: reads {'nothing' if got is None else f'{got:g}'}, wanted {change.wanted:g}")
