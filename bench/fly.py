"""Flying trials one after another into a run folder: `saranga-bench fly` and the pytest plugin use this."""

import contextlib
import shutil
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.baseline.inputs import world_inputs
from bench.flight_markdown import flight_summary_markdown
from bench.flight_summary import METRIC_UNITS, limit_to_dict, summarise, trial_verdict
from bench.interrupt import Interrupts
from bench.journal import FILE_NAME, Journal, open_journal, read_journal
from bench.provenance import git_state, sha256_of, versions
from bench.spare import stack_threads
from bench.step_summary import publish_step_summary
from bench.store import Run, Store, write_json
from bench.terminal import Reporter
from bench.verdict import Limit, find_limits, load_limits
from saranga.errors import BenchError, UsageError
from saranga.fixtures import fixture_path
from saranga.numba_cache import is_cold
from saranga.plugins import user_source
from sitl.acoustics.shield import shield_path
from sitl.importers import scene_path, scene_tables
from sitl.trial_types import TrialProgress, TrialRequest, TrialResult

AUTOPILOTS = ("embedded", "arducopter")
SUMMARY_FILE = "summary.json"
CRASH_FILE = "crash.txt"

Progress = Callable[[TrialProgress], None]
Runner = Callable[[TrialRequest, Progress | None, Callable[[], bool] | None], TrialResult]


@dataclass(frozen=True)
class FlyPlan:
    """What to fly: `request` with each of `seeds`, held to `limits`; `record` writes Rerun recordings.

    `runner` flies a trial in another way than `live` says; `hil` goes to the journal's header (`bench.hil.summary`).
    """

    request: TrialRequest
    seeds: tuple[int, ...]
    limits: tuple[Limit, ...] = ()
    limits_file: Path | None = None
    live: bool = False
    record: bool = True
    argv: tuple[str, ...] = ()
    runner: Runner | None = None
    hil: dict[str, Any] | None = None


def make_plan(
    request: TrialRequest,
    trials: int,
    limits: str | None = None,
    live: bool = False,
    record: bool = True,
    argv: tuple[str, ...] = (),
) -> FlyPlan:
    """Check what can be checked without flying.

    Raises:
        UsageError: unknown scene, limits or autopilot, malformed files, or no trials.
    """
    if trials < 1:
        raise UsageError(f"--trials {trials}: at least 1")
    if request.seed < 0:
        raise UsageError(f"--seed {request.seed}: not negative")
    if request.autopilot not in AUTOPILOTS:
        raise UsageError(f"unknown autopilot {request.autopilot!r}: known are {', '.join(AUTOPILOTS)}")
    scene_tables(scene_path(request.scene))
    name = limits if limits is not None else find_limits(request.scene)
    found = load_limits(name, known_metrics=tuple(METRIC_UNITS)) if name is not None else []
    file = fixture_path("limits", name) if name is not None else None
    return FlyPlan(request, tuple(range(request.seed, request.seed + trials)), tuple(found), file, live, record, argv)


def fly(plan: FlyPlan, store: Store, reporter: Reporter, interrupts: Interrupts) -> tuple[dict[str, Any], Run]:
    """Fly the plan; every finished trial is on disk before the next begins.

    Returns:
        The summary (see `flight_summary`) and the run.

    Raises:
        UsageError: bad input that only showed at the first flight; no run is left behind.
    """
    run = store.create(
        "fly" if plan.hil is None else "hil",
        plan.request.scene,
        argv=list(plan.argv),
        request=plan.request.to_dict(),
        seeds=list(plan.seeds),
        versions=versions(),
        git=git_state(),
        sha256=input_hashes(plan.request, plan.limits_file),
    )
    state = "finished"
    with open_journal(run.folder / FILE_NAME, **_header(plan, run)) as journal:
        try:
            state = _fly_all(plan, run, journal, reporter, interrupts)
        except UsageError as error:
            if not read_journal(journal.path).of("trial"):
                store.discard(run)
                raise
            _note_error(journal, error)
        except BenchError as error:
            _note_error(journal, error)
        except Exception as error:
            state = "crashed"
            crash = run.folder / CRASH_FILE
            crash.write_text(traceback.format_exc(), encoding="utf-8")
            journal.append(
                "error",
                type=type(error).__name__,
                error=f"unexpected {type(error).__name__}: {error}; the traceback is in {crash}",
            )
        journal.append("end", state=state)
    summary = close_run(store, run, state)
    if plan.record:
        _write_page(run.folder, reporter)
    return summary, run


def _write_page(folder: Path, reporter: Reporter) -> None:
    """The page can be made again from the run folder, so failing to make it fails no flight."""
    from bench.flight_page import write_page

    try:
        write_page(folder)
    except Exception as error:
        reporter.note(f"no report page ({type(error).__name__}: {error}): `saranga-bench report {folder}` tries again")


def _fly_all(plan: FlyPlan, run: Run, journal: Journal, reporter: Reporter, interrupts: Interrupts) -> str:
    if is_cold():
        reporter.note("compiling kernels, about half a minute: once after an installation or a change of the sources")
    runner = plan.runner or find_runner(plan.live)
    threads = stack_threads()
    for seed in plan.seeds:
        if interrupts.asked():
            break
        reporter.begin(seed)
        request = replace(plan.request, seed=seed, workdir=run.folder / f"autopilot-{seed}", stack_threads=threads)
        assert request.workdir is not None
        request.workdir.mkdir()
        result = runner(request, reporter.progress, interrupts.asked)
        reporter.finish(result, trial_verdict(result.to_dict()))
        keep_flight(run.folder, journal, request, result, plan.record, reporter.note)
    if interrupts.asked():
        journal.append("interrupted", signal=interrupts.signal_name)
        return "interrupted"
    return "finished"


def find_runner(live: bool) -> Runner:
    """`run_trial` of lockstep or of live flights, imported only now as it brings the whole simulator.

    Raises:
        UsageError: live flights are not part of this installation.
    """
    if not live:
        from sitl.trial import run_trial

        return run_trial
    try:
        from sitl.live import run_live_trial
    except ImportError as error:
        raise UsageError(f"--live: live flights are not part of this installation ({error})") from error
    return run_live_trial


def keep_flight(
    folder: Path,
    journal: Journal,
    request: TrialRequest,
    result: TrialResult,
    record: bool,
    note: Callable[[str], None],
) -> None:
    """Journal the outcome, then save the flight's log, recording and autopilot log beside it.

    What happened is on disk before anything is drawn; a recording that fails is a warning, not a lost flight.
    """
    journal.append(
        "trial",
        seed=result.seed,
        verdict=trial_verdict(result.to_dict()).value,
        request=request.to_dict(),
        result=result.to_dict(),
    )
    stem = f"flight-{result.seed}"
    if (folder / f"{stem}.npz").exists():  # the same seed again in one run (pytest): keep both
        stem += f"-{sum(1 for _ in folder.glob(f'{stem}*.npz'))}"
    files = {name: _into(folder, Path(path), f"{stem}-{name}") for name, path in result.files.items()}
    try:
        if result.log is not None:
            files["log"] = result.log.save(folder / f"{stem}.npz").name
            if record:
                from bench.rerun_log import record_flight

                files["recording"] = Path(record_flight(result.log, result, folder / f"{stem}.rrd")).name
    except Exception as error:
        text = f"seed {result.seed}: the flight could not be drawn ({type(error).__name__}: {error})"
        journal.append("warning", text=text)
        note(text)
    if request.workdir is not None and request.workdir.is_dir():
        for number, log in enumerate(sorted(request.workdir.glob("logs/*.[Bb][Ii][Nn]"))):
            name = f"{stem}.bin" if number == 0 else f"{stem}-{number}.bin"
            shutil.move(log, folder / name)
            files["dataflash" if number == 0 else f"dataflash_{number}"] = name
        with contextlib.suppress(OSError):  # an autopilot that wrote nothing leaves an empty folder
            request.workdir.rmdir()
    journal.append("files", seed=result.seed, files=files)
    result.files = {name: str(folder / path) for name, path in files.items()}


def close_run(store: Store, run: Run, state: str) -> dict[str, Any]:
    """Rebuild the summary from the journal, write it beside it (JSON, JUnit) and close the run."""
    summary = rebuild(run.folder)
    kinds = dict.fromkeys(o["autopilot"]["kind"] for o in summary["outcomes"])
    short = {
        "outcomes": [o["outcome"] for o in summary["outcomes"]],
        "autopilot": ", ".join(kinds) or summary["provenance"]["autopilot"]["kind"],
        **{k: summary["metrics"][k] for k in ("trials", "success_rate_strict", "realtime_factor")},
    }
    store.finish(run, state, summary["verdict"], short)
    with contextlib.suppress(OSError):
        publish_step_summary(run.folder, flight_summary_markdown(summary, run.info.get("title") or run.folder.name))
    return summary


def rebuild(folder: Path) -> dict[str, Any]:
    """Make `summary.json` and `junit.xml` of a run anew from its journal alone; returns the summary.

    Raises:
        UsageError: the folder has no readable journal of flights.
    """
    from bench.junit import write_junit

    journal = read_journal(folder / FILE_NAME)
    if journal.header.get("run_kind") not in ("fly", "test"):
        raise UsageError(f"{folder}: its journal is not one of flights")
    summary = summarise(journal)
    write_json(folder / SUMMARY_FILE, summary)
    write_junit(folder / "junit.xml", summary)
    return summary


def _into(folder: Path, path: Path, name: str) -> str:
    """A file the trial left, relative to the run folder; copied in when it lies outside."""
    try:
        return str(path.resolve().relative_to(folder.resolve()))
    except ValueError:
        if not path.is_file():
            return str(path)
        return Path(shutil.copy(path, folder / (name + path.suffix))).name


def _note_error(journal: Journal, error: BenchError) -> None:
    journal.append("error", type=type(error).__name__, error=str(error), exit_code=error.exit_code)


def _header(plan: FlyPlan, run: Run) -> dict[str, Any]:
    return {
        "run_kind": "fly",
        "run": str(run.folder),
        "request": plan.request.to_dict(),
        "seeds": list(plan.seeds),
        "live": plan.live,
        **({"hil": plan.hil} if plan.hil is not None else {}),
        "limits": [limit_to_dict(limit) for limit in plan.limits],
        "limits_file": str(plan.limits_file) if plan.limits_file else None,
        "versions": versions(),
        "git": git_state(),
        "sha256": input_hashes(plan.request, plan.limits_file),
        "inputs": world_inputs([plan.request]),
        "argv": list(plan.argv),
    }


def _input_path(kind: str, item: str) -> Path:
    if kind == "shields":
        return shield_path(item)
    return scene_path(item) if kind == "scenes" else fixture_path(kind, item)


def input_hashes(request: TrialRequest, limits_file: Path | None = None) -> dict[str, str]:
    """SHA-256 of the data files the flights depend on, those that exist, and of the user's own MODULE:NAME."""
    files = {
        "scene": ("scenes", request.scene),
        "shield": ("shields", request.shield),
        "sonar": ("sonars", request.sonar),
    }
    found = {}
    for name, (kind, item) in files.items():
        try:
            found[name] = sha256_of(_input_path(kind, item))
        except (UsageError, OSError):  # an unknown name is reported by the trial, which knows what it needs
            continue
    for name, item in (("stack", request.stack), ("denoiser", request.denoiser)):
        source = user_source(item)
        if source is not None:
            found[name] = sha256_of(source)
    if limits_file is not None:
        found["limits"] = sha256_of(limits_file)
    return found
