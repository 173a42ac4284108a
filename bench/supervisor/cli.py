"""`saranga-bench supervisor`: latched trips, and the kill matrix."""

import json
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The safety supervisor: trips and the kill matrix.")

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Folder = Annotated[Path | None, typer.Option("--run", metavar="FOLDER", help="A run folder's own trips (emulated "
                                             "devices); without it those of this computer's real throttles.")]

MATRIX_EXAMPLES = """\b
Examples:
  saranga-bench supervisor kill-matrix
      every cause in every phase, a few minutes
  saranga-bench supervisor kill-matrix --quick --json
  saranga-bench supervisor kill-matrix --cause SIGKILL --phase hold

Nothing but emulated devices spins. Exit codes: 0 PASS, 1 FAIL, 3 INCONCLUSIVE (the machine was too busy to tell).
"""


@app.callback()
def _top() -> None:
    """Keeps the commands named."""


@app.command()
def trips(run: Folder = None, as_json: Json = False) -> None:
    """List the trips that are latched."""
    from bench.supervisor.latches import all_latches, state_folder

    found = all_latches(run or state_folder())
    if as_json:
        print(json.dumps({"latched": [{"throttle_url": url, "trips": [vars(t) for t in trips], "file": str(path)}
                                      for path, (url, trips) in found.items()]}))
        return
    for url, latched in found.values():
        print(url)
        for trip in latched:
            print(f"  {trip.name}: {trip.text}")
    if not found:
        print("no trips are latched")


@app.command()
def clear(run: Folder = None) -> None:
    """Clear latched trips, when their cause has been found and mended; CLEAR has to be typed."""
    from bench.supervisor.latches import all_latches, state_folder
    from bench.supervisor.plan import CLEAR_WORD, Confirmation

    found = all_latches(run or state_folder())
    if not found:
        print("no trips are latched")
        return
    what = "\n".join(f"{url}: {trip.name}: {trip.text}" for url, latched in found.values() for trip in latched)
    Confirmation.from_operator(what, CLEAR_WORD)
    for path in found:
        path.unlink(missing_ok=True)
    print(f"cleared: {len(found)}")


@app.command(name="kill-matrix", epilog=MATRIX_EXAMPLES)
def kill_matrix(
    cause: Annotated[list[str] | None, typer.Option(help="Only this cause; repeatable.")] = None,
    phase: Annotated[list[str] | None, typer.Option(help="Only this phase; repeatable.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Every cause and every phase at least once.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Cells at a time.")] = 2,
    keep: Annotated[Path | None, typer.Option(help="Keep logs and records in this new folder.")] = None,
    as_json: Json = False,
) -> None:
    """Cut an emulated sweep off in every way and phase; measure how long the throttle takes to idle."""
    from bench.supervisor.matrix_report import run_and_report

    raise typer.Exit(run_and_report(cause or [], phase or [], quick, jobs, keep, as_json))
