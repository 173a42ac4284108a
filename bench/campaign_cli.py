"""`saranga-bench campaign`: a suite of scenes, flown, judged and drawn."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

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

A row passes when it is not worse than the paper's rate (SPRT, Wilson's interval).
INCONCLUSIVE says how many more trials would decide. docs/campaigns.md has the rest.

Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted.
"""


def campaign(
    suite: Annotated[str, typer.Argument(metavar="SUITE", help="Name in fixtures/campaigns, or a .toml file.")],
    autopilot: Annotated[str | None, typer.Option(help="embedded or arducopter [the suite's].")] = None,
    denoiser: Annotated[str | None, typer.Option(help="For every row [the suite's].")] = None,
    shield: Annotated[str | None, typer.Option(help="For rows that name none [the suite's].")] = None,
    trials: Annotated[int | None, typer.Option(help="Of every row [the suite's].")] = None,
    seed: Annotated[int | None, typer.Option(help="First seed [the suite's].")] = None,
    rows: Annotated[str | None, typer.Option(help="Only these, with commas between.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Simulators at a time [one a CPU].")] = None,
    dask: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster, or local.")] = None,
    resume: Annotated[str | None, typer.Option(metavar="RUN", help="Go on with this run: path, id or last.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Fly a suite of scenes and hold every row to the paper's rate."""
    import contextlib

    from bench.campaign.runner import Plan, run_campaign, suite_of
    from bench.campaign.suite import load_suite
    from bench.campaign.workers import DaskWorkers, LocalWorkers, Workers
    from bench.cli import print_json
    from bench.flight_summary import exit_code
    from bench.interrupt import interruptible
    from bench.store import Store, runs_root

    names = [name.strip() for name in rows.split(",") if name.strip()] if rows is not None else None
    store = Store(runs_root(out))
    folder = store.resolve(resume) if resume is not None else None
    begun = load_suite(suite) if folder is None else suite_of(folder)
    chosen = begun.changed(names, trials, autopilot=autopilot, denoiser=denoiser, shield=shield, seed=seed)
    count = jobs if jobs is not None else len(os.sched_getaffinity(0))

    def make() -> Workers:
        return DaskWorkers(dask, count) if dask is not None else LocalWorkers(count)

    def say(line: str) -> None:
        if not quiet:
            print(line, file=sys.stderr, flush=True)

    guard = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    with guard, interruptible() as interrupts:
        summary = run_campaign(Plan(chosen, make, tuple(sys.argv[1:])), store, interrupts, say, folder)
    for text in summary["errors"]:
        print(f"error: {text}", file=sys.stderr)
    if as_json:
        print_json(summary)
    else:
        from bench.campaign_table import table_text

        print(table_text(summary))
    raise typer.Exit(exit_code(summary))
