"""The companion loop: when it may command, what it says last, and how it ends. Never arms, never changes mode."""

import threading
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga import companion as companion_module
from saranga.companion import Companion, may_command
from saranga.denoise import load_denoiser
from saranga.echo import load_sonar
from saranga.errors import DeviceError
from saranga.navigate import load_policy
from saranga.sources import InProcessSource
from saranga.stack import Stack
from saranga.vehicle import VehicleLink

GUIDED, LAND = 4, 9
IN_AIR, TAKING_OFF, ON_GROUND = 2, 3, 1


class Vehicle:
    """A byte link with a vehicle behind it that is in one state all the time."""

    url = "test:"

    def __init__(self, armed: bool = True, mode: int = GUIDED, landed: int = IN_AIR, silent: bool = False) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser = mavlink.MAVLink(None)
        self.armed, self.mode, self.landed, self.silent = armed, mode, landed, silent
        self.heard: list[Any] = []

    def open(self) -> None: ...

    def close(self) -> None: ...

    def read(self, timeout_s: float) -> bytes:
        if self.silent:
            return b""
        base = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        return b"".join(message.pack(self._mav) for message in (
            mavlink.MAVLink_heartbeat_message(2, 3, base, self.mode, 4, 3),
            mavlink.MAVLink_extended_sys_state_message(0, self.landed)))

    def write(self, data: bytes) -> None:
        self.heard += self._parser.parse_buffer(data) or []

    def kinds(self) -> set[str]:
        return {m.get_type() for m in self.heard}


def run(vehicle: Vehicle, seconds: float = 0.5, log: Path | None = None) -> tuple[Companion, list[str]]:
    said: list[str] = []
    stack = Stack(load_denoiser("gaussian"), load_policy("none"), load_sonar("pair"))
    companion = Companion(stack, InProcessSource(), vehicle, log, said.append)
    threading.Timer(seconds, companion.stop, ["test"]).start()
    assert companion.run() == "test"
    return companion, said


@pytest.mark.parametrize("armed,mode,landed,allowed", [
    (True, GUIDED, IN_AIR, True), (False, GUIDED, IN_AIR, False), (True, LAND, IN_AIR, False),
    (True, GUIDED, TAKING_OFF, False), (True, GUIDED, ON_GROUND, False)])
def test_setpoints_only_while_armed_guided_and_in_the_air(armed: bool, mode: int, landed: int, allowed: bool) -> None:
    vehicle = Vehicle(armed, mode, landed)
    companion, _ = run(vehicle)
    assert ("SET_POSITION_TARGET_LOCAL_NED" in vehicle.kinds()) is allowed
    assert may_command(companion.link) is allowed
    assert not vehicle.kinds() & {"SET_MODE", "MISSION_ITEM_INT", "PARAM_SET"}
    commands = {m.command for m in vehicle.heard if m.get_type() == "COMMAND_LONG"}
    assert commands <= {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}


def test_without_echoes_it_holds_position_names_the_fault_and_stops_the_vehicle_at_the_end() -> None:
    vehicle = Vehicle()
    companion, said = run(vehicle, 1.4)
    setpoints = [m for m in vehicle.heard if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert len(setpoints) > 10 and all((m.vx, m.vy, m.vz) == (0.0, 0.0, 0.0) for m in setpoints)
    assert companion.tally.faults > 10 and "FAULT echo source silent" in said[-1]


def test_the_log_has_one_line_a_tick(tmp_path: Path) -> None:
    companion, _ = run(Vehicle(), 0.5, tmp_path / "log.jsonl")
    lines = (tmp_path / "log.jsonl").read_text().splitlines()
    assert len(lines) == companion.tally.ticks > 4 and '"fault": "waiting for the first echoes"' in lines[0]


def test_the_rate_is_16_hz() -> None:
    vehicle = Vehicle()
    started = time.monotonic()
    companion, _ = run(vehicle, 2.0)
    rate_hz = companion.tally.ticks / (time.monotonic() - started)
    assert 12.0 < rate_hz < 18.0


def test_a_vehicle_never_heard_and_one_gone_silent_are_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(companion_module, "FIRST_HEARTBEAT_S", 0.3)
    with pytest.raises(DeviceError, match="no heartbeat of system 1"):
        run(Vehicle(silent=True), 5.0)
    monkeypatch.setattr(companion_module, "VEHICLE_SILENT_S", 0.3)
    vehicle = Vehicle()
    threading.Timer(0.3, setattr, [vehicle, "silent", True]).start()
    with pytest.raises(DeviceError, match="vehicle silent"):
        run(vehicle, 5.0)
    last = [m for m in vehicle.heard if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"][-1]
    assert (last.vx, last.vy, last.vz) == (0.0, 0.0, 0.0)


def test_a_link_state_that_was_never_heard_allows_nothing() -> None:
    assert not may_command(VehicleLink())


def test_warming_up_leaves_no_trace() -> None:
    stack = Stack(load_denoiser("tbd"), load_policy("saranga"), load_sonar("pair"))
    stack.warm_up()
    decision = stack.step([], 0)
    assert decision.fault == "waiting for the first echoes" and not decision.obstacles
    assert all(not image.any() for image in decision.images.values())
