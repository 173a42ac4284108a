"""A noise sweep from plan to page: run folder, bench, runner, and an ending that loses nothing."""

import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.interrupt import Interrupts
from bench.journal import FILE_NAME, Journal, open_journal, read_journal
from bench.procedures.bench import Bench
from bench.procedures.noise_models import write_models
from bench.procedures.plan import NoisePlan, plan_from_tables
from bench.procedures.points import read_sweep
from bench.procedures.runner import Interrupted, Runner, Watcher
from bench.procedures.schedule import Step, plan_hash, schedule
from bench.procedures.stand_file import StandFile
from bench.procedures.sweep_summary import source_text, summarise_sweeps
from bench.provenance import git_state, versions
from bench.store import Run, Store, read_run, write_json
from bench.verdict import Verdict
from saranga.errors import BenchError, UsageError

SUMMARY_FILE = "summary.json"
CRASH_FILE = "crash.txt"
REMOUNTED = 10_000
"""Added to the numbers of mountings after each resumption: what is mounted then is not what was."""


@dataclass(frozen=True)
class SweepRequest:
    """What to run. `make_bench(run folder, recording)` builds the bench only once there is a run to write to."""

    plan: NoisePlan
    make_bench: Callable[[Path, Path], Bench]
    inputs: dict[str, Any]
    resume: Path | None = None


def plan_of_run(folder: Path) -> NoisePlan:
    """The plan that a run was begun with.

    Raises:
        UsageError: no sweep there.
    """
    header = read_journal(folder / FILE_NAME).header
    if header.get("run_kind") != "sweep":
        raise UsageError(f"{folder}: is no sweep (kind {header.get('run_kind')!r}): nothing to resume")
    plan = plan_from_tables(header["plan"], f"{folder}: plan in the journal")
    if not isinstance(plan, NoisePlan) or plan_hash(plan) != header.get("plan_hash"):
        raise UsageError(f"{folder}: the plan in its journal does not give its hash {header.get('plan_hash')} with "
                         "this version: its order would differ; start anew")
    return plan


def steps_left(folder: Path, plan: NoisePlan) -> tuple[Step, ...]:
    """Steps that a run has not finished, remounted."""
    records = read_journal(folder / FILE_NAME)
    done = {int(r["step"]) for r in records.of("step")}
    times = len(records.of("devices"))
    return tuple(replace(s, mounting=s.mounting + REMOUNTED * times) for s in schedule(plan) if s.step not in done)


def run_sweep(request: SweepRequest, store: Store, watcher: Watcher,
              interrupts: Interrupts) -> tuple[dict[str, Any], Run]:
    """Run, or go on with, a sweep; returns its summary and run folder.

    Raises:
        UsageError: bad input that showed before anything was measured; no run is left behind.
    """
    plan = request.plan
    if request.resume is None:
        run = store.create("sweep", plan.name, **request.inputs)
        steps: Sequence[Step] = schedule(plan)
    else:
        found = read_run(request.resume)
        if found is None:
            raise UsageError(f"{request.resume}: has no readable run.json: it cannot be resumed")
        run, steps = found, steps_left(request.resume, plan)
    header = {"run_kind": "sweep", "run": str(run.folder), "plan": plan.model_dump(mode="json"),
              "plan_hash": plan_hash(plan), "versions": versions(), "git": git_state(), **request.inputs}
    state = "finished"
    with open_journal(run.folder / FILE_NAME, **header) as journal:
        if request.resume is not None:
            journal.append("resumed", steps_left=len(steps), git=git_state(), versions=versions())
        try:
            _run(request, run, steps, journal, watcher, interrupts)
        except Interrupted:
            state = "interrupted"
            journal.append("interrupted", signal=interrupts.signal_name)
        except UsageError as error:
            if request.resume is None and not read_journal(journal.path).of("step"):
                store.discard(run)
                raise
            state = "failed"
            journal.append("error", type=type(error).__name__, error=str(error), exit_code=error.exit_code)
        except BenchError as error:
            state = "failed"
            journal.append("error", type=type(error).__name__, error=str(error), exit_code=error.exit_code)
        except Exception as error:
            state = "crashed"
            crash = run.folder / CRASH_FILE
            crash.write_text(traceback.format_exc(), encoding="utf-8")
            journal.append("error", type=type(error).__name__,
                           error=f"unexpected {type(error).__name__}: {error}; the traceback is in {crash}")
        journal.append("end", state=state)
    return close_sweep(store, run, state), run


def _run(request: SweepRequest, run: Run, steps: Sequence[Step], journal: Journal, watcher: Watcher,
         interrupts: Interrupts) -> None:
    if not steps:
        return
    bench = request.make_bench(run.folder, _next_recording(run.folder))
    stand = StandFile(run.folder / "stand.csv")
    try:
        info = bench.open()
        roles = [s["role"] for s in info.rig["sensors"] if s["role"]]
        journal.append("devices", origin=info.origin, rig=info.rig, stand=info.stand)
        Runner(request.plan, steps, bench, journal, stand, info.origin, watcher, interrupts.asked, roles).run()
    finally:
        # The throttle first, whatever it was that ended the run.
        report = bench.stop()
        try:
            journal.append("stopped", report=report)
            journal.append("counters", counters=bench.counters())
        finally:
            bench.close()
            stand.close()


def _next_recording(folder: Path) -> Path:
    """echoes.mcap, and echoes-2.mcap, ... after resumptions: recordings are never overwritten."""
    path, number = folder / "echoes.mcap", 1
    while path.exists():
        number += 1
        path = folder / f"echoes-{number}.mcap"
    return path


def close_sweep(store: Store, run: Run, state: str) -> dict[str, Any]:
    """Summary, noise models and the index entry, all from the journal."""
    summary = rebuild_sweep(run.folder)
    losses = {n: round(x["value"], 2) for n, x in summary["insertion_loss_db"].items() if x["value"] is not None}
    store.finish(run, state, summary["verdict"], {"steps": summary["metrics"]["steps"], "insertion_loss_db": losses,
                                                  "origin": summary["origin"]})
    return summary


def rebuild_sweep(folder: Path) -> dict[str, Any]:
    """`summary.json` and `noise-model-*.toml` anew from the journal alone; returns the summary.

    Raises:
        UsageError: no sweep there.
    """
    sweep = read_sweep(folder)
    summary = summarise_sweeps([sweep])
    models: dict[str, str] = {}
    try:
        models = {name: path.name for name, path in write_models(
            folder, summary["analysis"], sweep.plan.conditions, sweep.origin, source_text(sweep),
            sweep.plan.hub_distance_m).items()}
    except UsageError as error:
        summary["errors"].append(f"no noise model for flights: {error}")
    del summary["analysis"]
    summary["noise_models"] = models
    write_json(folder / SUMMARY_FILE, summary)
    return summary


def exit_code_of(summary: dict[str, Any]) -> int:
    """130 interrupted, else by the verdict."""
    return 130 if summary["state"] == "interrupted" else Verdict(summary["verdict"]).exit_code
