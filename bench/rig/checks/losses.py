"""What was lost or came twice on the way: frames, cycles, the cable itself."""

import itertools
from collections.abc import Callable

import numpy as np

from bench.rig.evidence import Evidence, Finding
from saranga.echo import EchoFrame

NAME = "losses"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    link = evidence.link
    cycles = len(evidence.loud) + len(evidence.quiet)
    frames = {role: evidence.frames(evidence.loud, role) + evidence.frames(evidence.quiet, role)
              for role in evidence.roles}
    count = sum(map(len, frames.values()))
    bad = link.bad_cobs + link.bad_crc + link.bad_message
    found = [
        _share("frames_bad_share", bad, count + bad, f"{bad} frames came damaged: cable, or a port that is not the "
                                                    "rig's alone"),
        _share("frames_lost_share", link.sequence_gaps, count + link.sequence_gaps,
               f"{link.sequence_gaps} frames never came (dropped): the host or a hub does not keep up"),
        _share("frames_duplicated_share", link.duplicates, count + link.duplicates,
               f"{link.duplicates} frames came twice (duplicates): the firmware sends them again"),
        _share("cycles_overrun_share", evidence.overruns, count, f"{evidence.overruns} times the device lost cycles "
               "(overruns): lower the rate or the number of samples"),
        Finding("cable_losses", float(evidence.unplugged + evidence.silences), "1", samples=max(cycles, 1),
                cause=f"the port was lost {evidence.unplugged} times and silent {evidence.silences} times: cable, plug "
                      "or supply"),
        Finding("device_restarts", float(evidence.restarts), "1", samples=max(cycles, 1),
                cause="the device started again by itself: supply, or a crash of the firmware"),
    ]
    expected = evidence.asked_rate_hz * evidence.ran_s
    for role, mine in frames.items():
        found.append(_share("frames_repeated_share", _repeats(mine), len(mine),
                            f"records of the {role} sensor were read twice (repeated under a new number): the firmware "
                            "reads before the sensor has measured", role))
        found.append(Finding("frames_received_share", len(mine) / expected if expected > 0 else None, "1", of=role,
                             samples=max(len(mine), 1), cause=f"the {role} sensor sent {len(mine)} records of about "
                             f"{expected:.0f} (dead, or dropping cycles): check its cable"))
    return found


def _share(limit: str, count: int, of: int, cause: str, role: str = "") -> Finding:
    return Finding(limit, count / of if of else None, "1", cause, role, of, blocked="" if of else "no records came")


def _repeats(frames: list[EchoFrame]) -> int:
    """Records equal to the one before, number by number, that are not all zero: noise never comes twice."""
    return sum(a.iq.shape == b.iq.shape and bool(b.iq.any()) and np.array_equal(a.iq, b.iq)
               for a, b in itertools.pairwise(frames))
