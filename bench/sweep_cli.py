"""`saranga-bench sweep` and `shields`: how loud the propeller is in the sensor, and what shields take from it."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

EXIT_CODES = "Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted."

SWEEP_EXAMPLES = f"""\b
Examples:
  saranga-bench sweep shield-comparison --dry-run
      time, peak throttle, energy, limits, order and the plan's hash; nothing moves
  saranga-bench sweep shield-comparison --rig emulated: --stand emulated:
      a rehearsal: the same bytes, supervisor and steps on emulated hardware
  saranga-bench sweep shield-comparison --simulated-time
      the same in simulated time, without supervisor
  saranga-bench sweep shield-comparison --rig serial:///dev/ttyACM0 \\
      --stand teensy+serial:///dev/ttyACM0 --plan-hash 0123456789abcdef
      for real: the hash is the dry run's, and SPIN has to be typed
  saranga-bench sweep --resume last --rig ... --stand ...
      go on after an interruption; finished steps are not measured again

{EXIT_CODES}
"""

SHIELDS_EXAMPLES = f"""\b
Examples:
  saranga-bench shields last
  saranga-bench shields 3fa9 71c2 --at-thrust 0.2 --json
      several runs of the same shields as one
  saranga-bench shields last --flights 20
      and how often the stack gets through the poles behind each

A measured shield flies: saranga-bench fly poles --shield RUN:foam. {EXIT_CODES}
"""

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")]
Out = Annotated[Path | None, typer.Option(help="Folder of runs [$SARANGA_BENCH_RUNS or ./runs].")]


def add_commands(app: typer.Typer) -> None:
    """Hang the commands on the main application."""
    from bench import procedures_cli

    app.command(epilog=SWEEP_EXAMPLES)(sweep)
    app.command(epilog=SHIELDS_EXAMPLES)(shields)
    procedures_cli.add_commands(app)


def sweep(
    plan: Annotated[
        str | None, typer.Argument(metavar="[PLAN]", help="Name in fixtures/plans, or a .toml file.")
    ] = None,
    rig: Annotated[
        str | None, typer.Option(help="serial:///dev/..., tcp://host:port or emulated:[?...] [the stand's port].")
    ] = None,
    stand: Annotated[
        str | None, typer.Option(help="teensy+serial://..., rcbenchmark+udp://..., emulated:[?...], ...")
    ] = None,
    throttle: Annotated[str | None, typer.Option(help="What spins, where the stand does not [the stand].")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would happen; nothing moves.")] = False,
    plan_hash: Annotated[
        str | None, typer.Option(metavar="HASH", help="Of the dry run; the plan must still have it.")
    ] = None,
    yes_spin: Annotated[
        bool, typer.Option("--yes-spin", help="Do not ask; enough for emulated devices only.")
    ] = False,
    simulated_time: Annotated[
        bool, typer.Option("--simulated-time", help="Emulated device in this process, as fast as it computes.")
    ] = False,
    resume: Annotated[str | None, typer.Option(metavar="RUN", help="Go on with this run: path, id or last.")] = None,
    view: Annotated[bool, typer.Option("--view", help="Watch it live in the Rerun viewer.")] = False,
    as_json: Json = False,
    out: Out = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Measure noise against thrust by a plan, under a supervisor; judge it, keep everything in a run folder."""
    from bench.procedures.sweep_command import SweepOptions, sweep_command

    options = SweepOptions(plan, rig, stand, throttle, dry_run, plan_hash, yes_spin, simulated_time, resume, view,
                           as_json, out, quiet, tuple(sys.argv[1:]))
    raise typer.Exit(sweep_command(options))


def shields(
    runs: Annotated[list[str], typer.Argument(metavar="RUN...", help="Sweeps: `last`, ids or paths.")],
    at_thrust: Annotated[
        float | None, typer.Option(metavar="KGF", help="Thrust of one motor that losses are quoted at [0.115].")
    ] = None,
    sensor: Annotated[str | None, typer.Option(help="left, right or down [the plan's].")] = None,
    flights: Annotated[int, typer.Option(help="Fly each shield this often on the embedded autopilot.")] = 0,
    scene: Annotated[str, typer.Option(help="Scene of those flights.")] = "poles",
    seed: Annotated[int, typer.Option(help="First seed of those flights.")] = 1,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Compare shields over one or more sweeps: insertion loss at equal thrust, detection range, flights."""
    from bench.procedures.shields_command import shields_command

    raise typer.Exit(shields_command(runs, at_thrust, sensor, flights, scene, seed, as_json, out))


def print_result(summary: dict[str, Any], text: str, as_json: bool) -> None:
    """The object or the text on stdout, errors on stderr."""
    from bench.cli import print_json

    for error in summary.get("errors", []):
        print(f"error: {error}", file=sys.stderr)
    if as_json:
        print_json(summary)
    else:
        print(text)
