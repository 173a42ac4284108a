"""`saranga-bench rig`: the sonar rig, its recordings, and an emulated one."""

import json
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
