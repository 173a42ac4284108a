"""`saranga-bench campaign`: a suite of scenes, flown, judged and drawn; the search for the hardest course."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from bench.campaign.workers import Workers

EXAMPLES = """\b
Examples:
  saranga-bench campaign paper --autopilot arducopter
      the paper's 13 rows, 20 trials each, on the real firmware
  saranga-bench campaign paper --rows thin,fog --trials 5 --jobs 2
  saranga-bench campaign batdeck
      Saranga against BatDeck over the same courses (McNemar)
  saranga-bench campaign paper --resume last
      go on after an interruption: finished trials are not flown again
  saranga-bench campaign paper --dask tcp://head:8786
      on a Dask cluster; --dask local starts one here
  saranga-bench campaign faults
      one fault a row: what the stack did, against what is acceptable
  saranga-bench campaign paper --baseline 3fa9
      not worse than that run? Pairs of flights, intervals
  saranga-bench campaign paper --rows thin,fog --trials 20 --screen
      the embedded autopilot against ArduCopter over the same seeds
  saranga-bench campaign --hardest paper-composite --budget 240
      the course of that family on which the stack does worst

A row passes when it is not worse than the paper's rate (SPRT, Wilson's interval), or
when its faults did what its [row.acceptable] allows.
INCONCLUSIVE says how many more trials would decide. docs/campaigns.md has the rest.

Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted.
"""
DEFAULT_BUDGET = 240


def campaign(
    suite: Annotated[
        str | None, typer.Argument(metavar="SUITE", help="Name in fixtures/campaigns, or a .toml file.")
    ] = None,
    autopilot: Annotated[str | None, typer.Option(help="embedded or arducopter [the suite's].")] = None,
    stack: Annotated[str | None, typer.Option(help="With --hardest: who flies [saranga].")] = None,
    denoiser: Annotated[str | None, typer.Option(help="For every row [the suite's].")] = None,
    shield: Annotated[str | None, typer.Option(help="For rows that name none [the suite's].")] = None,
    trials: Annotated[int | None, typer.Option(help="Of every row [the suite's].")] = None,
    seed: Annotated[int | None, typer.Option(help="First seed [the suite's].")] = None,
    rows: Annotated[str | None, typer.Option(help="Only these, with commas between.")] = None,
    screen: Annotated[
        bool, typer.Option("--screen", help="Every row on both autopilots: may the embedded one screen?")
    ] = False,
    hardest: Annotated[
        str | None, typer.Option(metavar="SCENE", help="Search its family for the course flown worst.")
    ] = None,
    budget: Annotated[int | None, typer.Option(help=f"Flights of --hardest [{DEFAULT_BUDGET}].")] = None,
    rule: Annotated[str | None, typer.Option(help="With --hardest: strict or lenient [strict].")] = None,
    keep: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --hardest: write the course there too.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Simulators at a time [one a CPU].")] = None,
    dask: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster, or local.")] = None,
    resume: Annotated[str | None, typer.Option(metavar="RUN", help="Go on with this run: path, id or last.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
    baseline: Annotated[
        str | None, typer.Option(metavar="RUN", help="Hold every flight to an earlier run of the suite.")
    ] = None,
) -> None:
    """Fly a suite of scenes and hold every row to the paper's rate, or search for the hardest course."""
    from saranga.errors import UsageError

    if (suite is None) == (hardest is None):
        raise UsageError("give one SUITE, or --hardest SCENE: `saranga-bench campaign --help` has examples")
    only_search = {"--budget": budget, "--keep": keep, "--rule": rule, "--stack": stack}
    only_suite = {"--trials": trials, "--rows": rows, "--screen": screen or None, "--baseline": baseline}
    for name, value in (only_search if hardest is None else only_suite).items():
        if value is not None:
            kind = "a search (--hardest)" if hardest is None else "a suite"
            raise UsageError(f"{name} belongs to {kind}: leave it out")

    def make() -> "Workers":
        from bench.campaign.workers import DaskWorkers, LocalWorkers

        count = jobs if jobs is not None else len(os.sched_getaffinity(0))
        return DaskWorkers(dask, count) if dask is not None else LocalWorkers(count)

    def say(line: str) -> None:
        if not quiet:
            print(line, file=sys.stderr, flush=True)

    if hardest is not None:
        if rule not in (None, "strict", "lenient"):
            raise UsageError(f"--rule {rule}: must be strict or lenient")
        request = _request(hardest, autopilot, stack, denoiser, shield, seed)
        _search(request, budget if budget is not None else DEFAULT_BUDGET, rule or "strict", keep, make, say, resume,
                out, as_json, dask is None)
        return
    assert suite is not None
    names = [name.strip() for name in rows.split(",") if name.strip()] if rows is not None else None
    changes = {"autopilot": autopilot, "denoiser": denoiser, "shield": shield, "seed": seed}
    _suite(suite, names, trials, changes, screen, make, say, resume, out, as_json, dask is None, baseline)


def _suite(suite: str, rows: list[str] | None, trials: int | None, changes: dict[str, Any], screen: bool,
           make: Callable[[], "Workers"], say: Callable[[str], None], resume: str | None, out: Path | None,
           as_json: bool, here: bool, baseline: str | None) -> None:
    from bench.baseline.command import hold_to, load_baseline
    from bench.baseline.report import comparison_text
    from bench.campaign.runner import Plan, run_campaign, suite_of
    from bench.campaign.screening import screening_suite
    from bench.campaign.suite import load_suite
    from bench.campaign_table import table_text
    from bench.interrupt import interruptible
    from bench.store import Store, runs_root
    from saranga.errors import UsageError

    store = Store(runs_root(out))
    folder = store.resolve(resume) if resume is not None else None
    if folder is None and screen and changes["autopilot"] is not None:
        raise UsageError("--screen flies both autopilots: leave --autopilot out")
    chosen = (load_suite(suite) if folder is None else suite_of(folder)).changed(rows, trials, **changes)
    if screen and not chosen.screenings:
        chosen = screening_suite(chosen)
    if here:
        _need_autopilots({chosen.request(row, 0).autopilot for row in chosen.rows})
    requests = [chosen.request(row, 0) for row in chosen.rows]
    held = load_baseline(baseline, store, requests) if baseline is not None else None
    with _guard(as_json), interruptible() as interrupts:
        summary = run_campaign(Plan(chosen, make, tuple(sys.argv[1:])), store, interrupts, say, folder)
    text = table_text(summary)
    if held is not None and summary["outcomes"]:
        text += "\n" + comparison_text(hold_to(held, Path(summary["run"]), summary))
    _finish(summary, text, as_json)


def _search(request: Any, budget: int, rule: str, keep: Path | None,
            make: Callable[[], "Workers"], say: Callable[[str], None], resume: str | None, out: Path | None,
            as_json: bool, here: bool) -> None:
    from bench.campaign.hardest import HardestPlan, find_hardest, plan_of
    from bench.campaign.hardest_summary import hardest_text
    from bench.interrupt import interruptible
    from bench.store import Store, runs_root

    store = Store(runs_root(out))
    folder = store.resolve(resume) if resume is not None else None
    plan = HardestPlan(request, budget, rule, make, keep, tuple(sys.argv[1:]))
    if folder is not None:
        plan = plan_of(folder, make, keep, tuple(sys.argv[1:]))
    if here:
        _need_autopilots({plan.request.autopilot})
    with _guard(as_json), interruptible() as interrupts:
        summary = find_hardest(plan, store, interrupts, say, folder)
    _finish(summary, hardest_text(summary), as_json)


def _request(scene: str, autopilot: str | None, stack: str | None, denoiser: str | None, shield: str | None,
             seed: int | None) -> Any:
    from bench.fly import make_plan
    from saranga.navigate import sonar_of
    from sitl.trial_types import TrialRequest

    name = stack or "saranga"
    request = TrialRequest(scene=scene, seed=1 if seed is None else seed, autopilot=autopilot or "embedded",
                           stack=name, denoiser=denoiser or "saranga", shield=shield or "foam",
                           sonar=sonar_of(name) or "pair")
    return make_plan(request, 1).request  # checks what can be checked without flying


def _need_autopilots(kinds: set[str]) -> None:
    """One clear error before the first flight, instead of one a trial."""
    if "arducopter" in kinds:
        from sitl.autopilot.binary import require_binary

        require_binary()


def _guard(as_json: bool) -> Any:
    import contextlib

    return contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()


def _finish(summary: dict[str, Any], text: str, as_json: bool) -> None:
    from bench.cli import print_json
    from bench.flight_summary import exit_code

    for error in summary["errors"]:
        print(f"error: {error}", file=sys.stderr)
    if as_json:
        print_json(summary)
    else:
        print(text)
    raise typer.Exit(exit_code(summary))
