"""`saranga-bench sweep`: from options to a bench, a run and an exit code."""

import contextlib
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.emulated import is_emulated
from bench.interrupt import Interrupts, interruptible
from bench.procedures.bench import Bench
from bench.procedures.emulated_device import (
    EmulatedProcess,
    EmulatedSpec,
    make_emulated,
    parse_emulated,
    refuse_what_only_simulated_time_can,
)
from bench.procedures.plan import NoisePlan, load_noise_plan
from bench.procedures.schedule import Forecast, Step, forecast, plan_hash, schedule
from bench.procedures.sweep_session import (
    SweepRequest,
    exit_code_of,
    plan_of_run,
    run_sweep,
    steps_left,
)
from bench.procedures.sweep_text import summary_text
from bench.procedures.terminal import BarWatcher, LineWatcher, plan_text, terminal_hands
from bench.store import Store, runs_root
from bench.supervisor import Confirmation
from saranga.errors import UsageError
from saranga.numba_cache import is_cold


@dataclass(frozen=True)
class SweepOptions:
    """As given on the command line."""

    plan: str | None
    rig: str | None
    stand: str | None
    throttle: str | None
    dry_run: bool
    plan_hash: str | None
    yes_spin: bool
    simulated_time: bool
    resume: str | None
    view: bool
    as_json: bool
    out: Path | None
    quiet: bool
    argv: tuple[str, ...] = ()


def sweep_command(options: SweepOptions) -> int:
    """Run it; returns the exit code.

    Raises:
        UsageError, DeviceError: see the parts.
    """
    store = Store(runs_root(options.out))
    folder = store.resolve(options.resume) if options.resume is not None else None
    plan = _plan(options, folder)
    steps = steps_left(folder, plan) if folder is not None else schedule(plan)
    spec = _emulated(options)
    seen = _forecast(plan, steps, spec)
    if options.dry_run:
        return _show_dry_run(options, plan, steps, seen, spec is None)
    _check_hash(options, seen, spec)
    if not options.quiet:
        print(plan_text(plan, tuple(steps), seen, spec is None), file=sys.stderr)
    guard = contextlib.redirect_stdout(sys.stderr) if options.as_json else contextlib.nullcontext()
    confirmation = _confirmation(options, plan, seen, spec)
    with guard, interruptible() as interrupts:
        summary = _run(options, plan, folder, store, spec, confirmation, interrupts, len(schedule(plan)) - len(steps))
    from bench.sweep_cli import print_result

    print_result(summary, summary_text(summary), options.as_json)
    return exit_code_of(summary)


def _run(options: SweepOptions, plan: NoisePlan, folder: Path | None, store: Store, spec: EmulatedSpec | None,
         confirmation: Confirmation, interrupts: Interrupts, done: int) -> dict[str, Any]:
    total = len(schedule(plan))
    say = _say
    watcher: Any = (BarWatcher(plan, total, done, say) if sys.stderr.isatty() and not options.quiet
                    else LineWatcher(plan, total, done, say, options.quiet))
    with contextlib.ExitStack() as stack:
        stack.callback(watcher.close)
        if options.view:
            from bench.procedures.live_view import LiveView

            watcher = LiveView(plan, watcher)
            stack.callback(watcher.close_view)

        def make_bench(run: Path, recording: Path) -> Bench:
            if options.simulated_time:
                from bench.procedures.simulated_bench import SimulatedBench

                assert spec is not None
                if is_cold():
                    say("compiling kernels, about half a minute: once after an installation")
                return SimulatedBench(make_emulated(spec, plan), plan.rig, plan.limits, recording)
            from bench.procedures.hardware_bench import HardwareBench

            process = None
            rig, stand = options.rig or "", options.stand or ""
            if spec is not None:
                if is_cold():
                    say("compiling kernels, about half a minute: once after an installation")
                process = EmulatedProcess(spec, plan, run / "emulated-truth.jsonl")
                stack.callback(process.close)
                rig, stand = process.url, f"teensy+{process.url}"
            throttle = stand if spec is not None or options.throttle is None else options.throttle
            return HardwareBench(plan, rig, stand, throttle, confirmation, recording, run, interrupts.asked,
                                 terminal_hands, process)

        inputs = {"argv": list(options.argv), "rig_url": options.rig, "stand_url": options.stand,
                  "throttle_url": options.throttle, "simulated_time": options.simulated_time,
                  "emulated": None if spec is None else asdict(spec)}
        summary, run = run_sweep(SweepRequest(plan, make_bench, inputs, folder), store, watcher, interrupts)
    _write_page(run.folder, say)
    return summary


def _plan(options: SweepOptions, folder: Path | None) -> NoisePlan:
    if folder is None:
        if options.plan is None:
            raise UsageError("no plan: give the name of one in fixtures/plans, a .toml file, or --resume RUN")
        return load_noise_plan(options.plan)
    plan = plan_of_run(folder)
    if options.plan is not None and plan_hash(load_noise_plan(options.plan)) != plan_hash(plan):
        raise UsageError(f"--resume {options.resume}: the run was begun with another plan (hash {plan_hash(plan)}): "
                         "leave the plan out, or start anew")
    return plan


def _emulated(options: SweepOptions) -> EmulatedSpec | None:
    """What to emulate, None for real hardware.

    Raises:
        UsageError: one of rig and stand emulated and the other not, or nothing to run on.
    """
    if options.simulated_time:
        given = [u for u in (options.rig, options.stand, options.throttle) if u is not None and not is_emulated(u)]
        if given:
            raise UsageError(f"--simulated-time runs an emulated device in this process: leave {given[0]} out")
        return parse_emulated(options.rig, options.stand)
    if is_emulated(options.stand) or is_emulated(options.rig):
        if not (is_emulated(options.stand) and (options.rig is None or is_emulated(options.rig))) or options.throttle:
            raise UsageError("rig and stand are one emulated device: give both as emulated: (and no --throttle), or "
                             "both as real ones")
        return parse_emulated(options.rig, options.stand)
    if options.stand is None and not options.dry_run:
        raise UsageError("no stand: give --stand URL (and --rig URL), or --stand emulated: for a rehearsal")
    if options.rig is None and not options.dry_run and not (options.stand or "").startswith("teensy+"):
        raise UsageError(f"no rig: give --rig URL; {options.stand} carries no sensors")
    return None


def _forecast(plan: NoisePlan, steps: "tuple[Step, ...]", spec: EmulatedSpec | None) -> Forecast:
    return forecast(plan, steps, by_hand=spec is None, power_w=_power_w(plan, spec))


def _power_w(plan: NoisePlan, spec: EmulatedSpec | None) -> dict[float, float] | None:
    """Expected power by level from the model of the emulated motor, or of one that the plan's metadata names."""
    name = spec.propeller if spec is not None else plan.metadata.get("thrust_model")
    if name is None or plan.levels.by_thrust:
        return None
    from bench.thrust_stand.plant import load_plant

    plant = load_plant(str(name))
    found = {}
    for level in plan.levels.values:
        r = plant.steady(level)
        found[level] = r.voltage_v * r.current_a
    return found


def _show_dry_run(options: SweepOptions, plan: NoisePlan, steps: "tuple[Step, ...]", seen: Forecast,
                  by_hand: bool) -> int:
    if options.plan_hash is not None and options.plan_hash != seen.plan_hash:
        raise UsageError(f"--plan-hash {options.plan_hash}: this plan's hash is {seen.plan_hash}: it has changed")
    if not options.as_json:
        print(plan_text(plan, steps, seen, by_hand))
        return 0
    from bench.cli import print_json

    print_json({"verdict": None, "dry_run": True, "plan_hash": seen.plan_hash, "forecast": asdict(seen),
                "plan": plan.model_dump(mode="json"), "steps": [s.to_dict() for s in steps], "outcomes": [],
                "checks": [], "metrics": {}, "provenance": {}, "run": None})
    return 0


def _check_hash(options: SweepOptions, seen: Forecast, spec: EmulatedSpec | None) -> None:
    if options.plan_hash is not None and options.plan_hash != seen.plan_hash:
        raise UsageError(f"--plan-hash {options.plan_hash}: this plan's hash is {seen.plan_hash}: the plan has changed "
                         "since the dry run; look at it with --dry-run and give the new hash")
    if options.plan_hash is None and spec is None:
        raise UsageError("real hardware needs --plan-hash: look at the plan with --dry-run, then give the hash it "
                         "shows")


def _confirmation(options: SweepOptions, plan: NoisePlan, seen: Forecast, spec: EmulatedSpec | None) -> Confirmation:
    if spec is not None:
        return Confirmation.flag()  # the device was made for this sweep, in software: there is nothing to hurt
    if options.yes_spin and not sys.stdin.isatty():
        return Confirmation.flag()  # the supervisor refuses it unless the stand says that it is emulated
    text = (f"{options.stand}: the propeller will spin up to throttle {seen.peak_throttle:g} for "
            f"{seen.spinning_s / 60:.1f} min (plan {plan.name}, hash {seen.plan_hash}). Guard closed, people away?")
    return Confirmation.from_operator(text)


def _write_page(folder: Path, say: Any) -> None:
    """The page can be made again from the run folder, so failing to make it fails no sweep."""
    try:
        from bench.procedures.sweep_page import write_sweep_page

        say(f"page {write_sweep_page(folder)}")
    except Exception as error:
        say(f"no report page ({type(error).__name__}: {error}): `saranga-bench report {folder}` tries again")


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


__all__ = ["SweepOptions", "refuse_what_only_simulated_time_can", "sweep_command"]
