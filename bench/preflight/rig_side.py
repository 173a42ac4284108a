"""The rig's part of the evidence: the two short runs of `saranga-bench rig check`."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench.preflight.evidence import RigSide
from bench.rig.check import CheckPlan
from bench.rig.check import gather as gather_rig
from bench.rig.driver import open_rig
from saranga.errors import UsageError
from saranga.wire import MODE_TRANSMIT_RECEIVE

SECONDS = 8.0
RECONNECT_S = 4.0
CLOCK_PPM = 400.0
MORE_S, MORE_TIMES = 5.0, 2


@dataclass(frozen=True)
class Reflector:
    """Where the operator put the pole: `side` "right", "left" or "none"; range from the sensors, m."""

    side: str = "right"
    range_m: float | None = 0.8


def parse_reflector(text: str) -> Reflector:
    """`RANGE`, `RANGE,SIDE` or `none`.

    Raises:
        UsageError: anything else.
    """
    if text == "none":
        return Reflector("none", None)
    number, _, side = text.partition(",")
    try:
        range_m = float(number)
    except ValueError:
        range_m = -1.0
    if not 0.3 <= range_m <= 2.0 or (side or "right") not in ("right", "left"):
        raise UsageError(f"--reflector {text!r}: expected RANGE[,right|left] with 0.3..2 m, such as 0.8,right; or none")
    return Reflector(side or "right", range_m)


def gather(url: str, sonar: str, reflector: Reflector, temperature_c: float | None, record: Path,
           stop: Callable[[], bool], seconds: float = SECONDS) -> RigSide:
    """Open, test, run, close.

    Raises:
        DeviceError: no rig, another firmware, or one that goes away. UsageError: wrong sonar.
    """
    plan = CheckPlan(url, seconds, sonar=sonar, reflector=reflector.side, reflector_range_m=reflector.range_m,
                     temperature_c=temperature_c)
    rig = open_rig(url, record=record, reconnect_s=RECONNECT_S,
                   temperature_c=temperature_c, metadata={"procedure": "preflight"})
    try:
        evidence = gather_rig(rig, plan, stop)
        for _ in range(MORE_TIMES):
            # A busy host delays what it reads, and only more time tells that from a wrong crystal.
            if evidence.drift is None or abs(evidence.drift.ppm) <= CLOCK_PPM or stop():
                break
            rig.start(MODE_TRANSMIT_RECEIVE, plan.rate_hz)
            began = time.monotonic()
            while time.monotonic() - began < MORE_S and not stop():
                rig.poll(0.1)
            rig.stop()
            evidence.drift = rig.clock.drift()
        return RigSide(url, evidence, rig.origin, time.monotonic())
    finally:
        rig.close()
