"""The link to the vehicle: heartbeats without gaps, no damaged messages."""

import itertools
from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "vehicle link"
LIMITS = (("heartbeat_gap_s", "s"), ("messages_bad_share", "1"))
ACTION = "check cable, plug, baud rate and radio"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    times = [heard.t_s for heard in vehicle.all("HEARTBEAT")]
    gap_s = max((b - a for a, b in itertools.pairwise(times)), default=None)
    total = vehicle.bad_messages + vehicle.good_messages
    return [
        Finding("heartbeat_gap_s", gap_s, "s", ACTION, samples=len(times), heard_s=times[-1] if times else None,
                blocked="" if gap_s is not None else "fewer than two heartbeats"),
        Finding("messages_bad_share", vehicle.bad_messages / total if total else None, "1", ACTION, samples=total,
                heard_s=times[-1] if times else None, seen=f"{vehicle.bad_messages} of {total}"),
    ]
