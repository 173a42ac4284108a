"""What a person sees of a sweep: the dry run, progress with the time left, and hands asked to mount."""

import sys
from collections.abc import Callable
from typing import Any

from bench.procedures.bench import Heard
from bench.procedures.plan import NoisePlan
from bench.procedures.schedule import Forecast, Step

Say = Callable[[str], None]


def duration_text(seconds: float) -> str:
    """"6 min 12 s"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def plan_text(plan: NoisePlan, steps: tuple[Step, ...], forecast: Forecast, by_hand: bool) -> str:
    """The dry run for people."""
    limits = {k: v for k, v in plan.limits.model_dump().items() if v is not None}
    energy = "unknown (no model of this motor)"
    if forecast.energy_j is not None:
        energy = f"about {forecast.energy_j / 1e3:.1f} kJ"
    if forecast.most_energy_j is not None:
        energy += f", at most {forecast.most_energy_j / 1e3:.1f} kJ at the current limit"
    hands = f", of which {duration_text(forecast.mounting_s)} to mount things" if by_hand else ""
    lines = [
        f"{plan.name}: {plan.description}",
        f"  conditions   {', '.join(c.name + (' (reference)' if c.reference else '') for c in plan.conditions)}",
        f"  levels       {', '.join(f'{v:g}' for v in plan.levels.values)} "
        f"({'N of thrust' if plan.levels.by_thrust else 'throttle'}), {plan.blocks} blocks, order by seed {plan.seed}",
        f"  listening    {plan.rig.frames} records a step at {plan.rig.rate_hz:g} Hz, receive only, sensor "
        f"{plan.rig.sensor}",
        f"  steps        {forecast.steps}, {forecast.mountings} mountings",
        f"  time         about {duration_text(forecast.duration_s)}{hands}; motor on for "
        f"{duration_text(forecast.spinning_s)}",
        f"  peak         throttle {forecast.peak_throttle:g}"
        + (f", thrust {forecast.peak_thrust_n:g} N" if forecast.peak_thrust_n is not None else ""),
        f"  energy       {energy}",
        f"  limits       {', '.join(f'{k} {v:g}' for k, v in limits.items())}",
        "  order"]
    for block in range(plan.blocks):
        lines.append(f"    block {block + 1}: " + "; ".join(_order(steps, block)))
    lines.append(f"  plan hash    {forecast.plan_hash}")
    return "\n".join(lines)


def _order(steps: tuple[Step, ...], block: int) -> list[str]:
    groups: list[tuple[int, str, list[float]]] = []
    for s in steps:
        if s.block != block:
            continue
        if not groups or groups[-1][0] != s.mounting:
            groups.append((s.mounting, s.condition, []))
        groups[-1][2].append(s.level)
    return [f"{name} {' '.join(f'{v:g}' for v in levels)}" for _, name, levels in groups]


class LineWatcher:
    """One line a step, with the time left."""

    def __init__(self, plan: NoisePlan, total: int, done: int, say: Say, quiet: bool = False) -> None:
        self._plan = plan
        self._total = total
        self._done = done
        self._say = say
        self._quiet = quiet

    def begin(self, step: Step, left_s: float) -> None:
        self._left_s = left_s

    def heard(self, step: Step, heard: Heard, now_s: float) -> None:
        pass

    def finish(self, step: Step, record: dict[str, Any]) -> None:
        self._done += 1
        if self._quiet:
            return
        noise = record["noise"].get(self._plan.rig.sensor, {})
        thrust = "" if record["thrust_n"] is None else f"thrust {record['thrust_n']:.3f} N, "
        flags = ("" if record["settled"] else ", NOT SETTLED") + (
            f", {noise['clipped_share']:.1%} clipped" if noise.get("clipped_share", 0.0) > 0.001 else "")
        self._say(f"{self._done:4d}/{self._total} block {step.block + 1} {step.condition:<12} {step.phase:<10} "
                  f"throttle {record['throttle']:.2f}, {thrust}noise {noise.get('rms', float('nan')):.5f}{flags}; "
                  f"{duration_text(self._left_s)} left")

    def close(self) -> None:
        pass


class BarWatcher(LineWatcher):
    """A bar on a terminal."""

    def __init__(self, plan: NoisePlan, total: int, done: int, say: Say) -> None:
        super().__init__(plan, total, done, say)
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bars = Progress(TextColumn("{task.description:<34}"), BarColumn(30),
                              TextColumn("{task.completed}/{task.total} {task.fields[seen]}"), TimeRemainingColumn(),
                              console=Console(stderr=True, highlight=False), transient=True)
        self._task = self._bars.add_task("starting", total=total, completed=done, seen="")
        self._bars.start()

    def begin(self, step: Step, left_s: float) -> None:
        super().begin(step, left_s)
        text = f"block {step.block + 1} {step.condition} {step.phase} {step.level:g}"
        self._bars.update(self._task, description=text)

    def heard(self, step: Step, heard: Heard, now_s: float) -> None:
        if heard.readings:
            self._bars.update(self._task, seen=f"{heard.readings[-1].thrust_n:6.2f} N")

    def finish(self, step: Step, record: dict[str, Any]) -> None:
        self._done += 1
        self._bars.update(self._task, completed=self._done)

    def close(self) -> None:
        self._bars.stop()


def terminal_hands(text: str) -> None:
    """Ask at the terminal; returns when the operator says that it is done."""
    print(f"\n  {text}\n  The motor stands still and its throttle is held at idle. Press Enter when it is done.",
          file=sys.stderr, flush=True)
    input()
