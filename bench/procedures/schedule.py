"""The steps of a noise plan in their order, what they will take, and the hash that ties a run to its dry run."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.procedures.plan import BeamPlan, EchoPlan, NoisePlan

CHANGE_S = 0.6
"""Typical ramp between two levels, on top of settling."""


@dataclass(frozen=True)
class Step:
    """One measurement. `level` is a throttle, or a thrust in N where the plan's levels are thrusts; 0: motor off.

    `mounting` counts how often something has been mounted up to here: steps with the same number share a mounting.
    """

    step: int
    block: int
    condition: str
    phase: str
    level: float
    mounting: int

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


def schedule(plan: NoisePlan) -> tuple[Step, ...]:
    """Every step. Deterministic by the plan's seed.

    In order "mounting" each block mounts the reference first, then the other conditions in random order; each mounting
    begins with the motor off and runs all levels in random order. A drift check closes the block: the reference at its
    middle level once more. In order "full" every level of every condition comes in one random order, remounted each
    time.
    """
    steps: list[Step] = []
    mounting = -1
    mounted: str | None = None

    def add(block: int, condition: str, phase: str, level: float) -> None:
        nonlocal mounting, mounted
        if mounted != condition:
            mounting, mounted = mounting + 1, condition
        steps.append(Step(len(steps), block, condition, phase, level, mounting))

    reference = plan.reference.name if plan.reference else None
    for block in range(plan.blocks):
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([plan.seed, block])))
        mounted = None  # a new block mounts anew, whatever stood there
        others = [c.name for c in plan.conditions if c.name != reference]
        order = ([reference] if reference else []) + [others[k] for k in rng.permutation(len(others))]
        if plan.order == "mounting":
            for name in order:
                add(block, name, "background", 0.0)
                for level in rng.permutation(plan.levels.values).tolist():
                    add(block, name, _phase(plan, name), level)
        else:
            for name in order:
                add(block, name, "background", 0.0)
            pairs = [(name, level) for name in order for level in plan.levels.values]
            for k in rng.permutation(len(pairs)).tolist():
                add(block, pairs[k][0], _phase(plan, pairs[k][0]), pairs[k][1])
        if plan.drift_check and reference is not None and len(order) > 1:
            add(block, reference, "drift", drift_level(plan))
    return tuple(steps)


def drift_level(plan: NoisePlan) -> float:
    """The level that the drift check repeats: the middle one."""
    return sorted(plan.levels.values)[len(plan.levels.values) // 2]


def plan_hash(plan: NoisePlan | BeamPlan | EchoPlan) -> str:
    """SHA-256 (16 hexadecimal digits) of the whole plan, order included. Where it is run does not enter."""
    steps = [s.to_dict() for s in schedule(plan)] if isinstance(plan, NoisePlan) else []
    text = json.dumps({"plan": plan.model_dump(mode="json"), "steps": steps}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Forecast:
    """What a dry run shows.

    Attributes:
        duration_s, spinning_s: whole, and with the motor on; mounting by the operator included in the first.
        most_energy_j: of the motor, if it drew the current limit at the battery's voltage all the while; None without a
            current limit.
        energy_j: expected, from the model of the named propeller and motor; None where there is none.
    """

    steps: int
    mountings: int
    duration_s: float
    spinning_s: float
    mounting_s: float
    peak_throttle: float
    peak_thrust_n: float | None
    energy_j: float | None
    most_energy_j: float | None
    plan_hash: str


def step_duration_s(plan: NoisePlan, step: Step) -> float:
    """Typical, settling at its earliest."""
    settle = max(plan.settle.least_s, plan.settle.window_s)
    return CHANGE_S + settle + plan.rig.frames / plan.rig.rate_hz


def forecast(plan: NoisePlan, steps: Sequence[Step], by_hand: bool, battery_v: float = 16.8,
             power_w: "dict[float, float] | None" = None) -> Forecast:
    """Time, peak and energy of these steps.

    Args:
        by_hand: a person mounts (`mount_s` each); an emulated device takes no time.
        power_w: expected electrical power by level, where a model knows it.
    """
    spinning = [s for s in steps if s.phase != "background"]
    spin_s = sum(step_duration_s(plan, s) for s in spinning) + plan.warm_up.duration_s
    measure_s = sum(step_duration_s(plan, s) for s in steps) + plan.warm_up.duration_s
    mountings = len({s.mounting for s in steps})
    mounting_s = mountings * plan.mount_s if by_hand else 0.0
    peak = plan.limits.throttle if plan.levels.by_thrust else max((s.level for s in steps), default=0.0)
    energy = None
    if power_w is not None and all(s.level in power_w for s in spinning):
        energy = sum(power_w[s.level] * step_duration_s(plan, s) for s in spinning)
    most = plan.limits.current_a
    return Forecast(
        steps=len(steps), mountings=mountings, duration_s=measure_s + mounting_s, spinning_s=spin_s,
        mounting_s=mounting_s, peak_throttle=max(peak, plan.warm_up.throttle),
        peak_thrust_n=max(s.level for s in spinning) if plan.levels.by_thrust and spinning else None,
        energy_j=energy, most_energy_j=None if most is None else most * battery_v * spin_s, plan_hash=plan_hash(plan))


def _phase(plan: NoisePlan, name: str) -> str:
    return "reference" if plan.condition(name).reference else "shielded"
