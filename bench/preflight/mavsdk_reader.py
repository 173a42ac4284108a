"""What MAVSDK says of a vehicle, as a process of its own: a crash or hang of its library harms nobody.

    python -m bench.preflight.mavsdk_reader udpin://127.0.0.1:PORT [--log FILE]

One JSON object on standard output. It only reads; what it sends goes through `guard.py` on the other side.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

HEARD_WITHIN_S = 8.0
HEALTH_WITHIN_S = 5.0
BATTERY_WITHIN_S = 3.0


def read(url: str, log: Path | None) -> dict[str, Any]:
    """Connect and ask.

    Raises:
        ConnectionError: no autopilot heard.
    """
    from mavsdk import Autopilot, ComponentType, Configuration, ConnectionResult, Mavsdk, log_subscribe
    from mavsdk.plugins.info import Info
    from mavsdk.plugins.telemetry import Telemetry

    log_subscribe(lambda *_: True)  # its own log belongs to nobody's standard output
    configuration = Configuration.create_with_component_type(ComponentType.CUSTOM)
    configuration.system_id = 253
    configuration.always_send_heartbeats = False
    with Mavsdk(configuration) as mavsdk:
        result = mavsdk.add_any_connection(url)
        if result != ConnectionResult.SUCCESS:
            raise ConnectionError(f"MAVSDK cannot open its port: {result}")
        system = mavsdk.first_autopilot(timeout_s=HEARD_WITHIN_S)
        if system is None:
            raise ConnectionError(f"MAVSDK heard no autopilot within {HEARD_WITHIN_S:g} s")
        version = Info(system).get_version()
        telemetry = Telemetry(system)
        telemetry.set_rate_battery(5.0)
        seen: dict[str, Any] = {
            "autopilot": Autopilot(system.autopilot_type()).name.title(),
            "version": [version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch],
            "health": _health(telemetry),
            "voltage_v": _voltage(telemetry),
        }
        if log is not None:
            seen["log"] = _download(system, log)
        return seen


def _health(telemetry: Any) -> dict[str, bool]:
    """Until all is well, or time is up: it begins as all False, before anything was heard."""
    deadline = time.monotonic() + HEALTH_WITHIN_S
    while True:
        health = telemetry.health()
        seen = {"gyroscope calibrated": bool(health.is_gyrometer_calibration_ok),
                "accelerometer calibrated": bool(health.is_accelerometer_calibration_ok),
                "local position": bool(health.is_local_position_ok)}
        if all(seen.values()) or time.monotonic() > deadline:
            return seen
        time.sleep(0.1)


def _voltage(telemetry: Any) -> float | None:
    """The first samples are 0 or not numbers."""
    deadline = time.monotonic() + BATTERY_WITHIN_S
    while time.monotonic() < deadline:
        volts = float(telemetry.battery().voltage_v)
        if math.isfinite(volts) and volts > 0.0:
            return volts
        time.sleep(0.1)
    return None


def _download(system: Any, log: Path) -> dict[str, Any]:
    """The newest log of the vehicle into a new file."""
    import threading

    from mavsdk.plugins.log_files import LogFiles

    files = LogFiles(system)
    entries = files.get_entries()
    entries = entries[1] if isinstance(entries, tuple) else entries
    if not entries:
        return {"failed": "the vehicle keeps no log"}
    newest = max(entries, key=lambda entry: entry.id)
    done = threading.Event()
    state: dict[str, Any] = {"size_bytes": newest.size_bytes, "share": 0.0}

    def progressed(*values: Any) -> None:
        for value in values:
            share = getattr(value, "progress", None)
            if share is not None:
                state["share"] = float(share)
        if state["share"] >= 1.0 or any("SUCCESS" in str(value) for value in values):
            done.set()

    files.download_log_file_async(newest, str(log), progressed)
    if not done.wait(60.0):
        state["failed"] = "not complete within 60 s"
    return state


def main(argv: list[str] | None = None) -> int:
    """Command line; 0 with an object that has the values, 1 with one that has `failed`."""
    parser = argparse.ArgumentParser(prog="python -m bench.preflight.mavsdk_reader", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url")
    parser.add_argument("--log", type=Path)
    arguments = parser.parse_args(argv)
    try:
        seen = read(arguments.url, arguments.log)
    except ImportError as error:
        seen = {"failed": f"MAVSDK is not installed or does not start: {error}"}
    except Exception as error:  # whatever a foreign library raises is an answer here
        seen = {"failed": f"{type(error).__name__}: {error}"}
    print(json.dumps(seen), flush=True)
    return 1 if "failed" in seen else 0


if __name__ == "__main__":
    sys.exit(main())
