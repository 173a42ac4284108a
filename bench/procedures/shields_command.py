"""`saranga-bench shields RUN RUN...`: sweeps read as one, the shield table, its models, flights behind each shield."""

import contextlib
import sys
from pathlib import Path
from typing import Any

from bench.interrupt import Interrupts, interruptible
from bench.procedures.noise_models import write_models
from bench.procedures.points import read_sweep
from bench.procedures.sweep_session import exit_code_of
from bench.procedures.sweep_summary import source_text, summarise_sweeps
from bench.procedures.sweep_text import summary_text
from bench.statistics import wilson_interval
from bench.store import Store, runs_root, write_json
from saranga.errors import BenchError, UsageError

SHIELDS_FILE = "shields.json"


def compare_shields(folders: list[Path], at_thrust_kgf: float | None = None,
                    sensor: str | None = None) -> dict[str, Any]:
    """The summary over several runs; writes `noise-model-*.toml` and `shields.json` into the last of them.

    Raises:
        UsageError: no sweep, the same run twice, or runs of different things.
    """
    if not folders:
        raise UsageError("no run given: name one or more sweeps; `saranga-bench runs` lists them")
    resolved = [f.resolve() for f in folders]
    if len(set(resolved)) < len(resolved):
        raise UsageError("the same run is given twice: its blocks would count double")
    sweeps = [read_sweep(folder, number) for number, folder in enumerate(folders)]
    distances = {s.plan.hub_distance_m for s in sweeps}
    if len(distances) > 1:
        raise UsageError(f"the runs have hub_distance_m {', '.join(f'{d:g}' for d in sorted(distances))}: levels at "
                         "different distances cannot be read as one")
    summary = summarise_sweeps(sweeps, at_thrust_kgf, sensor)
    analysis = summary.pop("analysis")
    source = "; ".join(source_text(s) for s in sweeps)
    conditions = tuple({c.name: c for s in sweeps for c in s.plan.conditions}.values())
    try:
        models = write_models(folders[-1], analysis, conditions, summary["origin"], source,
                              sweeps[-1].plan.hub_distance_m)
        summary["noise_models"] = {name: path.name for name, path in models.items()}
    except UsageError as error:
        summary["noise_models"] = {}
        summary["errors"].append(f"no noise model for flights: {error}")
    write_json(folders[-1] / SHIELDS_FILE, summary)
    return summary


def fly_shields(folder: Path, names: list[str], flights: int, scene: str, seed: int, interrupts: Interrupts,
                say: Any) -> dict[str, Any]:
    """Success rate behind each shield, the same seeds for all, on the embedded autopilot."""
    from sitl.trial import run_trial
    from sitl.trial_types import TrialRequest

    out: dict[str, Any] = {"scene": scene, "seeds": [seed, seed + flights - 1], "autopilot": "embedded",
                           "origin": "simulated", "by_shield": {}}
    for name in names:
        successes = trials = 0
        outcomes: list[str] = []
        entry: dict[str, Any] = {}
        for one in range(seed, seed + flights):
            if interrupts.asked():
                break
            try:
                result = run_trial(TrialRequest(scene=scene, seed=one, autopilot="embedded", stack="saranga",
                                                denoiser="saranga", shield=f"{folder}:{name}"), None, interrupts.asked)
            except BenchError as error:
                entry["error"] = str(error)
                break
            trials += 1
            outcomes.append(result.outcome)
            successes += result.outcome == "clean"
        low, high = wilson_interval(successes, trials)
        entry |= {"successes": successes, "trials": trials, "rate": successes / trials if trials else None,
                  "interval": [low, high], "outcomes": outcomes}
        out["by_shield"][name] = entry
        say(f"flown behind {name}: {successes} of {trials} clean")
    return out


def shields_command(runs: list[str], at_thrust: float | None, sensor: str | None, flights: int, scene: str, seed: int,
                    as_json: bool, out: Path | None) -> int:
    """Returns the exit code."""
    if flights < 0 or seed < 0:
        raise UsageError(f"--flights {flights}, --seed {seed}: not negative")
    store = Store(runs_root(out))
    folders = [store.resolve(name) for name in runs]
    summary = compare_shields(folders, at_thrust, sensor)

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    guard = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    if flights:
        if not summary["noise_models"]:
            raise UsageError("no shield of these runs has a noise model to fly on: " + "; ".join(summary["errors"]))
        with guard, interruptible() as interrupts:
            summary["flights"] = fly_shields(folders[-1], list(summary["noise_models"]), flights, scene, seed,
                                             interrupts, say)
            if interrupts.asked():
                summary["state"] = "interrupted"
        write_json(folders[-1] / SHIELDS_FILE, summary)
    from bench.procedures.sweep_page import write_sweep_page
    from bench.sweep_cli import print_result

    with guard:
        say(f"page {write_sweep_page(folders[-1], summary, 'shields.html')}")
    print_result(summary, summary_text(summary), as_json)
    return exit_code_of(summary)
