"""MAVSDK and MAVProxy connect in wall time, arm, take off, fly and land: the embedded autopilot, and the real one.

What happened is read from the physics, whatever the ground station believes.
"""

from __future__ import annotations

import json
import re
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest

from sitl.sensors import MOUNT_HEIGHT_M

if TYPE_CHECKING:
    from subprocess import CompletedProcess

    from conftest import MavProxy, World

    StartWorld = Callable[..., World]
    RunProgram = Callable[..., CompletedProcess[str]]

pytestmark = [pytest.mark.wall_time, pytest.mark.xdist_group("wall_time")]
REAL = pytest.param("arducopter", marks=pytest.mark.real_arducopter)
SPEED_M_S, FORWARD_M = 0.5, 1.5
STEP_S = 30.0


def height_m(row: dict[str, Any]) -> float:
    return -row["pos_m"][2] - MOUNT_HEIGHT_M


def wait_until(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)


def check_truth(world: World, sideways_m: float) -> None:
    """One hop of 1 m, 1.5 m or a little more forward at 0.5 m/s, down, motors off."""
    truth = world.truth
    assert max(map(height_m, truth)) == pytest.approx(1.0, abs=0.15)
    assert max(row["vel_m_s"][0] for row in truth) == pytest.approx(SPEED_M_S, abs=0.1)
    assert FORWARD_M - 0.2 < truth[-1]["pos_m"][0] < FORWARD_M + 1.2
    assert abs(truth[-1]["pos_m"][1]) < sideways_m
    assert {"GUIDED", "LAND"} <= {row["mode"] for row in truth}
    flown = [row["motors_on"] for row in truth]
    assert any(flown) and not flown[0] and not flown[-1], "the motors turn in flight and only then"
    assert truth[-1]["on_ground"] and height_m(truth[-1]) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("autopilot", ["embedded", REAL])
@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_mavsdk_flies_it(
    autopilot: str, transport: str, start_world: StartWorld, run_program: RunProgram, free_port: int
) -> None:
    # Over UDP the script alone tells the vehicle where it is, over TCP the world has done so at boot.
    ports = ("--tcp", "0", "--origin") if transport == "tcp" else ("--udp-to", str(free_port))
    world = start_world(autopilot, *ports)
    address = world.started["urls"][0].partition("://")[2]
    url = f"tcpout://{address}" if transport == "tcp" else f"udpin://{address}"
    flight = run_program("mavsdk_flight.py", url, "--height", "1", "--speed", str(SPEED_M_S), "--forward",
                         str(FORWARD_M))
    assert flight.returncode == 0, flight.stdout[-2000:] + flight.stderr[-2000:]
    world.wait("motors off", lambda row: not row["motors_on"], 5.0)
    # ArduCopter that learns late where it is learns the compass declination late, and turns by 9 deg in flight.
    check_truth(world, sideways_m=0.2 if transport == "tcp" else 0.5)
    seen = json.loads(flight.stdout)
    assert (seen["autopilot"], seen["vehicle"], seen["flight_mode"]) == ("Ardupilot", "Multicopter", "OFFBOARD")
    assert seen["version"].startswith("4." if autopilot == "arducopter" else "0.1.") and seen["guid_timeout_s"] == 3.0
    # What it saw against what was: the state estimate without GPS drifts, but not by this much.
    assert seen["height_m"] == pytest.approx(max(map(height_m, world.truth)), abs=0.12)
    assert seen["velocity_m_s"] == pytest.approx(SPEED_M_S, abs=0.1)
    assert seen["forward_m"] == pytest.approx(world.truth[-1]["pos_m"][0], abs=0.35)
    if autopilot == "embedded":
        assert seen["battery_v"] == pytest.approx(world.truth[0]["voltage_v"], abs=0.05)


@pytest.mark.parametrize("autopilot", ["embedded", REAL])
def test_mavproxy_flies_it(
    autopilot: str, mavproxy: Callable[[str], MavProxy], start_world: StartWorld, free_port: int
) -> None:
    world = start_world(autopilot, "--udp-to", str(free_port), "--origin")
    proxy = mavproxy(f"udpin:127.0.0.1:{free_port}")

    def insist(line: str, done: Callable[[dict[str, Any]], bool], every_s: float = 4.0) -> None:
        """Type it until it is done, as a pilot would: on a busy machine the vehicle may not yet be where we think."""
        deadline = time.monotonic() + STEP_S
        while not done(world.truth[-1]):
            assert time.monotonic() < deadline, f"{line!r} had no effect: {world.truth[-1]}; {proxy.said[-2000:]}"
            proxy.type(line)
            wait_until(lambda: done(world.truth[-1]), every_s)

    proxy.wait(r"Received \d+ parameters", 60.0)
    proxy.type("param set LAND_SPEED 50")
    time.sleep(1.0)
    proxy.type("param show LAND_SPEED")
    proxy.wait(r"LAND_SPEED\s+50", STEP_S)
    insist("mode guided", lambda row: row["mode"] == "GUIDED")
    insist("arm throttle", lambda row: row["motors_on"])
    insist("takeoff 1", lambda row: height_m(row) > 0.2)
    proxy.wait("NAV_TAKEOFF: ACCEPTED", STEP_S)
    world.wait("at height", lambda row: height_m(row) > 0.9, STEP_S)
    time.sleep(1.5)
    # It goes out once at every command, and the vehicle brakes after GUID_TIMEOUT without one.
    insist(f"velocity {SPEED_M_S} 0 0", lambda row: row["pos_m"][0] > FORWARD_M, every_s=1.0)
    proxy.type("velocity 0 0 0")
    time.sleep(1.5)
    insist("mode land", lambda row: row["mode"] == "LAND")
    proxy.wait("Mode LAND", STEP_S)
    proxy.wait("DISARMED", STEP_S)
    world.wait("motors off", lambda row: not row["motors_on"], 5.0)
    check_truth(world, sideways_m=0.2)


@pytest.mark.real_arducopter
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda how: how.name)
def test_arducopter_never_outlives_its_world(how: signal.Signals, start_world: StartWorld) -> None:
    world = start_world("arducopter", "--tcp", "0", "--boot", "1")
    assert [child.name() for child in world.children] == ["arducopter"]
    world.process.send_signal(how)
    assert world.process.wait(15.0) == (-how if how is signal.SIGKILL else 0)
    assert psutil.wait_procs(world.children, timeout=5.0)[1] == []


@pytest.mark.parametrize("arguments,code,told", [
    ((), 2, "no port to serve"),
    (("--tcp", "{port}"), 4, r"port {port} .* is in use"),
    (("--tcp", "0", "--autopilot", "arducopter"), 4, "sitl install"),
])
def test_a_world_that_cannot_start_says_why_in_one_line(
    arguments: tuple[str, ...], code: int, told: str, run_program: RunProgram, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        ended = run_program("world_process.py", *(argument.format(port=port) for argument in arguments),
                            ARDUCOPTER=str(tmp_path / "nowhere"))
    assert ended.returncode == code and ended.stdout == ""
    assert len(ended.stderr.splitlines()) == 1 and re.search(told.format(port=port), ended.stderr), ended.stderr
