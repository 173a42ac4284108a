"""Parameters against the set the flights were made with; names of 4.5 and 4.7 are understood."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding
from bench.preflight.parameter_difference import difference

NAME = "parameters"
ACTION = "look at the difference, then set them with --fix-parameters (it asks first)"
LISTED = 6


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    vehicle = evidence.vehicle
    names = ("parameters_different", "parameters_absent", "parameters_unread")
    if vehicle is None or vehicle.stopped or not vehicle.parameters:
        why = evidence.why_not("vehicle") if vehicle is None else vehicle.stopped or "it sent no parameters"
        return [Finding(name, None, "1", ACTION, blocked=why) for name in names]
    found = difference(vehicle, evidence.wanted)
    differing = [str(d) for d in found.different]
    count = vehicle.parameter_count
    unread = None if count is None else float(max(count - len(vehicle.parameters), 0))
    heard_s, samples = vehicle.parameters_s, found.compared
    return [
        Finding("parameters_different", float(len(differing)), "1", ACTION, samples=samples, heard_s=heard_s,
                seen=_list(differing) or f"{found.compared} compared, {len(vehicle.parameters)} read"),
        Finding("parameters_absent", float(len(found.absent)), "1",
                "the firmware lacks what the flights rest on: flash a full build", samples=samples, heard_s=heard_s,
                seen=_list(found.absent)),
        Finding("parameters_unread", unread, "1", "the link loses messages: try again, or a faster link",
                heard_s=heard_s, seen=f"{len(vehicle.parameters)} of {count}",
                blocked="" if unread is not None else "it did not say how many it has"),
    ]


def _list(texts: list[str]) -> str:
    more = f" and {len(texts) - LISTED} more" if len(texts) > LISTED else ""
    return "; ".join(texts[:LISTED]) + more
