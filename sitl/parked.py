"""A vehicle parked on a flat floor in wall time, for preflight to look at: it stands there, disarmed, and talks.

    python -m sitl.parked                                         # the embedded autopilot behind a TCP port
    python -m sitl.parked --autopilot arducopter --port pty       # the real ArduCopter behind a serial port
    python -m sitl.parked --fault no_flow --fault BATT_LOW_VOLT=0

It boots as fast as the machine allows, prints one JSON line with its URL, and then serves until Ctrl-C, --seconds,
or the end of the pipe that is its standard input. Nothing here arms: the motors stand still.
"""

import argparse
import contextlib
import json
import math
import os
import select
import stat
import sys
import time
from pathlib import Path
from typing import Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import DeviceError, UsageError
from saranga.vehicle import VehicleLink, version_text
from sitl.airframe import load_airframe
from sitl.autopilot import KINDS
from sitl.autopilot.arducopter import ArduCopter
from sitl.autopilot.base import Autopilot
from sitl.autopilot.binary import require_binary
from sitl.autopilot.embedded import EmbeddedAutopilot
from sitl.autopilot.embedded.parameters import BY_NAME
from sitl.autopilot.parameters import Parameter, load_parameters
from sitl.autopilot.servers import TcpServer, UdpServer
from sitl.clock import Delayed, Periodic
from sitl.ground_control import ALTITUDE_M, LATITUDE_DEG, LONGITUDE_DEG, ORIGIN_FROM_US
from sitl.parked_faults import Disguise, ParkedFaults, parse_parked_faults
from sitl.physics import Physics
from sitl.process import serve_until_told
from sitl.rig_ports import PtyPort
from sitl.sensors import FlightSensors

SETS = ("arducopter-gps-denied", "preflight")
# The battery of the airframe under no load, and logs kept; on the simulator only.
SIMULATOR = {"SIM_BATT_VOLTAGE": 16.6}
BOOT_S = {"embedded": 6.0, "arducopter": 26.0}
READY_LIMIT_S = 70.0
SLOW_US = 500_000
# Simulated time that a busy machine cannot make up for is given up, in steps as small as this.
BEHIND_LIMIT_S = 0.1
MOST_TICKS = 40
STALL_EVERY_US = 500_000
SHAKE_HZ = 45.0


class Port(Protocol):
    """Where preflight connects."""

    url: str

    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class NetworkPort:
    """TCP or UDP on the loopback, as a byte port."""

    def __init__(self, server: TcpServer | UdpServer) -> None:
        self._server = server
        self.url = server.url.replace("udp://", "udpout://")

    def read(self) -> bytes:
        return self._server.poll()

    def write(self, data: bytes) -> None:
        self._server.send(data)

    def close(self) -> None:
        self._server.close()


class SerialPort:
    """A pty that never drops a frame while somebody listens: what does not fit waits."""

    LONGEST = 1 << 18

    def __init__(self) -> None:
        self._port = PtyPort()
        self.url = self._port.url
        self._waiting = b""

    def read(self) -> bytes:
        return self._port.read()

    def write(self, data: bytes) -> None:
        self._waiting = (self._waiting + data)[-self.LONGEST:]
        if not self._port.busy:
            self._port.write(self._waiting)
            self._waiting = b""

    def close(self) -> None:
        self._port.close()


def open_port(kind: str) -> Port:
    """"tcp", "udp" (any free port) or "pty".

    Raises:
        UsageError: none of these. DeviceError: it cannot be had.
    """
    if kind == "tcp":
        return NetworkPort(TcpServer(port=0))
    if kind == "udp":
        return NetworkPort(UdpServer(port=0))
    if kind == "pty":
        return SerialPort()
    raise UsageError(f"--port {kind!r}: must be tcp, udp or pty")


def make_parked(kind: str, seed: int, workdir: Path | None, faults: ParkedFaults) -> Autopilot:
    """An autopilot with the parameters that preflight wants, less what the faults change.

    Raises:
        UsageError: unknown kind or parameter. DeviceError: no ArduCopter binary.
    """
    merged = {p.name: p for name in SETS for p in load_parameters(name)}
    if kind == "embedded":
        values = {name: p.value for name, p in merged.items() if name in BY_NAME} | faults.parameters
        return EmbeddedAutopilot(seed, values)
    if kind != "arducopter":
        raise UsageError(f"unknown autopilot {kind!r}: known are {', '.join(KINDS)}")
    require_binary()
    autopilot = ArduCopter(workdir)
    for name, value in (SIMULATOR | faults.parameters).items():
        merged[name] = Parameter(name, value, "parked", name, value)
    autopilot.parameters = list(merged.values())
    return autopilot


class ParkedVehicle:
    """One autopilot in one vehicle that stands on the floor.

    Raises:
        UsageError, DeviceError: as `make_parked`.
    """

    def __init__(self, kind: str, faults: ParkedFaults, seed: int = 1, workdir: Path | None = None) -> None:
        self.faults = faults
        self.physics = Physics(load_airframe(), np.zeros(3), seed=seed)
        self.sensors = FlightSensors(seed)
        self.sensors.flow_enabled = not faults.no_flow
        self.sensors.range_enabled = not faults.no_range
        self.sensors.flow_quality = int(faults.flow_quality)
        self.sensors.flow_every = max(int(faults.flow_every), 1)
        self.sensors.range_offset_m = faults.range_offset_m
        self.autopilot = make_parked(kind, seed, workdir, faults)
        self._link = VehicleLink(target_system=self._system())
        self._slow = Periodic(SLOW_US)
        self._disguise = Disguise(faults, seed)
        self._late = Delayed()
        self._origin_sent = 0

    def _system(self) -> int:
        return int(next((v for n, v in self.faults.parameters.items() if n in ("MAV_SYSID", "SYSID_THISMAV")), 1))

    @property
    def t_us(self) -> int:
        return self.physics.state.t_us

    @property
    def version(self) -> str:
        """As it gives it itself."""
        return version_text(self._link.status.firmware_version)

    def tick(self, companion: bytes) -> bytes:
        """One physics tick; bytes of who is connected in, bytes for them out.

        Raises:
            DeviceError: the autopilot died.
        """
        state = self.physics.state
        heard = self.sensors.step(state) + self._link.take() + companion
        shake_m_s2 = self.faults.shake_m_s2 * math.sin(2.0 * math.pi * SHAKE_HZ * state.t_us * 1e-6)
        state.accel_body_m_s2[2] += shake_m_s2
        throttle, out = self.autopilot.step(state, heard)
        state.accel_body_m_s2[2] -= shake_m_s2
        if throttle.any():
            raise DeviceError("a parked vehicle turns its motors: stopped")
        self.physics.step(self.autopilot.tick_us, throttle)
        self._link.feed(out, state.t_us)
        if self._slow.due(state.t_us):
            self._tell_where()
        out = self._disguise(out)
        delay_us, stall_us = self.faults.delay_ms * 1e3, self.faults.stall_ms * 1e3
        if not (delay_us or stall_us):
            return out
        if out:
            left_us = max(stall_us - state.t_us % STALL_EVERY_US, 0.0)
            self._late.put(state.t_us + round(delay_us + left_us), out)
        return self._late.take(state.t_us)

    def _tell_where(self) -> None:
        if self._link.status.firmware_version is None:
            self._link.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if not self.faults.no_origin and self.t_us > ORIGIN_FROM_US and self._origin_sent < 8:
            self._origin_sent += 1
            self._link.send_origin(LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M)

    def boot(self, least_s: float) -> None:
        """As fast as the machine allows.

        Raises:
            DeviceError: the autopilot died.
        """
        self.autopilot.start(self.physics.state)
        while self.t_us < least_s * 1e6:
            self.tick(b"")

    def serve(self, port: Port, seconds: float, stop: "Stop") -> None:
        """Wall time, from now on."""
        first_us, began, late_s, spoken = self.t_us, time.monotonic(), 0.0, b""
        while (wall_s := time.monotonic() - began) < seconds and not stop():
            spoken += port.read()
            late_s = max(late_s, wall_s - (self.t_us - first_us) / 1e6 - BEHIND_LIMIT_S)
            for _ in range(MOST_TICKS):
                if (self.t_us - first_us) / 1e6 >= wall_s - late_s:
                    break
                out, spoken = self.tick(spoken), b""
                port.write(out)
            time.sleep(0.001)

    def close(self) -> None:
        self.autopilot.close()


class Stop(Protocol):
    """Whether to end."""

    def __call__(self) -> bool: ...


def _stdin_ended() -> Stop:
    """True once the pipe that is standard input is closed; never where it is no pipe."""
    stdin = sys.stdin.fileno()
    piped = stat.S_ISFIFO(os.fstat(stdin).st_mode)

    def ended() -> bool:
        return piped and bool(select.select([stdin], [], [], 0.0)[0]) and not os.read(stdin, 4096)

    return ended


def run(arguments: argparse.Namespace) -> None:
    """Boot, say where, serve."""
    faults = parse_parked_faults(arguments.fault)
    with contextlib.ExitStack() as stack:
        port = stack.enter_context(contextlib.closing(open_port(arguments.port)))
        vehicle = stack.enter_context(contextlib.closing(
            ParkedVehicle(arguments.autopilot, faults, arguments.seed, arguments.workdir)))
        began = time.monotonic()
        vehicle.boot(BOOT_S[arguments.autopilot] if arguments.boot is None else arguments.boot)
        print(json.dumps({"url": port.url, "autopilot": arguments.autopilot, "version": vehicle.version,
                          "boot_wall_s": round(time.monotonic() - began, 2)}), flush=True)
        vehicle.serve(port, arguments.seconds, _stdin_ended())


def main(argv: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m sitl.parked", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--autopilot", choices=KINDS, default=KINDS[0])
    parser.add_argument("--port", default="tcp", help="tcp, udp or pty (%(default)s)")
    parser.add_argument("--fault", action="append", default=[], metavar="NAME[=VALUE]", help="repeatable")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=600.0, help="of wall time after the boot (%(default)g)")
    parser.add_argument("--boot", type=float, metavar="S", help="simulated seconds before it is served")
    parser.add_argument("--workdir", type=Path, help="where arducopter runs (a temporary folder)")
    return serve_until_told(lambda: run(parser.parse_args(argv)))


if __name__ == "__main__":
    sys.exit(main())
