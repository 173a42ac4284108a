"""`saranga-bench sitl where|check|install`: the real ArduCopter binary."""

import json
from typing import Annotated

import typer

DEFAULT_VERSION = "4.5.7"
DEFAULT_BASE_URL = "https://firmware.ardupilot.org"

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="The real ArduCopter: find it, check it, install it."
)

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


@app.command(epilog="Example: ARDUCOPTER=~/ardupilot/build/sitl/bin/arducopter saranga-bench sitl where")
def where(as_json: Json = False) -> None:
    """Print the path of the binary that flights use; exit code 4 with what to do when there is none."""
    import os

    from saranga.errors import DeviceError
    from sitl.autopilot.binary import arducopter_path, why_absent

    absent = why_absent()
    if absent is not None:
        raise DeviceError(absent)
    path = arducopter_path()
    named_by = "ARDUCOPTER" if os.environ.get("ARDUCOPTER") else "installed"
    print(json.dumps({"path": str(path), "named_by": named_by}) if as_json else path)


@app.command(epilog="Example: saranga-bench sitl check")
def check(as_json: Json = False) -> None:
    """Say what the binary is and that it starts; exit code 4 when it is missing or the wrong firmware."""
    from bench.binaries import check_starts, inspect_binary
    from bench.provenance import sha256_of
    from saranga.errors import DeviceError
    from sitl.autopilot.binary import arducopter_path, why_absent

    absent = why_absent()
    if absent is not None:
        raise DeviceError(absent)
    firmware = inspect_binary(arducopter_path())
    check_starts(firmware.path)
    digest = sha256_of(firmware.path)
    if as_json:
        print(
            json.dumps(
                {
                    "verdict": "PASS",
                    "path": str(firmware.path),
                    "vehicle": firmware.vehicle,
                    "version": firmware.version,
                    "machine": firmware.machine,
                    "sha256": digest,
                }
            )
        )
    else:
        print(
            f"{firmware.vehicle} {firmware.version} ({firmware.machine}) at {firmware.path} starts; "
            f"sha256 {digest[:16]}"
        )


@app.command(
    epilog="Examples: saranga-bench sitl install; saranga-bench sitl install --version 4.6.0. A download "
    "that was cut off goes on where it stopped."
)
def install(
    version: Annotated[str, typer.Option(help="ArduCopter release.")] = DEFAULT_VERSION,
    base_url: Annotated[str, typer.Option(help="Firmware server or a mirror of it.")] = DEFAULT_BASE_URL,
    force: Annotated[bool, typer.Option("--force", help="Download again, and accept another checksum.")] = False,
    as_json: Json = False,
) -> None:
    """Download ArduPilot's published SITL build of ArduCopter into ~/.cache/saranga-bench."""
    from bench.sitl_install import install as fetch

    done = fetch(version, base_url, force)
    if as_json:
        print(
            json.dumps(
                {
                    "verdict": "PASS",
                    "path": str(done.path),
                    "version": version,
                    "url": done.url,
                    "sha256": done.sha256,
                    "bytes": done.size,
                    "downloaded": done.downloaded,
                }
            )
        )
    else:
        what = f"{done.size / 1e6:.1f} MB from {done.url}" if done.downloaded else "already there, checksum fits"
        print(f"{done.path}: ArduCopter {version}, {what}, sha256 {done.sha256[:16]}")
