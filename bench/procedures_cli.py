"""`saranga-bench beam`, `reference-echo`, `accuracy` and `energy`: procedures in which nothing spins."""

from pathlib import Path
from typing import Annotated

import typer

EXIT_CODES = "Exit codes: 0 done, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted."
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")]
Out = Annotated[Path | None, typer.Option(help="Folder of runs [$SARANGA_BENCH_RUNS or ./runs].")]

BEAM_EXAMPLES = f"""\b
Examples:
  saranga-bench beam --rig emulated:
  saranga-bench beam my-places.toml --rig serial:///dev/ttyACM0
      you are asked to move the pole from place to place

{EXIT_CODES}
"""

ECHO_EXAMPLES = f"""\b
Examples:
  saranga-bench reference-echo --rig emulated:
  saranga-bench reference-echo box.toml --rig serial:///dev/ttyACM0
      then name its echoes.mcap in a recipe of python -m saranga synthesise

{EXIT_CODES}
"""

ACCURACY_EXAMPLES = f"""\b
Examples:
  saranga-bench accuracy echoes.mcap --true-m 1.0
      the rig's nearest echo, cycle by cycle
  saranga-bench accuracy flight.tlog --message OBSTACLE_DISTANCE --true-m 1.0
  saranga-bench accuracy lidar.csv --column distance_mm --scale 0.001 --true-m 1.0

1 - mean |D_true - D_measured|; an undefined or zero reading counts as an error of 1.
The paper's sonar reaches 0.893 on average. {EXIT_CODES}
"""

ENERGY_EXAMPLES = f"""\b
Examples:
  saranga-bench energy --power rapl
  saranga-bench energy --power csv:log.csv --denoiser saranga --calls 500

At least 100 inferences between two idle stretches; E = (P_active - P_idle) t. The
paper: 10.6 mJ on an Edge TPU. {EXIT_CODES}
"""


def add_commands(app: typer.Typer) -> None:
    """Hang the commands on the main application."""
    app.command(epilog=BEAM_EXAMPLES)(beam)
    app.command("reference-echo", epilog=ECHO_EXAMPLES)(reference_echo)
    app.command(epilog=ACCURACY_EXAMPLES)(accuracy)
    app.command(epilog=ENERGY_EXAMPLES)(energy)


def beam(
    plan: Annotated[str, typer.Argument(metavar="[PLAN]", help="Name in fixtures/plans, or a .toml file.")
                    ] = "beam-pattern",
    rig: Annotated[str | None, typer.Option(help="serial:///dev/..., tcp://host:port or emulated:.")] = None,
    resume: Annotated[str | None, typer.Option(metavar="RUN", help="Go on with this run: path, id or last.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the places and the time; nothing is asked.")] = False,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Measure the echo of a pole over distance and azimuth (the paper's Fig. S3)."""
    from bench.procedures.echo_commands import beam_command

    raise typer.Exit(beam_command(plan, rig, resume, dry_run, as_json, out))


def reference_echo(
    plan: Annotated[str, typer.Argument(metavar="[PLAN]", help="Name in fixtures/plans, or a .toml file.")
                    ] = "reference-echo",
    rig: Annotated[str | None, typer.Option(help="serial:///dev/..., tcp://host:port or emulated:.")] = None,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Record the echo of one object, for training data (R of the paper's eq. 8)."""
    from bench.procedures.echo_commands import echo_command

    raise typer.Exit(echo_command(plan, rig, as_json, out))


def accuracy(
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".mcap of a rig, .tlog of MAVLink, or .csv.")],
    true_m: Annotated[float, typer.Option(help="Where the obstacle stands, metres.")],
    sensor: Annotated[str, typer.Option(help="Sensor of a rig recording.")] = "left",
    message: Annotated[str, typer.Option(help="DISTANCE_SENSOR or OBSTACLE_DISTANCE.")] = "DISTANCE_SENSOR",
    sensor_id: Annotated[int | None, typer.Option(help="id of the DISTANCE_SENSOR [any].")] = None,
    column: Annotated[str | None, typer.Option(help="Column of a CSV file [the one that says distance].")] = None,
    scale: Annotated[float, typer.Option(help="Metres for one unit of the CSV file.")] = 1.0,
    as_json: Json = False,
) -> None:
    """Score a ranger by the paper's formula."""
    from bench.procedures.echo_commands import accuracy_command

    raise typer.Exit(accuracy_command(file, true_m, sensor, message, sensor_id, column, scale, as_json))


def energy(
    power: Annotated[str, typer.Option(help="Power source: rapl, csv:FILE, joulescope, ina228:...")] = "rapl",
    denoiser: Annotated[str, typer.Option(help="What is run.")] = "saranga",
    calls: Annotated[int, typer.Option(help="Inferences, at least 100.")] = 500,
    idle_s: Annotated[float, typer.Option(help="Idle before and after, seconds.")] = 3.0,
    as_json: Json = False,
) -> None:
    """Energy of one inference over idle, and in all."""
    from bench.procedures.echo_commands import energy_command

    raise typer.Exit(energy_command(power, denoiser, calls, idle_s, as_json))
