"""`saranga-bench hil`: a companion computer in the loop."""

import sys
from pathlib import Path
from typing import Annotated

import typer

EXAMPLES = """\b
Examples:
  saranga-bench hil poles
      serves echoes on tcp://127.0.0.1:7000 and MAVLink on tcp://127.0.0.1:5760, says
      what to run, waits for it, and flies in wall time
  saranga-bench hil poles --autopilot arducopter -- python -m saranga run
      --echoes {echoes} --vehicle {vehicle} --denoiser saranga
      starts the companion itself: {echoes} and {vehicle} become the two URLs
  saranga-bench hil open --trials 3 --json -- ./my_stack
      your own program reads the URLs from SARANGA_ECHOES and SARANGA_VEHICLE, and the
      course's speed from SARANGA_SPEED_M_S ({speed} in the command)
  saranga-bench hil poles --listen tcp://0.0.0.0:7000 --mavlink tcp://0.0.0.0:5760
      for a companion computer on the network: whoever reaches the ports may connect

What passes over the two ports, and what is measured: docs/companion.md. Limits:
fixtures/limits/hil.toml (--companion-limits), and those of the scene.

Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted.
"""

EXTERNAL = "companion:external"
"""Stack and denoiser are the companion's own; the bench cannot know them."""


def hil(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="Name in fixtures/scenes, or a .toml, .yaml or .json file.")
    ],
    command: Annotated[
        list[str] | None, typer.Argument(metavar="-- COMMAND", help="The companion to start, for each flight.")
    ] = None,
    listen: Annotated[str, typer.Option(metavar="URL", help="Where echoes are served.")] = "tcp://127.0.0.1:7000",
    mavlink: Annotated[
        str, typer.Option(metavar="URL", help="Where the autopilot is served.")
    ] = "tcp://127.0.0.1:5760",
    autopilot: Annotated[str, typer.Option(help="embedded or arducopter (the real firmware, SITL).")] = "embedded",
    shield: Annotated[str, typer.Option(help="Name in fixtures/shields, a path, or a sweep's run folder.")] = "foam",
    sonar: Annotated[str, typer.Option(help="Name in fixtures/sonars, or a path: what the rig has.")] = "pair",
    trials: Annotated[int, typer.Option(help="How many flights, with seeds S, S+1, ...")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the first flight: course, wind and noise follow from it.")] = 1,
    fault: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Break something on purpose; repeatable.")
    ] = None,
    limits: Annotated[str | None, typer.Option(help="Limits of the flights: name or path [the scene's].")] = None,
    companion_limits: Annotated[str, typer.Option(help="Limits of the companion: name or path.")] = "hil",
    wait_s: Annotated[float, typer.Option(help="How long to wait for the companion.")] = 120.0,
    max_sim_s: Annotated[float, typer.Option(help="Give a flight up after this much flight time.")] = 180.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
    record: Annotated[
        bool, typer.Option("--record/--no-record", help="Write a Rerun recording of each flight.")
    ] = True,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Serve world and autopilot to a companion computer, measure it, judge the flight."""
    import contextlib
    import math
    from dataclasses import replace

    from bench.flight_summary import exit_code, limit_to_dict
    from bench.fly import fly, make_plan
    from bench.hil.flight import HilSetup, run_hil_trial
    from bench.hil.ports import is_loopback, parse_listen
    from bench.hil.summary import companion_text, header_entry, load_companion_limits
    from bench.interrupt import interruptible
    from bench.store import Store, runs_root
    from bench.terminal import make_reporter, summary_text
    from saranga.errors import UsageError
    from sitl.trial import Cancel, Progress
    from sitl.trial_types import Faults, TrialRequest, TrialResult

    for name, value in (("--wait-s", wait_s), ("--max-sim-s", max_sim_s)):
        if not math.isfinite(value) or value <= 0:
            raise UsageError(f"{name} {value}: must be a positive number of seconds")
    words = tuple(command or ())
    setup = HilSetup(parse_listen("--listen", listen), parse_listen("--mavlink", mavlink), words, wait_s)
    if setup.echoes == setup.vehicle and setup.echoes[1] != 0:
        raise UsageError(f"--listen and --mavlink are both {listen}: give two ports")
    faults = Faults.parse(fault or [])
    request = TrialRequest(scene=scene, seed=seed, autopilot=autopilot, stack=EXTERNAL, denoiser=EXTERNAL,
                           shield=shield, sonar=sonar, faults=faults if faults.any() else None, max_sim_s=max_sim_s)
    held = [limit_to_dict(limit) for limit in load_companion_limits(companion_limits)]
    plan = replace(make_plan(request, trials, limits, live=True, record=record, argv=tuple(sys.argv[1:])),
                   hil=header_entry(listen, mavlink, words, held))
    reporter = make_reporter(trials, quiet)
    setup.note = reporter.note
    for option, url, (host, _) in (("--listen", listen, setup.echoes), ("--mavlink", mavlink, setup.vehicle)):
        if not is_loopback(host):
            reporter.note(f"warning: {option} {url} is open to the network: whoever reaches it may connect")

    def runner(request: TrialRequest, progress: Progress | None, cancel: Cancel | None) -> TrialResult:
        return run_hil_trial(request, setup, progress, cancel)

    guard = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    with guard, interruptible() as interrupts:
        try:
            summary, _ = fly(replace(plan, runner=runner), Store(runs_root(out)), reporter, interrupts)
        finally:
            reporter.close()
    for text in summary["errors"]:
        print(f"error: {text}", file=sys.stderr)
    if as_json:
        from bench.cli import print_json

        print_json(summary)
    else:
        print("\n".join(filter(None, (summary_text(summary, colour=sys.stdout.isatty()), companion_text(summary)))))
    raise typer.Exit(exit_code(summary))
