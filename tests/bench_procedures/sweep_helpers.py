"""Small plans, and sweeps of the emulated device in simulated time."""

from pathlib import Path
from typing import Any

from bench.interrupt import Interrupts
from bench.procedures.bench import Bench, Heard
from bench.procedures.emulated_device import EmulatedSpec, make_emulated
from bench.procedures.plan import NoisePlan, plan_from_tables
from bench.procedures.schedule import Step
from bench.procedures.simulated_bench import SimulatedBench
from bench.procedures.sweep_session import SweepRequest, run_sweep
from bench.store import Run, Store


def tables(**changes: Any) -> dict[str, Any]:
    """A plan that takes seconds: three throttles, three blocks, two shields."""
    return {
        "name": "small", "blocks": 3, "mount_s": 1.0, "drift_check": False,
        "levels": {"throttles": [0.25, 0.45, 0.8]}, "rig": {"frames": 20, "rate_hz": 50.0},
        "settle": {"least_s": 0.2, "window_s": 0.2, "most_s": 3.0},
        "limits": {"throttle": 0.9, "thrust_n": 7.0, "slew_per_s": 3.0},
        "conditions": [{"name": "none", "reference": True}, {"name": "foam", "shield": "foam"},
                       {"name": "plastic", "shield": "plastic"}], **changes}


def plan_of(**changes: Any) -> NoisePlan:
    """The checked plan."""
    plan = plan_from_tables(tables(**changes), "test plan")
    assert isinstance(plan, NoisePlan)
    return plan


class Silent:
    """A watcher that keeps what it is told. `until`: called after each step, may raise or change things."""

    def __init__(self, until: Any = None) -> None:
        self.records: list[dict[str, Any]] = []
        self._until = until

    def begin(self, step: Step, left_s: float) -> None:
        pass

    def heard(self, step: Step, heard: Heard, now_s: float) -> None:
        pass

    def finish(self, step: Step, record: dict[str, Any]) -> None:
        self.records.append(record)
        if self._until is not None:
            self._until(len(self.records))


def sweep(root: Path, plan: NoisePlan, spec: EmulatedSpec, interrupts: Interrupts | None = None,
          watcher: Silent | None = None, resume: Path | None = None, wrap: Any = None,
          record: bool = False) -> tuple[dict[str, Any], Run]:
    """Run a plan on the emulated device in simulated time."""

    def make(folder: Path, recording: Path) -> Bench:
        bench: Bench = SimulatedBench(make_emulated(spec, plan), plan.rig, plan.limits, recording if record else None)
        return wrap(bench) if wrap else bench

    return run_sweep(SweepRequest(plan, make, {"argv": []}, resume), Store(root), watcher or Silent(),
                     interrupts or Interrupts())
