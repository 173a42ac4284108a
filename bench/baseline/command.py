"""`--baseline RUN`: refuse early what cannot be compared, compare when the flights are done, keep it in the run."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.baseline.flights import Flights, check_requests, check_worlds, read_flights
from bench.baseline.inputs import world_inputs
from bench.baseline.junit import add_to_junit
from bench.baseline.report import comparison_markdown
from bench.baseline.verdict import CONFIDENCE, Comparison, compare_runs
from bench.step_summary import publish_step_summary
from bench.store import RUN_FILE, Store, write_json
from bench.verdict import Verdict, worst
from sitl.trial_types import TrialRequest

FILE = "comparison.json"


@dataclass(frozen=True)
class Baseline:
    """An earlier run to hold the next one to."""

    flights: Flights
    confidence: float = CONFIDENCE


def load_baseline(name: str, store: Store, requests: Iterable[TrialRequest], confidence: float | None = None
                  ) -> Baseline:
    """Find and read it before anything is flown.

    Raises:
        UsageError: no such run, no flights in it, or its world is not the one that `requests` would be flown in.
    """
    flights = read_flights(find_run(name, store))
    asked = list(requests)
    check_worlds(world_inputs(asked), flights.inputs, flights.folder)
    check_requests(asked, flights)
    return Baseline(flights, CONFIDENCE if confidence is None else confidence)


def find_run(name: str, store: Store) -> Path:
    """As `Store.resolve`; a folder of runs stands for the newest in it, as CI restores one from its cache.

    Raises:
        UsageError: nothing fits.
    """
    folder = Path(name).expanduser()
    if folder.is_dir() and not (folder / RUN_FILE).is_file():
        return Store(folder).resolve("last")
    return store.resolve(name)


def hold_to(baseline: Baseline, folder: Path, summary: dict[str, Any], paired: bool = True) -> Comparison:
    """Compare the run in `folder` and enter the result: `comparison.json`, `summary.md`, and `summary["baseline"]`.

    The summary's verdict becomes the worse of its own and the comparison's.

    Raises:
        UsageError: the runs cannot be compared.
    """
    found = compare_runs(read_flights(folder), baseline.flights, paired, baseline.confidence)
    keep_comparison(folder, found)
    summary["baseline"] = found.to_dict()
    summary["verdict"] = worst([Verdict(summary["verdict"]), found.verdict]).value
    return found


def keep_comparison(folder: Path, found: Comparison) -> None:
    """Write it into the run folder (JSON, JUnit) and the CI step's summary."""
    write_json(folder / FILE, found.to_dict())
    add_to_junit(folder / "junit.xml", found)
    publish_step_summary(folder, comparison_markdown(found), append=True)
