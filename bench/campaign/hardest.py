"""`campaign --hardest`: the search with its journal, so that it goes on after a kill, and what it keeps.

The search asks for flights; those that the journal has already are answered from there. As it is deterministic, going
on means running it again: nothing is flown twice.
"""

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.campaign.flying import Task
from bench.campaign.identity import identity_of
from bench.campaign.runner import MakeWorkers, Say, reopen
from bench.campaign.scene_file import scene_text
from bench.campaign.search import Course, Flight, Score, Search, badness
from bench.campaign.workers import Done, Workers
from bench.flight_summary import NOT_JUDGED
from bench.interrupt import Interrupts
from bench.journal import FILE_NAME, Journal, open_journal, read_journal
from bench.provenance import git_state, versions
from bench.store import Run, Store, write_json
from saranga.errors import BenchError, UsageError
from sitl.scene import load_scene
from sitl.trial_types import TrialRequest

RUN_KIND = "hardest"
COURSES = "courses"


@dataclass(frozen=True)
class HardestPlan:
    """`request`: family, seed of its first course, and who flies; `rule` "strict" or "lenient" says what a success is;
    `keep`: where the course goes besides the run folder."""

    request: TrialRequest
    budget: int
    rule: str
    make_workers: MakeWorkers
    keep: Path | None = None
    argv: tuple[str, ...] = ()

    def asked(self) -> dict[str, Any]:
        """What must be the same to go on."""
        return {"request": self.request.to_dict(), "budget": self.budget, "rule": self.rule}


class _Stopped(Exception):
    """The operator wants to stop."""


def plan_of(folder: Path, make_workers: MakeWorkers, keep: Path | None, argv: tuple[str, ...]) -> HardestPlan:
    """The plan that a run was begun with.

    Raises:
        UsageError: no readable journal of a search.
    """
    header = read_journal(folder / FILE_NAME).header
    if header.get("run_kind") != RUN_KIND:
        raise UsageError(f"--resume {folder}: that run is not a search for the hardest course")
    asked = header["asked"]
    request = TrialRequest(**{k: v for k, v in asked["request"].items() if k != "faults"})
    return HardestPlan(request, asked["budget"], asked["rule"], make_workers, keep, argv)


def find_hardest(plan: HardestPlan, store: Store, interrupts: Interrupts, say: Say,
                 resume: Path | None = None) -> dict[str, Any]:
    """Search, keep the course, return the summary.

    Raises:
        UsageError: a scene that has no family, a budget too small, or the run to resume was another one.
    """
    spec = load_scene(plan.request.scene)
    Search(spec, plan.budget, plan.request.seed, lambda _, __: {}, lambda _: None)  # refuses before anything is made
    identity = {"asked": plan.asked(), **identity_of([plan.request])}
    run = (store.create(RUN_KIND, plan.request.scene, argv=list(plan.argv), **plan.asked()) if resume is None
           else reopen(resume, RUN_KIND, identity))
    state, started = "finished", time.monotonic()
    with open_journal(run.folder / FILE_NAME, run_kind=RUN_KIND, run=str(run.folder), **identity, versions=versions(),
                      git=git_state(), argv=list(plan.argv)) as journal:
        flights = _Flights(plan, run, journal, interrupts, say)
        try:
            with contextlib.closing(flights):
                found = Search(spec, plan.budget, plan.request.seed, flights.fly, flights.add).run()
            journal.append("found", **{**asdict(found), "course": {
                "key": found.course.key, "traversability": round(found.course.traversability, 3)}})
        except _Stopped:
            state = "interrupted"
            journal.append("interrupted", signal=interrupts.signal_name)
        except BenchError as error:
            state = "crashed"
            journal.append("error", type=type(error).__name__, error=str(error))
        except Exception as error:
            state = "crashed"
            journal.append("error", type=type(error).__name__, error=f"unexpected {type(error).__name__}: {error}")
        journal.append("end", state=state, wall_s=round(time.monotonic() - started, 3))
    from bench.campaign.hardest_summary import rebuild_hardest

    summary = rebuild_hardest(run.folder)
    if summary["found"] is not None and plan.keep is not None:
        text = Path(summary["scene_file"]).read_text(encoding="utf-8")
        try:
            plan.keep.write_text(text, encoding="utf-8")
        except OSError as error:
            raise BenchError(f"--keep {plan.keep}: cannot be written ({error.strerror}); the course is safe in "
                             f"{summary['scene_file']}") from error
    publish_hardest(run.folder, summary, say)
    store.finish(run, state, summary["verdict"], {"outcomes": [], "autopilot": plan.request.autopilot,
                                                  "trials": summary["metrics"]["flights"]})
    return summary


def publish_hardest(folder: Path, summary: dict[str, Any], say: Say) -> None:
    """The page; one that cannot be drawn fails no search."""
    from bench.hardest_page import write_hardest_page

    try:
        write_hardest_page(folder, summary)
    except Exception as error:
        say(f"no page ({type(error).__name__}: {error}): `saranga-bench report {folder}` tries again")


class _Flights:
    """Makes the flights a search asks for, or remembers them."""

    def __init__(self, plan: HardestPlan, run: Run, journal: Journal, interrupts: Interrupts, say: Say) -> None:
        self._plan, self._run, self._journal = plan, run, journal
        self._interrupts, self._say = interrupts, say
        self._workers: Workers | None = None
        self._texts: dict[str, str] = {}
        self._spec = load_scene(plan.request.scene)
        self._started = time.monotonic()
        self._flown_now = 0
        self._known = {Flight(r["course"], r["seed"]): r["result"] for r in read_journal(journal.path).of("flight")
                       if r["result"] is not None and r["result"]["outcome"] not in NOT_JUDGED}
        self._done = len(self._known)

    def close(self) -> None:
        if self._workers is not None:
            self._workers.close()

    def add(self, course: Course) -> None:
        """Write a course down; its file is what flies it again."""
        text = scene_text(course.scene, self._spec, f"{self._spec.name} {course.key}",
                          f"course {course.key} of the search for the hardest of {self._spec.name}, traversability "
                          f"{course.traversability:.1f}")
        self._texts[course.key] = text
        path = self._path(course.key)
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def _path(self, key: str) -> Path:
        return self._run.folder / COURSES / f"{key}.toml"

    def fly(self, stage: str, flights: Sequence[Flight]) -> Mapping[Flight, Score]:
        """See `search.Fly`."""
        missing = [f for f in flights if f not in self._known]
        if missing and self._workers is None:
            self._workers = self._plan.make_workers()
        tasks = [Task(f.course, self._request(f), self._texts[f.course]) for f in missing]
        if tasks:
            assert self._workers is not None
            for done in self._workers.run(tasks, self._interrupts.asked):
                self._keep(stage, done, fresh=stage.startswith("fresh"))
        if self._interrupts.asked():
            raise _Stopped
        return {f: self._score(self._known[f]) for f in flights if f in self._known}

    def _request(self, flight: Flight) -> TrialRequest:
        from dataclasses import replace

        return replace(self._plan.request, scene=str(self._path(flight.course)), seed=flight.seed)

    def _keep(self, stage: str, done: Done, fresh: bool) -> None:
        flight = Flight(done.task.row, done.task.request.seed)
        result = done.flown.result if done.flown is not None else None
        files: dict[str, str] = {}
        if done.flown is not None and fresh:
            path = self._run.folder / "trials" / f"{flight.course}-{flight.seed}.json"
            path.parent.mkdir(exist_ok=True)
            write_json(path, {"request": done.task.request.to_dict(), "result": result, "scene": done.flown.scene,
                              "track": done.flown.track})
            files["trial"] = str(path.relative_to(self._run.folder))
        for why in done.lost:
            self._journal.append("warning", text=f"{flight.course} seed {flight.seed}: flown again, because {why}")
        self._journal.append("flight", stage=stage, course=flight.course, seed=flight.seed, result=result,
                             error=done.error, files=files, request=done.task.request.to_dict())
        if result is not None and result["outcome"] not in NOT_JUDGED:
            self._known[flight] = result
        self._done += 1
        self._flown_now += 1
        left = max(self._plan.budget - self._done, 0)
        left_s = (time.monotonic() - self._started) / self._flown_now * left
        outcome = result["outcome"] if result else f"infrastructure: {done.error}"
        self._say(f"{self._done}/{self._plan.budget}  {stage}: {flight.course} flight seed {flight.seed}: {outcome}   "
                  f"about {left_s / 60:.1f} min left")

    def _score(self, result: dict[str, Any]) -> Score:
        success = result[f"success_{self._plan.rule}"] is True
        return Score(success, badness(success, result.get("min_clearance_m")))
