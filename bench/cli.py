"""The `saranga-bench` command. Everything heavy is imported inside the command that needs it."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from bench import campaign_cli, compare_cli, hil_cli, preflight_cli, rig_cli, runs_cli, sitl_cli, stand_cli, sweep_cli
from bench.supervisor import cli as supervisor_cli
from saranga.errors import BenchError

EXIT_CODES = "Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted."

app = typer.Typer(
    name="saranga-bench",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Test bench and simulator for ultrasound obstacle avoidance on palm-sized quadrotors.",
    epilog=f"Start with: saranga-bench fly poles. {EXIT_CODES}",
)
app.add_typer(rig_cli.app, name="rig")
app.add_typer(sitl_cli.app, name="sitl")
app.add_typer(preflight_cli.app, name="preflight")
app.add_typer(supervisor_cli.app, name="supervisor")
app.add_typer(stand_cli.app, name="stand")
runs_cli.add_commands(app)
app.command(epilog=campaign_cli.EXAMPLES)(campaign_cli.campaign)
app.command(epilog=hil_cli.EXAMPLES)(hil_cli.hil)
app.command(epilog=compare_cli.EXAMPLES)(compare_cli.compare)
sweep_cli.add_commands(app)

FLY_EXAMPLES = f"""\b
Examples:
  saranga-bench fly poles
      one flight on the embedded autopilot
  saranga-bench fly poles --autopilot arducopter --seed 1 --json
      on the real firmware, for a script
  saranga-bench fly poles --trials 10 --stack none
      the same courses flown straight: must fail
  saranga-bench fly poles --fault dead_sensor=right --fault dead_sensor_at_s=5
  saranga-bench fly poles --trials 20 --baseline 3fa9
      not worse than that run? Pairs of flights, intervals
  saranga-bench fly my/scene.toml --trials 20 --limits my/limits.toml

One flight is judged by its outcome. Several are held to fixtures/limits/SCENE.toml
(or --limits) by the interval of their rate, and without limits each must pass.

{EXIT_CODES}
"""


@app.callback()
def _top() -> None:
    """Keeps `fly` a named command."""


@app.command(epilog=FLY_EXAMPLES)
def fly(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="Name in fixtures/scenes, or a .toml, .yaml or .json file.")
    ],
    autopilot: Annotated[str, typer.Option(help="embedded or arducopter (the real firmware, SITL).")] = "embedded",
    stack: Annotated[
        str, typer.Option(help="saranga, batdeck, none (straight ahead), or MODULE:NAME.")
    ] = "saranga",
    denoiser: Annotated[
        str, typer.Option(help="tbd (track-before-detect), saranga, gaussian, ..., or MODULE:NAME.")
    ] = "saranga",
    shield: Annotated[str, typer.Option(help="Name in fixtures/shields, a path, or a sweep's run folder.")] = "foam",
    sonar: Annotated[
        str | None, typer.Option(help="Name in fixtures/sonars, or a path [the stack's own, else pair].")
    ] = None,
    trials: Annotated[int, typer.Option(help="How many flights, with seeds S, S+1, ...")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the first flight: course, wind and noise follow from it.")] = 1,
    fault: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Break something on purpose; repeatable.")
    ] = None,
    limits: Annotated[str | None, typer.Option(help="Name in fixtures/limits, or a path.")] = None,
    max_sim_s: Annotated[float, typer.Option(help="Give a flight up after this much simulated time.")] = 180.0,
    live: Annotated[bool, typer.Option("--live", help="Wall time, the stack as its own process.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
    record: Annotated[
        bool, typer.Option("--record/--no-record", help="Write a Rerun recording of each flight.")
    ] = True,
    baseline: Annotated[
        str | None, typer.Option(metavar="RUN", help="Hold these flights to an earlier run of the same seeds.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Fly a scene, judge it, keep everything in a run folder."""
    import contextlib
    import math

    from saranga.errors import UsageError

    if not math.isfinite(max_sim_s) or max_sim_s <= 0:
        raise UsageError(f"--max-sim-s {max_sim_s}: must be a positive number of seconds")
    from bench.baseline.command import hold_to, load_baseline
    from bench.baseline.report import comparison_text
    from bench.flight_summary import exit_code
    from bench.fly import fly as fly_plan
    from bench.fly import make_plan
    from bench.interrupt import interruptible
    from bench.store import Store, runs_root
    from bench.terminal import make_reporter, summary_text
    from saranga.navigate import sonar_of
    from sitl.trial_types import Faults, TrialRequest

    faults = Faults.parse(fault or [])
    request = TrialRequest(
        scene=scene,
        seed=seed,
        autopilot=autopilot,
        stack=stack,
        denoiser=denoiser,
        shield=shield,
        sonar=sonar or sonar_of(stack),
        faults=faults if faults.any() else None,
        max_sim_s=max_sim_s,
    )
    plan = make_plan(request, trials, limits, live, record, tuple(sys.argv[1:]))
    store = Store(runs_root(out))
    held = load_baseline(baseline, store, [plan.request]) if baseline is not None else None
    reporter = make_reporter(trials, quiet)
    # With --json nothing that a library prints may end up beside the object.
    guard = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    with guard, interruptible() as interrupts:
        try:
            summary, run = fly_plan(plan, store, reporter, interrupts)
        finally:
            reporter.close()
    against = hold_to(held, run.folder, summary) if held is not None and summary["outcomes"] else None
    for text in summary["errors"]:
        print(f"error: {text}", file=sys.stderr)
    if as_json:
        print_json(summary)
    else:
        print(summary_text(summary, colour=sys.stdout.isatty()))
        if against is not None:
            print(comparison_text(against))
    raise typer.Exit(exit_code(summary))


def print_json(data: dict[str, Any]) -> None:
    """The one JSON object of a command."""
    print(json.dumps(data, allow_nan=False, default=str), flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: errors meant for people are one line on stderr, with --json an object on stdout as well."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        app(args=given, prog_name="saranga-bench")
    except BenchError as error:
        _fail(str(error), error.exit_code, given)
    except SystemExit as error:
        if error.code == 2 and "--json" in given:
            print_json(error_object("bad usage: see stderr", 2))
        raise
    except KeyboardInterrupt:
        _fail("interrupted", 130, given)
    except Exception as error:
        import os

        if os.environ.get("SARANGA_BENCH_TRACEBACK"):
            raise
        _fail(
            f"unexpected {type(error).__name__}: {error}; set SARANGA_BENCH_TRACEBACK=1 to see where",
            4,
            given,
        )


def error_object(text: str, code: int) -> dict[str, Any]:
    """What --json prints when there is no run to speak of: all the keys of the contract, verdict ERROR."""
    return {
        "verdict": "ERROR",
        "error": text,
        "errors": [text],
        "exit_code": code,
        "outcomes": [],
        "checks": [],
        "metrics": {},
        "provenance": {},
        "run": None,
    }


def _fail(text: str, code: int, given: list[str]) -> None:
    print(f"error: {text}", file=sys.stderr)
    if "--json" in given:
        print_json(error_object(text, code))
    sys.exit(code)


if __name__ == "__main__":
    main()
