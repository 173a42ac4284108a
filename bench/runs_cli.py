"""`saranga-bench runs`, `view` and `report`: what was flown before."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

RunName = Annotated[str, typer.Argument(metavar="RUN", help="`last`, an id or the start of one, or a path.")]
Root = Annotated[Path | None, typer.Option("--out", help="Folder of runs [$SARANGA_BENCH_RUNS or ./runs].")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


def add_commands(app: typer.Typer) -> None:
    """Hang the commands on the main application."""
    app.command(epilog="Examples: saranga-bench runs; saranga-bench runs --json --limit 5")(runs)
    app.command(epilog="Examples: saranga-bench view last; saranga-bench view 3fa9 --seed 4")(view)
    app.command(epilog="Examples: saranga-bench report last; saranga-bench report runs/20260101T120000Z-fly-3fa9c1; "
                       "saranga-bench report compared/")(report)


def runs(
    as_json: Json = False,
    limit: Annotated[int, typer.Option(min=1, help="How many, newest first.")] = 20,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Make the index anew from the folders.")] = False,
    out: Root = None,
) -> None:
    """List the runs, newest first."""
    from bench.store import Store, runs_root

    store = Store(runs_root(out))
    if rebuild and store.root.is_dir():
        store.rebuild_index()
    found = store.runs(limit)
    if as_json:
        rows = [{**run.info, "run": str(run.folder)} for run in found]
        print(json.dumps({"root": str(store.root), "runs": rows}, default=str))
        return
    if not found:
        print(f"no runs in {store.root}: fly one with `saranga-bench fly poles`")
        return
    _print_table([_cells(run.info, run.folder.name) for run in found])


def view(
    run: RunName,
    seed: Annotated[int | None, typer.Option(help="Which flight of the run [all].")] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve it to a browser on this machine.")] = False,
    out: Root = None,
) -> None:
    """Open a run's recordings in the Rerun viewer."""
    from bench.store import Store, runs_root
    from saranga.errors import UsageError

    path = Path(run).expanduser()
    if path.suffix != ".rrd":
        path = Store(runs_root(out)).resolve(run)
        if seed is not None:
            found = sorted(path.glob("flight-*.rrd"))
            path = path / f"flight-{seed}.rrd"
            if path not in found:
                known = ", ".join(f.name for f in found) or "none"
                raise UsageError(f"{path.parent}: no recording of seed {seed}: it has {known}")
    elif not path.is_file():
        raise UsageError(f"recording {path} does not exist: `saranga-bench runs` lists the runs")
    from bench.view import open_run

    raise typer.Exit(open_run(path, web=web))


def report(
    run: RunName,
    out: Root = None,
) -> None:
    """Write the page of a run anew from its journal (also `summary.json` and `junit.xml`), or of a folder of `python -m
    saranga evaluate --out`, and print where it is."""
    from bench.evaluation_page import is_evaluation, write_evaluation_page

    if is_evaluation(Path(run).expanduser()):
        print(write_evaluation_page(Path(run).expanduser()))
        return
    from bench.flight_page import write_page
    from bench.fly import rebuild
    from bench.store import Run, Store, read_run, runs_root

    folder = Store(runs_root(out)).resolve(run)
    kind = (read_run(folder) or Run(folder, {})).info.get("kind")
    if kind == "hardest":
        from bench.campaign.hardest import publish_hardest
        from bench.campaign.hardest_summary import rebuild_hardest

        publish_hardest(folder, rebuild_hardest(folder), lambda line: print(line, file=sys.stderr))
        print(folder / "report.html")
        return
    if kind == "campaign":
        from bench.campaign.runner import publish_campaign
        from bench.campaign.summary import rebuild_campaign

        publish_campaign(folder, rebuild_campaign(folder), lambda line: print(line, file=sys.stderr))
        print(folder / "report.html")
        return
    if (read_run(folder) or Run(folder, {})).info.get("kind") == "sweep":
        from bench.procedures.sweep_page import write_sweep_page

        print(write_sweep_page(folder))
        return
    rebuild(folder)
    print(write_page(folder))


def _cells(info: dict[str, Any], folder: str) -> tuple[str, ...]:
    from bench.store import age_text

    summary = info.get("summary") or {}
    outcomes = summary.get("outcomes") or []
    counts = ", ".join(f"{outcomes.count(o)} {o}" if len(outcomes) > 1 else o for o in dict.fromkeys(outcomes))
    state = info.get("verdict") or ""
    if info.get("state") != "finished":
        state = f"{state} {info.get('state')}".strip()
    return (
        str(info["id"]),
        str(info.get("kind")),
        _shortened(str(info.get("title"))),
        str(summary.get("autopilot", "")),
        state,
        counts,
        age_text(str(info["started_utc"])),
        folder,
    )


def _shortened(text: str, most: int = 40) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _print_table(rows: list[tuple[str, ...]]) -> None:
    """Plain columns, which survive grep and narrow terminals better than a drawn table."""
    table = [("ID", "KIND", "WHAT", "AUTOPILOT", "VERDICT", "OUTCOMES", "WHEN", "FOLDER"), *rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    for row in table:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
