"""`saranga-bench rig emulate`: from options to a running device."""

import json
import math
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

from bench.rig.bench_acoustics import Reflector
from bench.rig.emulator import EmulatedDevice, Plant
from bench.rig.faults import parse_faults
from bench.rig.noise_law import NoiseLaw, parse_shields
from bench.rig.serve import BACKLOG_US, Orders, TruthFile, open_port, serve
from saranga.echo import load_sonar
from saranga.errors import UsageError


def parse_reflector(text: str) -> Reflector | None:
    """`RANGE,AZIMUTH` in metres and degrees to the right, or "none".

    Raises:
        UsageError: anything else.
    """
    if text == "none":
        return None
    try:
        range_m, azimuth_deg = (float(part) for part in text.split(","))
    except ValueError:
        range_m = azimuth_deg = math.nan
    if not (0.15 <= range_m <= 5.0 and -80.0 <= azimuth_deg <= 80.0):
        raise UsageError(f"--reflector {text!r}: expected RANGE,AZIMUTH with 0.15..5 m and -80..80 degrees, or none")
    return Reflector(range_m, azimuth_deg)


def load_plant(name: str, seed: int) -> Plant:
    """The emulated propeller, motor and battery of a name in fixtures/thrust, or of a path."""
    from bench.thrust_stand import plant

    return plant.load_plant(name, seed)


def make_device(sonar: str, stand: str | None, shields: list[str], mounting_sd_db: float, reflector: str,
                faults: list[str], seed: int, **more: Any) -> EmulatedDevice:
    """An emulated device from the texts of the command line.

    Raises:
        UsageError: any of them is unknown or out of its limits.
    """
    if not 0.0 <= mounting_sd_db <= 10.0:
        raise UsageError(f"--mounting-sd-db {mounting_sd_db}: must be 0..10")
    noise = NoiseLaw(insertion_loss_db=parse_shields(shields), mounting_sd_db=mounting_sd_db)
    plant = load_plant(stand, seed) if stand else None
    return EmulatedDevice(load_sonar(sonar), plant, noise, parse_faults(faults),
                          shield=shields[0].partition("=")[0] if shields else "none",
                          reflector=parse_reflector(reflector), seed=seed, **more)


def run_emulator(port: str, sonar: str, stand: str | None, shields: list[str], mounting_sd_db: float, reflector: str,
                 faults: list[str], seed: int, truth_path: Path | None, as_json: bool) -> None:
    """Serve until SIGINT, SIGTERM or SIGHUP; the URL is the first thing on stdout."""
    stopped: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.append(number)

    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, stop)
    rig_port = open_port(port)
    began_s = time.monotonic()
    truth = TruthFile(truth_path, began_s)
    try:
        device = make_device(sonar, stand, shields, mounting_sd_db, reflector, faults, seed, truth=truth,
                             backlog_us=BACKLOG_US)
        truth({"event": "given", **device.given()})
        # Compile and fill the tables before anybody waits for a frame.
        device.warm_up()
        began_s = time.monotonic()
        truth.began_s = began_s
        print(json.dumps({"url": rig_port.url, "given": device.given()}) if as_json else rig_port.url, flush=True)
        serve(device, rig_port, truth, began_s, lambda: bool(stopped), Orders(sys.stdin))
    finally:
        rig_port.close()
        truth.close()
