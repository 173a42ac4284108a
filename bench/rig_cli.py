"""`saranga-bench rig`: the sonar rig, its recordings, and an emulated one."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The sonar rig and its recordings.")

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]

IMPORT_EXAMPLES = """\b
Examples:
  saranga-bench rig import log.txt --out echoes.mcap
      a Red Swallow log of ICU sensors; its .json configuration is taken from beside it
  saranga-bench rig import flight.csv --out flight.mcap --json
      amplitudes without header, 340 a row
  saranga-bench rig import flight.csv --out flight.mcap --option fop_hz=52300 --option odr=5
      where you know what the file does not say
  saranga-bench rig import flight.csv --out flight.mcap --option repeats=lost
      rows that repeat the row before become gaps

The recording plays anywhere with file:echoes.mcap.
"""


EMULATE_EXAMPLES = """\b
Examples:
  saranga-bench rig emulate
      prints the URL of a pty; leave it running and use the URL elsewhere
  saranga-bench rig emulate --port tcp:5555 --stand prop5 --shield foam --seed 3
      with a thrust stand behind the same port, and a shield before the propeller
  saranga-bench rig emulate --fault swapped_sensors --fault duplicates=0.02
  saranga-bench rig emulate --shield foam=12.5 --truth truth.jsonl
      a shield of 12.5 dB; what the device was given and did goes to the file

Orders on stdin: shield NAME, unplug, plug, quit. Ctrl-C ends it.
"""


@app.command(epilog=EMULATE_EXAMPLES)
def emulate(
    port: Annotated[str, typer.Option(help="pty, tcp (any free port) or tcp:PORT, on the loopback.")] = "pty",
    sonar: Annotated[str, typer.Option(help="Sensors: a name in fixtures/sonars, or a path.")] = "pair",
    stand: Annotated[
        str | None, typer.Option(metavar="NAME", help="Also a thrust stand: a name in fixtures/thrust, or a path.")
    ] = None,
    shield: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=dB]", help="Shield, the first is mounted; repeatable: more to order by stdin."),
    ] = None,
    mounting_sd_db: Annotated[float, typer.Option(help="How much two mountings of a shield differ, dB.")] = 0.0,
    reflector: Annotated[
        str, typer.Option(metavar="RANGE,AZIMUTH", help="Pole on the bench, m and degrees to the right; or none.")
    ] = "0.8,30",
    fault: Annotated[
        list[str] | None, typer.Option(metavar="NAME[=VALUE]", help="What is wrong with it; repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of noise and faults.")] = 1,
    truth: Annotated[Path | None, typer.Option(help="File for what it was given and did, JSON lines.")] = None,
    as_json: Json = False,
) -> None:
    """Run an emulated rig until it is interrupted: same bytes as the real one, nothing measured."""
    from bench.rig.emulate_command import run_emulator

    run_emulator(port, sonar, stand, shield or [], mounting_sd_db, reflector, fault or [], seed, truth, as_json)


RIG_URL = "serial:///dev/ttyACM0[?baud=N], tcp://host:port or emulated:"
CHECK_EXAMPLES = """\b
Put a pole (a bottle does) 0.4 to 1.2 m ahead and 20 to 45 degrees to the right, in a silent
room, propellers still. Then:
  saranga-bench rig check serial:///dev/ttyACM0
  saranga-bench rig check serial:///dev/ttyACM0 --reflector none --json
      without a pole; whether left is left then stays open
  saranga-bench rig check tcp://127.0.0.1:5555 --range 0.8 --temperature 23
  saranga-bench rig check "emulated:?fault=swapped_sensors"
      a rehearsal on an emulated rig with a pole at 0.8 m, and what a fault looks like

Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR, 130 interrupted.
"""


@app.command(epilog=CHECK_EXAMPLES)
def check(
    url: Annotated[str, typer.Argument(metavar="URL", help=RIG_URL)],
    seconds: Annotated[float, typer.Option(help="Of both runs together.")] = 10.0,
    rate: Annotated[float, typer.Option(help="Triggers a second, Hz.")] = 50.0,
    sonar: Annotated[str, typer.Option(help="Where the sensors sit: a name in fixtures/sonars, or a path.")] = "pair",
    reflector: Annotated[str, typer.Option(help="Side of the pole: right, left, or none (no pole).")] = "right",
    range_m: Annotated[float | None, typer.Option("--range", help="Its distance from the sensors, m.")] = None,
    temperature: Annotated[float | None, typer.Option(help="Of the air, C, where the rig does not measure it.")] = None,
    limits: Annotated[str, typer.Option(help="Name in fixtures/limits, or a path.")] = "rig",
    as_json: Json = False,
    out: Annotated[Path | None, typer.Option(help="Folder for runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
) -> None:
    """Is the rig in order? Links, ring-down, noise, synchronisation, roles, losses, each with its limit."""
    from bench.interrupt import EXIT_INTERRUPTED, interruptible
    from bench.rig.check import CheckPlan, check_rig
    from bench.rig.rehearsal import live_url
    from bench.store import Store, runs_root
    from bench.verdict import Verdict

    with interruptible() as interrupts, live_url(url, interrupts.asked) as live:
        plan = CheckPlan(live, seconds, rate, sonar, reflector, range_m, temperature, limits)
        summary = check_rig(plan, Store(runs_root(out)), interrupts.asked)
    print(json.dumps(summary, allow_nan=False, default=str) if as_json else _check_text(summary))
    raise typer.Exit(EXIT_INTERRUPTED if interrupts.asked() else Verdict(summary["verdict"]).exit_code)


def _check_text(summary: dict[str, Any]) -> str:
    lines = [f"{row['verdict']:<12} {row['name']:<32} {row['why']}" for row in summary["checks"]]
    lines += [f"  cause: {cause}" for cause in summary["causes"]]
    made = summary["provenance"]
    return "\n".join([*lines, f"{summary['verdict']}: {made['firmware']}, values {made['origin']}; {summary['run']}"])


RECORD_EXAMPLES = """\b
Examples:
  saranga-bench rig record serial:///dev/ttyACM0 --out echoes.mcap --seconds 60
  saranga-bench rig record serial:///dev/ttyACM0 --out noise.mcap --mode receive --odr 6 --samples 340
      until Ctrl-C; a pulled cable is waited for, a kill loses the last second at most

The recording plays anywhere with file:echoes.mcap, or behind a port with rig replay.
"""


@app.command(epilog=RECORD_EXAMPLES)
def record(
    url: Annotated[str, typer.Argument(metavar="URL", help=RIG_URL)],
    out: Annotated[Path, typer.Option(help="New recording, .mcap; never overwritten.")],
    seconds: Annotated[float | None, typer.Option(help="How long [until Ctrl-C].")] = None,
    mode: Annotated[str, typer.Option(help="transmit (transmit/receive) or receive (noise only).")] = "transmit",
    rate: Annotated[float, typer.Option(help="Triggers a second, Hz.")] = 1e6 / 25_600,
    odr: Annotated[int | None, typer.Option(help="2..6, with --samples [as the rig is set].")] = None,
    samples: Annotated[int | None, typer.Option(help="IQ pairs a record, 1..680, with --odr.")] = None,
    ring_down: Annotated[int | None, typer.Option(help="Ring-down cancel, samples [20; 0 to receive].")] = None,
    temperature: Annotated[float | None, typer.Option(help="Of the air, C, where the rig does not measure it.")] = None,
    as_json: Json = False,
) -> None:
    """Record everything the rig says."""
    from bench.interrupt import interruptible
    from bench.rig.record import RecordPlan
    from bench.rig.record import record as record_rig
    from bench.rig.rehearsal import live_url
    from bench.verdict import Verdict

    with interruptible() as interrupts, live_url(url, interrupts.asked) as live:
        plan = RecordPlan(live, out, seconds, mode, rate, odr, samples, ring_down, temperature)
        done = record_rig(plan, interrupts.asked, lambda s, n: print(f"{s:.0f} s, {n} cycles", file=sys.stderr))
    losses = done["losses"]
    print(json.dumps(done, allow_nan=False) if as_json else (
        f"{done['run']}: {done['cycles']} cycles in {done['duration_s']:g} s, "
        f"{done['counters']['sequence_gaps']} frames lost, {losses['unplugged']} times unplugged; "
        f"{done['provenance']['origin']}"))
    raise typer.Exit(Verdict(done["verdict"]).exit_code)


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, .mcap.")],
    port: Annotated[str, typer.Option(help="pty, tcp (any free port) or tcp:PORT, on the loopback.")] = "pty",
    speed: Annotated[float, typer.Option(help="Recorded seconds a second; 0: as fast as the host takes it.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    as_json: Json = False,
) -> None:
    """Play a recording behind a port as a rig: prints the URL, begins when the host starts it."""
    from bench.interrupt import interruptible
    from bench.rig.replay import Replay, serve_replay
    from bench.rig.serve import open_port

    source = Replay(file, speed, loop)
    rig_port = open_port(port)
    try:
        print(json.dumps({"url": rig_port.url, "origin": "recorded"}) if as_json else rig_port.url, flush=True)
        with interruptible() as interrupts:
            serve_replay(source, rig_port, interrupts.asked)
    finally:
        rig_port.close()


@app.command("import", epilog=IMPORT_EXAMPLES)
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The log.")],
    out: Annotated[Path, typer.Option(help="New recording, .mcap; never overwritten.")],
    name: Annotated[
        str | None, typer.Option("--format", metavar="NAME", help="red-swallow or inflight-csv [by its first line].")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="An option of the format; repeatable.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Turn a log of echoes made elsewhere into a recording of the rig."""
    from saranga.import_log import import_log

    done = import_log(file, out, name, _parsed(option or []))
    print(json.dumps(done, allow_nan=False) if as_json else _text(done))


def _parsed(options: list[str]) -> dict[str, Any]:
    from saranga.errors import UsageError

    values: dict[str, Any] = {}
    for text in options:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise UsageError(f"--option {text!r}: expected NAME=VALUE")
        values[key] = value
        for kind in (int, float):
            try:
                values[key] = kind(value)
                break
            except ValueError:
                continue
    return values


def _text(done: dict[str, Any]) -> str:
    lines = [
        f"{done['run']}: {done['frames']} frames of {done['sensors']} sensor{'s' * (done['sensors'] != 1)} in "
        f"{done['duration_s']:g} s, {done['lost']} lost, {done['repeated']} repeated ({done['provenance']['importer']})"
    ]
    for sensor in done["by_sensor"]:
        unsaid = "" if sensor["range_per_sample_m"] is not None else " (assumed)"
        peak = sensor["consensus"]
        where = f", mean peak at sample {peak['sample']}, {peak['range_m']:.3f} m" if peak else ""
        lines.append(
            f"  sensor {sensor['sensor']} {sensor['role'] or '-'}: fop {sensor['used_fop_hz']:g} Hz, "
            f"{sensor['samples']} samples of {sensor['used_range_per_sample_m'] * 1e3:.2f} mm{unsaid}, "
            f"{sensor['record_m']:.2f} m{where}"
        )
    for title, texts in (("note", done["notes"]), ("inferred", done["provenance"]["inferred"]),
                         ("assumed", done["provenance"]["assumed"])):
        lines += [f"  {title} {key}: {text}" for key, text in texts.items()]
    return "\n".join(lines)
