"""A parked vehicle on a byte link in simulated time: a busy machine changes nothing."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.preflight.collect import Conversation, Deadlines, gather
from bench.preflight.command import Plan, judge_evidence
from bench.preflight.evidence import Evidence
from bench.preflight.guard import GuardedLink
from bench.preflight.parameter_difference import wanted_parameters
from bench.preflight.rig_side import RigSide
from bench.rig.check import CheckPlan
from bench.rig.check import gather as gather_rig
from bench.rig.driver import Rig
from bench.verdict import load_limits
from saranga.errors import BenchError
from sitl.parked import BOOT_S, ParkedVehicle
from sitl.parked_faults import parse_parked_faults

sys.path.insert(0, str(Path(__file__).parent.parent / "bench_rig"))
from simulated_rig import SimulatedLink

QUICK = Deadlines(connect_s=6.0, identify_s=2.0, parameters_s=5.0, settle_s=0.5, watch_s=4.0, answer_s=0.5)


class ParkedLink:
    """`now` turns only while somebody reads. `sent` is what was written."""

    url = "simulated:"

    def __init__(self, *faults: str, kind: str = "embedded", seed: int = 1) -> None:
        self.vehicle = ParkedVehicle(kind, parse_parked_faults(list(faults)), seed)
        self.vehicle.boot(BOOT_S[kind])
        self.sent = b""
        self._spoken = b""

    def now(self) -> float:
        return self.vehicle.t_us * 1e-6

    def open(self) -> None:
        """It is."""

    def read(self, timeout_s: float) -> bytes:
        until = self.now() + timeout_s
        while True:
            data, self._spoken = self.vehicle.tick(self._spoken), b""
            if data or self.now() >= until:
                return data

    def write(self, data: bytes) -> None:
        self.sent += data
        self._spoken += data

    def close(self) -> None:
        self.vehicle.close()


def ask(*faults: str, kind: str = "embedded", seed: int = 1, system: int = 1) -> tuple[Evidence, ParkedLink]:
    """The evidence of a parked vehicle with these faults; a link that fails is told in `absent`."""
    link = ParkedLink(*faults, kind=kind, seed=seed)
    evidence = Evidence(wanted=wanted_parameters())
    conversation = Conversation(GuardedLink(link), system, now=link.now)
    try:
        evidence.vehicle = gather(conversation, [p.name for p in evidence.wanted], deadlines=QUICK)
    except BenchError as error:
        evidence.absent["vehicle"] = str(error)
    finally:
        link.close()
    evidence.now_s = link.now()
    return evidence, link


def ask_rig(*faults: str, seconds: float = 5.0) -> RigSide:
    """What an emulated rig with these faults says, in simulated time.

    Raises:
        DeviceError: it goes away, or its firmware is another.
    """
    link = SimulatedLink(*faults)
    rig = Rig(link, now=link.now, sleep=link.sleep)
    rig.open()
    try:
        plan = CheckPlan("emulated:", seconds=seconds, reflector="right", reflector_range_m=0.8)
        return RigSide("emulated:", gather_rig(rig, plan), rig.origin, math.nan)
    finally:
        rig.close()


def with_rest(evidence: Evidence, rest: Evidence) -> Evidence:
    """Rig, stack and MAVSDK of another evidence beside this vehicle, as old as they were."""
    later_s = evidence.now_s - rest.now_s
    evidence.rig = replace(rest.rig, heard_s=rest.rig.heard_s + later_s)
    evidence.stack = replace(rest.stack, heard_s=rest.stack.heard_s + later_s)
    evidence.absent["mavsdk"] = "not asked in simulated time"
    return evidence


def judged(evidence: Evidence, **more: Any) -> dict[str, Any]:
    """The result; links that were not asked for are no failure, but no GO either."""
    plan = Plan(vehicle="simulated:", **more)
    return judge_evidence(plan, evidence, load_limits("preflight"), load_limits("rig"))
