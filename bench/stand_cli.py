"""`saranga-bench stand`: thrust stands, their drivers and their files. Nothing here spins a motor."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Thrust stands: files, drivers, a check at rest.")

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Options = Annotated[
    list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="An option of the format; repeatable.")
]

IMPORT_EXAMPLES = """\b
Examples:
  saranga-bench stand import sweep.csv
      an RCbenchmark file, whatever units its header names
  saranga-bench stand import sweep.csv --out sweep-si.csv --json
  saranga-bench stand import sweep.csv --option rpm=optical --option thrust_sign=-1

The table plays as a stand with file:sweep.csv.
"""
CHECK_EXAMPLES = """\b
Examples:
  saranga-bench stand check teensy+serial:///dev/ttyACM0
  saranga-bench stand check "lines+serial:///dev/ttyUSB0?baud=57600&columns=time:ms,thrust:gf"
  saranga-bench stand check emulated:

Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 4 ERROR.
"""
FIT_EXAMPLES = """\b
Example:
  saranga-bench stand fit mine_7v.csv mine_11v.csv --name mine --diameter-m 0.0762 --out mine.toml
  saranga-bench stand check "emulated:?propeller=mine.toml"
"""


@app.command("import", epilog=IMPORT_EXAMPLES)
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV of a thrust stand.")],
    out: Annotated[Path | None, typer.Option(help="New CSV in SI; never overwritten.")] = None,
    option: Options = None,
    as_json: Json = False,
) -> None:
    """Read a file of a thrust stand: units to SI, signs kept, the fit of thrust over speed."""
    from bench.rig_cli import _parsed
    from bench.thrust_stand.export import sweep_text, write_si_csv
    from bench.thrust_stand.formats import read_sweep

    table = read_sweep(file, **_parsed(option or []))
    if out is not None:
        write_si_csv(table, out)
    print(json.dumps({**table.json(), "out": str(out) if out else None}, allow_nan=False) if as_json
          else sweep_text(table))


@app.command(epilog=CHECK_EXAMPLES)
def check(
    url: Annotated[str, typer.Argument(metavar="URL", help="Of a stand; see `stand drivers`.")],
    as_json: Json = False,
) -> None:
    """Open a stand, say what it measures, watch it at rest and tare it. Nothing spins."""
    from bench.thrust_stand.registry import open_stand
    from bench.thrust_stand.stand_check import check_stand, report_text
    from bench.verdict import Verdict

    report = check_stand(open_stand(url))
    print(json.dumps(report, allow_nan=False) if as_json else report_text(report))
    raise typer.Exit(Verdict(report["verdict"]).exit_code)


@app.command(epilog="Example: saranga-bench stand drivers")
def drivers(as_json: Json = False) -> None:
    """List the drivers of stands and throttles with the URLs they take."""
    from bench.thrust_stand.registry import driver_modules

    found: list[dict[str, Any]] = [
        {"name": name, "measures": module.MEASURES, "spins": module.SPINS, "urls": module.FORMS,
         "about": (module.__doc__ or "").splitlines()[0]}
        for name, module in driver_modules().items()
    ]
    if as_json:
        print(json.dumps({"drivers": found}))
        return
    for driver in found:
        does = " and ".join(word for word, is_so in (("measures", driver["measures"]), ("spins", driver["spins"]))
                            if is_so)
        print(f"{driver['name']}: {does}. {driver['about']}\n    {driver['urls']}")


@app.command(epilog=FIT_EXAMPLES)
def fit(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Static sweeps of one motor and propeller.")],
    name: Annotated[str, typer.Option(help="Of the emulated stand.")],
    out: Annotated[Path, typer.Option(help="New .toml; never overwritten.")],
    diameter_m: Annotated[float, typer.Option(help="Of the propeller.")],
    blades: Annotated[int, typer.Option(help="Of the propeller.")] = 3,
    licence: Annotated[str, typer.Option(help="Of the sweeps.")] = "own measurement",
) -> None:
    """Fit an emulated motor and propeller to real sweeps, for `emulated:` and `rig emulate --stand`."""
    from bench.thrust_stand.fitting import fit_plant, plant_text
    from saranga.errors import DeviceError, UsageError

    if not 0.02 <= diameter_m <= 2.0:
        raise UsageError(f"--diameter-m {diameter_m}: must be 0.02..2")
    tables = fit_plant(files, name, f"Fitted to {', '.join(path.name for path in files)}", licence, diameter_m, blades)
    try:
        with out.open("x", encoding="utf-8") as file:
            file.write(plant_text(tables))
    except FileExistsError:
        raise UsageError(f"--out {out} exists: results are never overwritten; choose another name") from None
    except OSError as error:
        raise DeviceError(f"--out {out} cannot be written: {error.strerror}") from error
    source = tables["source"]
    print(f"{out}: speed within {100 * source['rotation_rms']:.1f} % (RMS), thrust within "
          f"{100 * source['thrust_rms_of_max']:.1f} % of the largest, power within {100 * source['power_rms']:.1f} %")
