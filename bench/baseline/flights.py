"""The flights of two runs, read from their journals and paired by row, scene, autopilot and seed."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.baseline.inputs import TOLD, differences
from bench.campaign.behaviour import behaviour_of
from bench.flight_summary import NOT_JUDGED
from bench.journal import FILE_NAME, read_journal
from saranga.errors import UsageError
from sitl.trial_types import TrialRequest

KINDS = ("fly", "campaign")
SAME = ("shield", "sonar", "max_sim_s")
"""Of the request: what surrounds the stack. Stack, denoiser and planted faults may differ, and that is told."""
MAY_DIFFER = ("stack", "denoiser", "faults")

Key = tuple[str, str, str, int]
Result = dict[str, Any]


@dataclass(frozen=True)
class Flights:
    """One run: results and requests by (row, scene, autopilot, seed); `inputs` are hashes of its world."""

    folder: Path
    results: Mapping[Key, Result]
    requests: Mapping[Key, dict[str, Any]]
    inputs: Mapping[str, str]

    def judged(self, key: Key) -> bool:
        """Whether the flight says something: with a fault planted, a stack that named it and held does."""
        result = self.results[key]
        if result["outcome"] not in NOT_JUDGED:
            return True
        return bool(self.requests[key].get("faults")) and behaviour_of(result) != "broken"


@dataclass(frozen=True)
class Pairs:
    """`keys` flown and judged in both, `run` and `baseline` in that order; `broken`: flights of the run that broke off;
    `notes`: what differs by intent and what was left out."""

    keys: tuple[Key, ...]
    run: tuple[Result, ...]
    baseline: tuple[Result, ...]
    broken: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)


def read_flights(folder: Path) -> Flights:
    """Flights of a run of `fly` or `campaign`; one flown again counts as it ended last.

    Raises:
        UsageError: no readable journal of flights, or one that does not say what its world was.
    """
    journal = read_journal(folder / FILE_NAME)
    kind = journal.header.get("run_kind")
    if kind not in KINDS:
        raise UsageError(f"{folder}: a run of kind {kind!r} cannot be compared; give one of {' or '.join(KINDS)}")
    inputs = journal.header.get("inputs")
    if not inputs:
        raise UsageError(f"{folder}: its journal does not say with which scene, shield and sonar it was flown "
                         "(an older version wrote it): fly it again")
    results: dict[Key, Result] = {}
    requests: dict[Key, dict[str, Any]] = {}
    for record in journal.of("trial"):
        request = record["request"]
        key = (record.get("row") or "", request["scene"], request["autopilot"], record["seed"])
        broke = {"outcome": "infrastructure", "cause": record.get("error") or "no result"}
        results[key], requests[key] = record["result"] or broke, request
    if not results:
        raise UsageError(f"{folder}: no flight in it was finished: there is nothing to compare")
    return Flights(folder, results, requests, inputs)


def check_worlds(run: Mapping[str, str], baseline: Mapping[str, str], where: Path) -> list[str]:
    """The same world? Returns notes.

    Raises:
        UsageError: a scene, shield, sonar, airframe, material or parameter file has changed between the runs.
    """
    changed = differences(run, baseline)
    wrong = [key for key in changed if key not in TOLD]
    if wrong:
        raise UsageError(f"{', '.join(wrong)} changed since baseline {where} was flown: what differs would be the "
                         "world and not the stack. Fly the baseline again with these files, or bring the old ones back")
    return [f"{key} differ between the runs" for key in changed]


def check_requests(requests: Iterable[TrialRequest], baseline: Flights) -> None:
    """What is to be flown can be compared: refuse before flying rather than after.

    Raises:
        UsageError: a scene that the baseline did not fly on that autopilot, or only with another shield or sonar.
    """
    for request in requests:
        wanted = request.to_dict()
        known = [found for key, found in baseline.requests.items() if key[1:3] == (request.scene, request.autopilot)]
        if not known:
            raise UsageError(f"baseline {baseline.folder} has no flight of {request.scene} on {request.autopilot}: fly "
                             "one there first")
        if not any(all(wanted[name] == found.get(name) for name in SAME) for found in known):
            _same(f"scene {request.scene}", wanted, known[0])


def pair(run: Flights, baseline: Flights) -> Pairs:
    """Flights that both have.

    Raises:
        UsageError: another world, another shield, sonar or firmware, or no flight in common.
    """
    notes = check_worlds(run.inputs, baseline.inputs, baseline.folder)
    common = sorted(run.results.keys() & baseline.results.keys())
    if not common:
        raise UsageError(f"{run.folder} and {baseline.folder} have no flight in common (scene, autopilot and seed): "
                         "fly the same ones, or compare different seeds with --unpaired")
    for key in common:
        _check_request(key, run, baseline)
    notes += _intended(common, run, baseline)
    alone = len(run.results) + len(baseline.results) - 2 * len(common)
    if alone:
        notes.append(f"{alone} flights that only one of the runs has were left out")
    broken = tuple(f"seed {k[3]}{' of ' + k[0] if k[0] else ''}: {run.results[k]['outcome']}, "
                   f"{run.results[k].get('cause')}" for k in common if not run.judged(k))
    judged = [k for k in common if run.judged(k)]
    kept = tuple(k for k in judged if baseline.judged(k))
    if len(kept) < len(judged):
        notes.append(f"{len(judged) - len(kept)} flights that broke off in the baseline were left out")
    return Pairs(kept, tuple(run.results[k] for k in kept), tuple(baseline.results[k] for k in kept), broken,
                 tuple(notes))


def unpaired(run: Flights, baseline: Flights) -> tuple[list[Result], list[Result], tuple[str, ...], tuple[str, ...]]:
    """All judged flights of both, what broke off in the run, and notes.

    Raises:
        UsageError: another world; other scenes or autopilots; or the same seeds, which would be pairs.
    """
    notes = check_worlds(run.inputs, baseline.inputs, baseline.folder)
    kinds = [{key[:3] for key in flights.results} for flights in (run, baseline)]
    if kinds[0] != kinds[1]:
        raise UsageError(f"{run.folder} and {baseline.folder} flew different rows, scenes or autopilots: only the "
                         "seeds may differ")
    if run.results.keys() & baseline.results.keys():
        raise UsageError("--unpaired is for runs over different seeds, and these share some: leave it out, pairs tell "
                         "more")
    first = {key[:3]: key for key in baseline.results}
    for key, request in run.requests.items():
        _same(f"row {key[0] or key[1]}", request, baseline.requests[first[key[:3]]])
    judged = [[r for k, r in flights.results.items() if flights.judged(k)] for flights in (run, baseline)]
    broken = tuple(f"seed {k[3]}: {r['outcome']}, {r.get('cause')}" for k, r in run.results.items()
                   if not run.judged(k))
    return judged[0], judged[1], broken, tuple(notes)


def _check_request(key: Key, run: Flights, baseline: Flights) -> None:
    _same(f"seed {key[3]}", run.requests[key], baseline.requests[key])
    ours, theirs = (f.results[key].get("autopilot") or {} for f in (run, baseline))
    if ours and theirs and ours != theirs:
        raise UsageError(f"autopilot {' '.join(map(str, ours.values()))} here, {' '.join(map(str, theirs.values()))} "
                         f"in {baseline.folder}: what differs would be the firmware. Fly both with the same one")


def _same(where: str, ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> None:
    for name in SAME:
        if ours.get(name) != theirs.get(name):
            raise UsageError(f"{where}: {name} {ours.get(name)!r} here, {theirs.get(name)!r} in the baseline: fly both "
                             "with the same one")


def _intended(common: list[Key], run: Flights, baseline: Flights) -> list[str]:
    found = []
    for name in MAY_DIFFER:
        seen = {(str(run.requests[k].get(name)), str(baseline.requests[k].get(name))) for k in common}
        found += [f"{name}: {ours} here, {theirs} in the baseline" for ours, theirs in sorted(seen) if ours != theirs]
    return found
