"""`saranga-bench rig record`: everything a rig says, to a file that a kill does not spoil."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.provenance import versions
from bench.rig.driver import open_rig
from saranga.errors import UsageError
from saranga.wire import MODE_RECEIVE_ONLY, MODE_TRANSMIT_RECEIVE

MODES = {"transmit": MODE_TRANSMIT_RECEIVE, "receive": MODE_RECEIVE_ONLY}


@dataclass(frozen=True)
class RecordPlan:
    """What to record. `seconds` None: until it is interrupted. `odr`, `samples` None: as the rig is set."""

    url: str
    out: Path
    seconds: float | None = None
    mode: str = "transmit"
    rate_hz: float = 1e6 / 25_600
    odr: int | None = None
    samples: int | None = None
    ring_down_samples: int | None = None
    temperature_c: float | None = None
    reconnect_s: float = 30.0

    def __post_init__(self) -> None:
        if self.seconds is not None and not 0.1 <= self.seconds <= 1e6:
            raise UsageError(f"--seconds {self.seconds}: must be 0.1..1000000")
        if self.mode not in MODES:
            raise UsageError(f"--mode {self.mode!r}: must be {' or '.join(MODES)}")
        if not 0.1 <= self.rate_hz <= 200.0:
            raise UsageError(f"--rate {self.rate_hz}: must be 0.1..200 Hz")
        if (self.odr is None) != (self.samples is None):
            raise UsageError("--odr and --samples are given together, or neither")
        if self.out.suffix != ".mcap":
            raise UsageError(f"{self.out}: a recording's name ends in .mcap")


def record(plan: RecordPlan, stop: Callable[[], bool] = lambda: False,
           progress: Callable[[float, int], None] | None = None) -> dict[str, Any]:
    """Record until the time is over or `stop()`; a pulled cable is waited for.

    Args:
        progress: called about once a second with seconds and cycles so far.

    Returns:
        JSON-ready summary, losses and all. "verdict" is PASS where nothing was lost, else MARGINAL.

    Raises:
        UsageError: a plan no rig can do, or a file that exists.
        DeviceError: no rig, or it did not come back; what came is in the file.
    """
    metadata = {"procedure": "record", "mode": plan.mode, **versions()}
    rig = open_rig(plan.url, record=plan.out, metadata=metadata, reconnect_s=plan.reconnect_s,
                   temperature_c=plan.temperature_c)
    cycles = 0
    try:
        if plan.odr is not None and plan.samples is not None:
            ring_down = plan.ring_down_samples if plan.ring_down_samples is not None else (
                0 if plan.mode == "receive" else 20)
            rig.configure(plan.odr, plan.samples, ring_down)
        rig.start(MODES[plan.mode], plan.rate_hz)
        began = said = time.monotonic()
        while not stop() and (plan.seconds is None or time.monotonic() - began < plan.seconds):
            cycles += len(rig.poll(0.2))
            if progress is not None and time.monotonic() - said >= 1.0:
                said = time.monotonic()
                progress(said - began, cycles)
        cycles += len(rig.stop())
        took_s = time.monotonic() - began
    finally:
        rig.close()
    drift = rig.clock.drift()
    lossless = not (rig.counters.sequence_gaps or rig.losses.unplugged or rig.losses.silences or rig.losses.restarts
                    or rig.losses.overruns)
    return {
        "verdict": "PASS" if lossless and cycles else "MARGINAL" if cycles else "INCONCLUSIVE",
        "cycles": cycles, "duration_s": round(took_s, 3), "counters": asdict(rig.counters),
        "cycle_counters": asdict(rig.cycle_counters), "losses": asdict(rig.losses),
        "clock_drift": None if drift is None else asdict(drift), "temperature_c": rig.temperature_c,
        "sound_speed_m_s": rig.sound_speed_m_s, "checks": [], "metrics": {"cycles": cycles},
        "provenance": {"origin": rig.origin, "url": plan.url,
                       "firmware": rig.hello.firmware if rig.hello else ""}, "run": str(plan.out),
    }
