"""`saranga-bench preflight`: go or no-go before a flight."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

EXIT_CODES = "Exit codes: 0 GO (PASS or MARGINAL), 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted."

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

EXAMPLES = f"""\b
Examples:
  saranga-bench preflight --vehicle serial:///dev/ttyACM1 --rig serial:///dev/ttyACM0
      vehicle parked and disarmed, a pole 0.8 m ahead of the rig, 30 degrees to the right
  saranga-bench preflight --vehicle emulated:arducopter --rig emulated:
      a rehearsal on the real firmware (SITL) and an emulated rig; emulated: alone is the embedded autopilot
  saranga-bench preflight --vehicle "emulated:?fault=no_flow" --rig "emulated:?fault=swapped_sensors"
      what a NO-GO looks like
  saranga-bench preflight --vehicle udpin://127.0.0.1:14550 --rig tcp://127.0.0.1:5555 --reflector 1.0,left --json
  saranga-bench preflight --vehicle serial:///dev/ttyACM1 --rig ... --fix-parameters
      shows what differs, asks for a typed word, writes, reads back
  saranga-bench preflight key ~/preflight.key
  saranga-bench preflight --vehicle ... --rig ... --sign-key ~/preflight.key
  saranga-bench preflight verify runs/.../preflight.json --key ~/preflight.key

It never arms, changes no mode and spins nothing: what it sends is held to a list of harmless messages. Everything is
checked and listed; what is absent, stale or skipped is never a GO. Under a minute. docs/preflight.md has the checks.

{EXIT_CODES}
"""

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")]


@app.callback(invoke_without_command=True, epilog=EXAMPLES)
def preflight(
    context: typer.Context,
    vehicle: Annotated[
        str | None, typer.Option(help="serial:///dev/ttyACM1[?baud=N], tcp://, udpin://, udpout:// or emulated:")
    ] = None,
    rig: Annotated[str | None, typer.Option(help="serial:///dev/ttyACM0, tcp://host:port or emulated:")] = None,
    limits: Annotated[str, typer.Option(help="Name in fixtures/limits, or a path.")] = "preflight",
    rig_limits: Annotated[str, typer.Option(help="The rig's, likewise.")] = "rig",
    parameters: Annotated[
        list[str] | None,
        typer.Option(help="Names in fixtures/parameters, or paths; repeatable [arducopter-gps-denied and preflight]."),
    ] = None,
    sonar: Annotated[str, typer.Option(help="Where the sensors sit: a name in fixtures/sonars, or a path.")] = "pair",
    reflector: Annotated[
        str, typer.Option(metavar="RANGE[,SIDE]", help="Where the pole stands: m, right or left; or none.")
    ] = "0.8,right",
    temperature: Annotated[float | None, typer.Option(help="Of the air, C, where the rig does not measure it.")] = None,
    denoiser: Annotated[str, typer.Option(help="The one that will fly: saranga, tbd, gaussian, ...")] = "saranga",
    stack: Annotated[str, typer.Option(help="The policy that will fly: saranga, batdeck or MODULE:NAME.")] = "saranga",
    system: Annotated[int, typer.Option(help="The vehicle's MAVLink system id.")] = 1,
    skip: Annotated[
        list[str] | None, typer.Option(metavar="CHECK", help="Bypass a check; it shouts, and it is no GO. Repeatable.")
    ] = None,
    fix_parameters: Annotated[
        bool, typer.Option("--fix-parameters", help="Show what differs, ask, write, read back.")
    ] = False,
    mavsdk: Annotated[bool, typer.Option("--mavsdk/--no-mavsdk", help="Read the vehicle through MAVSDK too.")] = True,
    download_log: Annotated[
        bool, typer.Option("--download-log", help="Fetch the vehicle's newest log through MAVSDK; takes longer.")
    ] = False,
    sign_key: Annotated[Path | None, typer.Option(metavar="FILE", help="Sign the result with this key.")] = None,
    as_json: Json = False,
    out: Annotated[Path | None, typer.Option(help="Folder for runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Go or no-go: check vehicle, rig, link and this computer before a flight. Reads only, never arms."""
    if context.invoked_subcommand is not None:
        return
    import contextlib

    from bench.interrupt import EXIT_INTERRUPTED, interruptible
    from bench.preflight.command import Plan
    from bench.preflight.command import preflight as run_preflight
    from bench.preflight.parameter_difference import PARAMETER_SETS
    from bench.preflight.rig_side import parse_reflector
    from bench.store import Store, runs_root
    from bench.verdict import Verdict

    plan = Plan(vehicle, rig, limits, rig_limits, tuple(parameters or PARAMETER_SETS), sonar,
                parse_reflector(reflector), temperature, denoiser, stack, system, tuple(skip or ()), fix_parameters,
                mavsdk, download_log, sign_key)
    say = (lambda text: None) if quiet else (lambda text: print(text, file=sys.stderr, flush=True))
    guard = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    with guard, interruptible() as interrupts:
        result = run_preflight(plan, Store(runs_root(out)), say, interrupts.asked)
    for error in result["errors"]:
        print(f"error: {error}", file=sys.stderr)
    _print(result, as_json)
    raise typer.Exit(EXIT_INTERRUPTED if interrupts.asked() else Verdict(result["verdict"]).exit_code)


@app.command()
def verify(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="preflight.json of a run folder.")],
    key: Annotated[Path, typer.Option(metavar="FILE", help="The key it was signed with.")],
    as_json: Json = False,
) -> None:
    """Was this result signed with this key, and not changed since? Exit code 0 yes, 1 no."""
    from bench.preflight.sign import load_key, load_result, problem

    result = load_result(file)
    wrong = problem(result, load_key(key))
    go = bool(result.get("go")) and not wrong
    if as_json:
        from bench.cli import print_json

        print_json({"verdict": "FAIL" if wrong else "PASS", "valid": not wrong, "problem": wrong, "go": go,
                    "checks": [], "run": result.get("run")})
    else:
        print(f"NOT VALID: {wrong}" if wrong else f"valid; it says {'GO' if go else 'NO-GO'}: {result.get('reason')}")
    raise typer.Exit(1 if wrong else 0)


@app.command()
def key(file: Annotated[Path, typer.Argument(metavar="FILE", help="New key file; never overwritten.")]) -> None:
    """Make a key to sign with. Who can verify with it can also sign."""
    from bench.preflight.sign import key_id, load_key, make_key

    make_key(file)
    print(f"{file}: key {key_id(load_key(file))}; keep it to those who sign and verify")


def _print(result: dict[str, Any], as_json: bool) -> None:
    from bench.cli import print_json

    if as_json:
        print_json(result)
        return
    print(table(result))


def table(result: dict[str, Any]) -> str:
    """GO or NO-GO first, then every check, the worst first."""
    from bench.preflight.page import age, figure

    lines = [result["reason"]]
    if result["bypassed"]:
        lines.append(f"!!! BYPASSED: {', '.join(result['bypassed'])} !!!")
    lines += ["", f"{'verdict':<13}{'check':<38}{'value':<16}{'limit':<26}{'age':<6}found"]
    for row in result["checks"]:
        lines.append(f"{row['verdict']:<13}{row['name']:<38}{figure(row):<15} {row['limit']:<25} {age(row):<6}"
                     f"{row['why']}")
        if row["verdict"] != "PASS":
            action = "" if row["action"] in row["why"] else f"-> {row['action']} "
            lines.append(f"{'':<13}{action}(limit from: {row['source'] or 'none'})")
    lines += ["", result["reason"], f"{result['metrics']['total_s']} s; {result['run']}"]
    return "\n".join(lines)
