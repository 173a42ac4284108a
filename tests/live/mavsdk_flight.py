"""Fly a vehicle through MAVSDK: connect, wait until it is ready, arm, take off, fly forward, stop, land.

First start something to fly, in another terminal (it prints its addresses):

    python tests/live/world_process.py --udp-to 14550 --tcp 5760                         # embedded autopilot
    python tests/live/world_process.py --udp-to 14550 --tcp 5760 --autopilot arducopter  # the real ArduCopter

Then, the same for both, over UDP or TCP:

    python tests/live/mavsdk_flight.py udpin://127.0.0.1:14550
    python tests/live/mavsdk_flight.py tcpout://127.0.0.1:5760 --height 1.5 --speed 0.8 --forward 3

The vehicle has no GPS, so the script tells it where it is. Each step is told on standard error; one JSON object with
what MAVSDK saw goes to standard output. Exit code 0: landed and disarmed. 1: not, with the reason. 2: a bad argument.
When a step fails, or at Ctrl-C, a vehicle that is armed is told to land. Should the script be killed in flight, the
vehicle lands by itself after 5 s (FS_GCS_ENABLE), because the script speaks as system 255, a ground station.
"""

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

from mavsdk import (
    Autopilot,
    ComponentType,
    Configuration,
    ConnectionResult,
    LogLevel,
    Mavsdk,
    MavsdkError,
    System,
    Vehicle,
    log_subscribe,
)
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.info import Info
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.offboard import Offboard, VelocityBodyYawspeed
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, Telemetry

LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = 42.27381, -71.80989, 150.0
# MAVSDK's own would be 245, which ArduPilot does not watch: killed in flight, it would leave the vehicle hovering.
WATCHED_SYSTEM = 255
# DO_SET_MODE with custom mode 4, ArduCopter's GUIDED (MAVSDK reads it as OFFBOARD).
SET_GUIDED = {"target_system": 1, "target_component": 1, "command": 176, "confirmation": 0, "param1": 1.0,
              "param2": 4.0, "param3": 0.0, "param4": 0.0, "param5": 0.0, "param6": 0.0, "param7": 0.0}
TELEMETRY_HZ = 10.0
STEP_LIMIT_S = 30.0
FAILURES = (MavsdkError, ConnectionError, TimeoutError)


class Flight:
    """One vehicle and what was seen of it."""

    def __init__(self, system: System) -> None:
        self.action, self.telemetry, self.offboard = Action(system), Telemetry(system), Offboard(system)
        self.system = system
        self.seen: dict[str, Any] = {}
        self._began = time.monotonic()

    def tell(self, text: str) -> None:
        print(f"{time.monotonic() - self._began:6.1f} s  {text}", file=sys.stderr, flush=True)

    def wait(self, what: str, condition: Callable[[], bool], limit_s: float = STEP_LIMIT_S) -> None:
        """Poll until true.

        Raises:
            TimeoutError: naming what was awaited.
        """
        deadline = time.monotonic() + limit_s
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what}: not within {limit_s:g} s")
            time.sleep(0.1)
        self.tell(what)

    # ---- steps -----------------------------------------------------------------------------------
    def identify(self) -> None:
        version = Info(self.system).get_version()
        self.seen |= {
            "autopilot": Autopilot(self.system.autopilot_type()).name.title(),
            "vehicle": Vehicle(self.system.vehicle_type()).name.title(),
            "version": f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}",
            "guid_timeout_s": Param(self.system).get_param_float("GUID_TIMEOUT")}
        self.tell(f"connected: {self.seen['autopilot']} {self.seen['version']}, {self.seen['vehicle']}")

    def get_ready(self, limit_s: float) -> None:
        # ArduPilot says no more than its heartbeat and texts until it is asked.
        self.telemetry.set_rate_health(2.0)
        self.telemetry.set_rate_battery(2.0)
        self.telemetry.set_rate_in_air(TELEMETRY_HZ)
        self.telemetry.set_rate_position_velocity_ned(TELEMETRY_HZ)
        told_s = 0.0

        def ready() -> bool:
            nonlocal told_s
            if time.monotonic() - told_s > 1.0:
                told_s = time.monotonic()
                with contextlib.suppress(ActionError):  # refused until the estimator runs, and once it is set
                    self.action.set_gps_global_origin(LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M)
            health = self.telemetry.health()
            return bool(health.is_armable and health.is_local_position_ok)

        began = time.monotonic()
        self.wait("ready to arm", ready, limit_s)
        self.seen["ready_s"] = round(time.monotonic() - began, 1)
        self.wait("position heard", lambda: any((self.north_m(), self.height_m())))
        volts = self.telemetry.battery().voltage_v
        self.seen["battery_v"] = round(volts, 2) if volts > 0.0 else None  # None: it has no battery monitor

    def go_guided(self) -> None:
        """ArduPilot stays in LAND after a landing and then refuses to arm; MAVSDK has no call for this mode."""
        direct = MavlinkDirect(self.system)
        message = MavlinkMessage("COMMAND_LONG", fields_json=json.dumps(SET_GUIDED))
        asked_s = 0.0

        def guided() -> bool:
            nonlocal asked_s
            if time.monotonic() - asked_s > 2.0:
                asked_s = time.monotonic()
                direct.send_message(message)
            return FlightMode(self.telemetry.flight_mode()) is FlightMode.OFFBOARD

        self.wait("guided mode", guided)

    def take_off(self, height_m: float) -> None:
        self.action.set_takeoff_altitude(height_m)
        self.action.arm()
        self.wait("armed", self.telemetry.armed)
        ground_m = self.height_m()
        self.action.takeoff()
        self.wait("in the air", self.telemetry.in_air)
        self.wait("at height", lambda: self.height_m() - ground_m > 0.9 * height_m)
        time.sleep(1.0)
        self.seen["height_m"] = round(self.height_m() - ground_m, 2)

    def go_forward(self, speed_m_s: float, forward_m: float) -> None:
        # Not before the take-off is over: a setpoint during it would take its place.
        start_m = self.north_m()
        speeds = []

        def there() -> bool:
            speeds.append(self.telemetry.position_velocity_ned().velocity.north_m_s)
            return self.north_m() - start_m > forward_m

        self.offboard.set_velocity_body(VelocityBodyYawspeed(speed_m_s, 0.0, 0.0, 0.0))
        self.offboard.start()
        self.wait(f"{forward_m:g} m forward", there, STEP_LIMIT_S + 2.0 * forward_m / speed_m_s)
        self.seen["flight_mode"] = FlightMode(self.telemetry.flight_mode()).name
        self.seen["velocity_m_s"] = round(sum(speeds[-5:]) / len(speeds[-5:]), 2)
        self.offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0))
        time.sleep(1.5)
        self.seen["forward_m"] = round(self.north_m() - start_m, 2)

    def land(self) -> None:
        self.action.land()
        self.wait("landed and disarmed", lambda: not self.telemetry.armed())
        self.wait("reported on the ground", lambda: not self.telemetry.in_air())

    def height_m(self) -> float:
        return -float(self.telemetry.position_velocity_ned().position.down_m)

    def north_m(self) -> float:
        return float(self.telemetry.position_velocity_ned().position.north_m)


def fly(url: str, height_m: float, speed_m_s: float, forward_m: float, ready_s: float) -> dict[str, Any]:
    """The whole flight; returns what was seen.

    Raises:
        One of FAILURES: what did not work. An armed vehicle has then been told to land.
    """
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    configuration.system_id = WATCHED_SYSTEM
    with Mavsdk(configuration) as mavsdk:
        result = mavsdk.add_any_connection(url)
        if result != ConnectionResult.SUCCESS:
            raise ConnectionError(f"{url}: {result}")
        system = mavsdk.first_autopilot(timeout_s=STEP_LIMIT_S)
        if system is None:
            raise ConnectionError(f"{url}: no autopilot heard within {STEP_LIMIT_S:g} s")
        flight = Flight(system)
        flight.seen["url"] = url
        try:
            flight.identify()
            flight.get_ready(ready_s)
            flight.go_guided()
            flight.take_off(height_m)
            flight.go_forward(speed_m_s, forward_m)
            flight.land()
        except BaseException:
            if flight.telemetry.armed():
                flight.tell("landing, because of a failure")
                with contextlib.suppress(ActionError):
                    flight.action.land()
            raise
        return flight.seen


def positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be over 0")
    return value


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url", help="as MAVSDK writes it: udpin://HOST:PORT (it sends to us), udpout://HOST:PORT, "
                        "tcpout://HOST:PORT, serial:///dev/ttyUSB0:57600")
    parser.add_argument("--height", type=positive, default=1.0, help="of the take-off, m (%(default)g)")
    parser.add_argument("--speed", type=positive, default=0.5, help="forward, m/s (%(default)g)")
    parser.add_argument("--forward", type=positive, default=1.5, help="distance to fly forward, m (%(default)g)")
    parser.add_argument("--ready", type=positive, default=60.0, help="longest wait until it can arm, s (%(default)g)")
    arguments = parser.parse_args()
    log_subscribe(lambda level, *_: level < LogLevel.WARN)  # it would tell of every message
    try:
        seen = fly(arguments.url, arguments.height, arguments.speed, arguments.forward, arguments.ready)
    except FAILURES as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 1
    print(json.dumps(seen), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
