"""Flying a suite into a run folder: every finished trial is on disk before the next is waited for."""

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.baseline.inputs import world_inputs
from bench.campaign.behaviour import behaviour_of
from bench.campaign.flying import Task
from bench.campaign.identity import identity_of
from bench.campaign.suite import Suite, parse_suite
from bench.campaign.summary import rebuild_campaign
from bench.campaign.workers import Done, Workers
from bench.flight_summary import NOT_JUDGED
from bench.interrupt import Interrupts
from bench.journal import FILE_NAME, Journal, open_journal, read_journal
from bench.provenance import git_state, versions
from bench.step_summary import publish_step_summary
from bench.store import Run, Store, read_run, write_json
from saranga.errors import UsageError

RUN_KIND = "campaign"
WHAT = {"suite": "the suite", "weights": "the network's weights", "sources": "what flies (sources or fixtures)",
        "asked": "what was asked for"}
Say = Callable[[str], None]
MakeWorkers = Callable[[], Workers]


@dataclass(frozen=True)
class Plan:
    """A suite and who flies it; `argv` is kept for the record."""

    suite: Suite
    make_workers: MakeWorkers
    argv: tuple[str, ...] = ()


def tasks_of(suite: Suite) -> list[Task]:
    """All trials, first seeds of all rows first, so that an early end has something of every row."""
    found = [(k, index, Task(row.name, suite.request(row, seed)))
             for index, row in enumerate(suite.rows) for k, seed in enumerate(suite.seeds(row))]
    return [task for _, _, task in sorted(found, key=lambda item: item[:2])]


def run_campaign(plan: Plan, store: Store, interrupts: Interrupts, say: Say,
                 resume: Path | None = None) -> dict[str, Any]:
    """Fly what the suite asks for and is not flown yet; returns the summary.

    Args:
        resume: folder of a campaign to go on with.

    Raises:
        UsageError: the campaign to resume was another one (suite, weights or sources have changed).
    """
    identity = _identity(plan.suite)
    if resume is None:
        run = store.create(RUN_KIND, plan.suite.head.name, argv=list(plan.argv), suite=plan.suite.to_dict())
    else:
        run = reopen(resume, RUN_KIND, identity)
    flown = _flown(run.folder) if resume else set()
    tasks = [task for task in tasks_of(plan.suite) if task.key not in flown]
    state, started = "finished", time.monotonic()
    with open_journal(run.folder / FILE_NAME, run_kind=RUN_KIND, run=str(run.folder), **identity,
                      versions=versions(), git=git_state(), argv=list(plan.argv),
                      inputs=world_inputs(plan.suite.request(row, 0) for row in plan.suite.rows)) as journal:
        try:
            if tasks:
                workers = plan.make_workers()
                with contextlib.closing(workers):
                    journal.append("session", workers=workers.count, missing=len(tasks))
                    _fly(run, journal, workers, tasks, len(flown), interrupts, say)
        except UsageError:
            if not flown and not read_journal(journal.path).of("trial"):
                store.discard(run)
            raise
        except Exception as error:
            state = "crashed"
            journal.append("error", type=type(error).__name__, error=f"unexpected {type(error).__name__}: {error}")
        if interrupts.asked():
            state = "interrupted"
            journal.append("interrupted", signal=interrupts.signal_name)
        journal.append("end", state=state, wall_s=round(time.monotonic() - started, 3))
    summary = rebuild_campaign(run.folder)
    publish_campaign(run.folder, summary, say)
    store.finish(run, state, summary["verdict"], {
        "outcomes": [], "autopilot": summary["provenance"]["autopilot"]["kind"],
        **{key: summary["metrics"][key] for key in ("trials", "success_rate_strict", "aggregate_realtime_factor")}})
    return summary


def _fly(run: Run, journal: Journal, workers: Workers, tasks: list[Task], before: int,
         interrupts: Interrupts, say: Say) -> None:
    started, passed = time.monotonic(), 0
    for done_count, done in enumerate(workers.run(tasks, interrupts.asked), start=1):
        _keep(run.folder, journal, done)
        result = done.flown.result if done.flown else None
        passed += bool(result and result["success_strict"])
        left_s = (time.monotonic() - started) / done_count * (len(tasks) - done_count)
        outcome = result["outcome"] if result else f"infrastructure: {done.error}"
        label = f" ({result['label']})" if result and result["label"] not in (None, outcome) else ""
        say(f"{before + done_count}/{before + len(tasks)}  {done.task.row} seed {done.task.request.seed}: {outcome}"
            f"{label}   {passed} clean of {done_count}, {left_s / 60:.1f} min left")


def _keep(folder: Path, journal: Journal, done: Done) -> None:
    """Files first, then the record that says they are there."""
    task, flown = done.task, done.flown
    for why in done.lost:
        journal.append("warning", text=f"{task.row} seed {task.request.seed}: flown again, because {why}")
    stem = f"{task.row}-{task.request.seed}"
    files: dict[str, str] = {}
    if flown is None:
        journal.append("trial", row=task.row, seed=task.request.seed, request=task.request.to_dict(), result=None,
                       error=done.error, files=files)
        return
    for name, data in flown.files.items():
        path = folder / "failures" / f"{stem}-{name}"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        files[name.partition(".")[0]] = str(path.relative_to(folder))
    trial = folder / "trials" / f"{stem}.json"
    trial.parent.mkdir(exist_ok=True)
    write_json(trial, {"request": task.request.to_dict(), "result": flown.result, "scene": flown.scene,
                       "track": flown.track})
    files["trial"] = str(trial.relative_to(folder))
    journal.append("trial", row=task.row, seed=task.request.seed, request=task.request.to_dict(), result=flown.result,
                   traversability=flown.traversability, worker=flown.worker, memory_mb=flown.memory_mb, files=files)


def _identity(suite: Suite) -> dict[str, Any]:
    """What must be the same for two sessions to belong together."""
    requests = [suite.request(row, 0) for row in suite.rows]
    return {"suite": suite.to_dict(), **identity_of(requests)}


def reopen(folder: Path, kind: str, identity: dict[str, Any]) -> Run:
    """A run to go on with.

    Raises:
        UsageError: it is of another kind, was begun otherwise, or flew other sources or weights.
    """
    header = read_journal(folder / FILE_NAME).header
    if header.get("run_kind") != kind:
        raise UsageError(f"--resume {folder}: that run is not a {kind}")
    for key, then in identity.items():
        if header.get(key) != then:
            raise UsageError(f"--resume {folder}: {WHAT.get(key, key)} changed since ({header.get(key)!s:.80} then, "
                             f"{then!s:.80} now): start anew, or go back to what was flown")
    run = read_run(folder)
    if run is None:
        raise UsageError(f"--resume {folder}: its run.json cannot be read")
    run.info.update(pid=os.getpid(), state="running")
    return run


def suite_of(folder: Path) -> Suite:
    """The suite a campaign was flown with, from its journal.

    Raises:
        UsageError: no readable journal of a campaign.
    """
    header = read_journal(folder / FILE_NAME).header
    if header.get("run_kind") != RUN_KIND:
        raise UsageError(f"{folder}: that run is not a campaign")
    return parse_suite(header["suite"], folder / FILE_NAME)


def _flown(folder: Path) -> set[tuple[str, int]]:
    """Trials that count: what broke off or was interrupted is flown again by --resume."""
    return {(r["row"], r["seed"]) for r in read_journal(folder / FILE_NAME).of("trial")
            if r.get("result") is not None and (r["result"]["outcome"] not in NOT_JUDGED
                                                or behaviour_of(r["result"]) in ("held", "lost"))}


def publish_campaign(folder: Path, summary: dict[str, Any], say: Say) -> None:
    """JUnit, the summary of a CI step, and the page; a page that cannot be drawn fails no flight."""
    from bench.campaign_junit import write_campaign_junit
    from bench.campaign_markdown import markdown_summary
    from bench.campaign_page import write_campaign_page

    for what, make in (
        ("JUnit", lambda: write_campaign_junit(folder / "junit.xml", summary)),
        ("summary", lambda: publish_step_summary(folder, markdown_summary(summary))),
        ("page", lambda: write_campaign_page(folder)),
    ):
        try:
            make()
        except Exception as error:
            say(f"no {what} ({type(error).__name__}: {error}): `saranga-bench report {folder}` tries again")
