"""Fly through MAVSDK: connect, check, arm, take off, fly forward, land. Against the embedded or the real ArduCopter.

    python tests/live/mavsdk_flight.py tcpout://127.0.0.1:5760

Prints one JSON object with what MAVSDK saw. Exit code 0 only when the vehicle landed and disarmed.
"""

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

from mavsdk import ComponentType, Configuration, ConnectionResult, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.info import Info
from mavsdk.plugins.offboard import Offboard, VelocityBodyYawspeed
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = 42.27381, -71.80989, 150.0


def wait(what: str, condition: Callable[[], bool], timeout_s: float) -> None:
    """Poll until true.

    Raises:
        TimeoutError: naming what was awaited.
    """
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what}: not within {timeout_s:g} s")
        time.sleep(0.1)


def fly(url: str, height_m: float, speed_m_s: float, seconds: float, ready_s: float) -> dict[str, Any]:
    """The whole flight; returns what was seen."""
    seen: dict[str, Any] = {"url": url}
    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        result = mavsdk.add_any_connection(url)
        if result != ConnectionResult.SUCCESS:
            raise ConnectionError(f"{url}: {result}")
        system = mavsdk.first_autopilot(timeout_s=10.0)
        if system is None:
            raise ConnectionError(f"{url}: no autopilot heard within 10 s")
        action, telemetry, offboard = Action(system), Telemetry(system), Offboard(system)
        seen["autopilot"], seen["vehicle"] = str(system.autopilot_type()), str(system.vehicle_type())
        version = Info(system).get_version()
        seen["version"] = f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
        seen["guid_timeout_s"] = Param(system).get_param_float("GUID_TIMEOUT")
        deadline = time.monotonic() + ready_s
        while True:
            with contextlib.suppress(ActionError):  # refused until the estimator runs, and once it is set
                action.set_gps_global_origin(LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M)
            time.sleep(1.0)
            health = telemetry.health()
            if health.is_armable and health.is_local_position_ok:
                break
            if time.monotonic() > deadline:
                raise TimeoutError(f"not ready within {ready_s:g} s: {health}")
        seen["battery_v"] = round(telemetry.battery().voltage_v, 2)
        action.set_takeoff_altitude(height_m)
        action.arm()
        wait("armed", telemetry.armed, 5.0)
        action.takeoff()
        telemetry.set_rate_velocity_ned(10.0)
        telemetry.set_rate_position(10.0)
        wait("in the air", telemetry.in_air, 10.0)
        wait("at height", lambda: telemetry.position().relative_altitude_m > 0.9 * height_m, 15.0)
        seen["height_m"] = round(telemetry.position().relative_altitude_m, 2)
        # Only now: a setpoint during the take-off would take its place.
        offboard.set_velocity_body(VelocityBodyYawspeed(speed_m_s, 0.0, 0.0, 0.0))
        offboard.start()
        time.sleep(seconds)
        seen["flight_mode"] = str(telemetry.flight_mode())
        seen["velocity_m_s"] = round(telemetry.velocity_ned().north_m_s, 2)
        offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0))
        time.sleep(1.5)
        action.land()
        wait("on the ground and disarmed", lambda: not telemetry.armed(), 20.0)
        wait("reported on the ground", lambda: not telemetry.in_air(), 5.0)
        seen["landed"] = not telemetry.in_air()
    return seen


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url", help="as MAVSDK writes it, such as tcpout://127.0.0.1:5760 or udpin://127.0.0.1:14550")
    parser.add_argument("--height", type=float, default=1.0)
    parser.add_argument("--speed", type=float, default=0.5)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--ready", type=float, default=60.0, help="seconds to wait for it to be ready to arm")
    arguments = parser.parse_args()
    seen = fly(arguments.url, arguments.height, arguments.speed, arguments.seconds, arguments.ready)
    print(json.dumps(seen), flush=True)
    return 0 if seen["landed"] else 1


if __name__ == "__main__":
    sys.exit(main())
