"""One vehicle over a flat floor in wall time, for ground stations to connect to: physics, flight sensors, autopilot.

    python tests/live/world_process.py --udp-to 14550 --origin                          # the embedded autopilot
    python tests/live/world_process.py --udp-to 14550 --origin --autopilot arducopter   # the real one

The autopilot first boots as fast as the machine allows: with --origin until it is ready to arm, else for --boot
seconds. Then one JSON line tells the addresses, and wall time runs; the truth follows five times a second, one JSON
object a line. It ends after --seconds, at Ctrl-C, or when the pipe that is its standard input closes.
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
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import DeviceError, UsageError
from saranga.vehicle import VehicleLink, version_text
from sitl.airframe import load_airframe
from sitl.autopilot import KINDS, make_autopilot
from sitl.autopilot.parameters import mismatches
from sitl.autopilot.servers import MavlinkPort, TcpServer, UdpClient, UdpServer
from sitl.clock import Periodic
from sitl.ground_control import ALTITUDE_M, LATITUDE_DEG, LONGITUDE_DEG, ORIGIN_FROM_US
from sitl.physics import Physics
from sitl.process import serve_until_told
from sitl.sensors import FlightSensors

REPORT_US = 200_000
SLOW_US = 500_000
# ArduCopter compares its sensors for 22 s before it lets anyone arm; the embedded autopilot needs 4 s.
BOOT_S = {"embedded": 5.0, "arducopter": 25.0}
READY_LIMIT_S = 60.0
PARAMETERS_AT_ONCE = 8
# On a busy machine simulated time runs late rather than in leaps: a ground station's heartbeats and setpoints must
# reach the vehicle at about their own rate, or its failsafes act.
BEHIND_LIMIT_S = 0.1


class World:
    """One autopilot in one vehicle, and a companion (component 191) that reads along.

    Raises:
        UsageError: an unknown autopilot.
        DeviceError: it cannot be started.
    """

    def __init__(self, kind: str, workdir: Path | None) -> None:
        self.physics = Physics(load_airframe(), np.zeros(3), seed=1)
        self.sensors = FlightSensors(1)
        self.link = VehicleLink()
        self.autopilot, self.parameters = make_autopilot(kind, 1, workdir)
        self.motors_on = False
        self.origin_known = False
        self._slow = Periodic(SLOW_US)

    @property
    def t_us(self) -> int:
        return self.physics.state.t_us

    def tick(self, ground_station: bytes) -> bytes:
        """One physics tick; MAVLink of the ground stations in, of the autopilot out."""
        state = self.physics.state
        throttle, out = self.autopilot.step(state, self.sensors.step(state) + self.link.take() + ground_station)
        self.motors_on = bool(throttle.any())
        self.physics.step(self.autopilot.tick_us, throttle)
        for message in self.link.feed(out, state.t_us):
            self.origin_known |= message.get_type() == "GPS_GLOBAL_ORIGIN"
        return out

    def boot(self, origin: bool, least_s: float) -> None:
        """Run as fast as possible until ready (`origin`: and told where it is), then for `least_s` in all.

        Raises:
            DeviceError: not ready in time, or its parameters are not the ones asked for.
        """
        self.autopilot.start(self.physics.state)
        while self.t_us < least_s * 1e6 or self._unread() or (origin and not self.ready):
            if self.t_us > READY_LIMIT_S * 1e6:
                raise DeviceError(f"{self.autopilot.kind} not ready in {READY_LIMIT_S:g} simulated s: {self._why()}")
            if self._slow.due(self.t_us):
                self._ask(origin)
            self.tick(b"")
        wrong = mismatches(self.parameters, self._version, self.link.status.parameters)
        if wrong:
            raise DeviceError(f"{self.autopilot.kind}: parameters differ after start: {'; '.join(wrong[:5])}")

    @property
    def ready(self) -> bool:
        return self.origin_known and self.link.status.prearm_ok and self.link.status.flow_aiding

    @property
    def _version(self) -> tuple[int, int]:
        packed = self.link.status.firmware_version or 0
        return packed >> 24 & 0xFF, packed >> 16 & 0xFF

    def _unread(self) -> list[str]:
        if self.link.status.firmware_version is None:
            return ["AUTOPILOT_VERSION"]
        names = (p.spelling(self._version)[0] for p in self.parameters)
        return [name for name in names if name not in self.link.status.parameters]

    def _ask(self, origin: bool) -> None:
        """Single messages are asked for, not streams: the streams belong to the ground station that comes."""
        link = self.link
        if link.status.firmware_version is None:
            link.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            return
        for name in self._unread()[:PARAMETERS_AT_ONCE]:
            link.request_parameter(name)
        link.request_message(mavlink.MAVLINK_MSG_ID_SYS_STATUS)
        link.request_message(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
        if origin and not self.origin_known and self.t_us > ORIGIN_FROM_US:
            link.send_origin(LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M)

    def _why(self) -> str:
        status = self.link.status
        return (f"prearm {'ok' if status.prearm_ok else 'refused'}, EKF flags {status.ekf_flags}, origin "
                f"{'known' if self.origin_known else 'unknown'}, unread {self._unread()[:3]}; last word: "
                f"{status.last_text('prearm', 'arm:') or status.last_text()!r}")

    def truth(self) -> dict[str, Any]:
        """What the physics knows, and the autopilot's mode by its last heartbeat. `motors_on` is what armed means."""
        state = self.physics.state
        w, x, y, z = state.quat.tolist()
        yaw_deg = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        return {"t_s": state.t_us / 1e6, "pos_m": state.pos_m.tolist(), "vel_m_s": state.vel_m_s.tolist(),
                "yaw_deg": yaw_deg, "on_ground": state.on_ground, "motors_on": self.motors_on,
                "voltage_v": state.voltage_v, "mode": self.link.status.mode_name}


def open_ports(arguments: argparse.Namespace, stack: contextlib.ExitStack) -> list[MavlinkPort]:
    """The ports asked for.

    Raises:
        UsageError: none was.
        DeviceError: one is in use.
    """
    ports: list[MavlinkPort] = []
    for cls, port in ((TcpServer, arguments.tcp), (UdpServer, arguments.udp), (UdpClient, arguments.udp_to)):
        if port is not None:
            ports.append(stack.enter_context(contextlib.closing(cls(port=port))))
    if not ports:
        raise UsageError("no port to serve: give --udp-to 14550, --udp 14551 or --tcp 5760 (or several of them)")
    return ports


def serve(world: World, ports: list[MavlinkPort], seconds: float) -> None:
    """Wall time, from now on."""
    stdin = sys.stdin.fileno()
    watched = [stdin] if stat.S_ISFIFO(os.fstat(stdin).st_mode) else []
    report = Periodic(REPORT_US, world.t_us)
    first_us, began, late_s, spoken = world.t_us, time.monotonic(), 0.0, b""
    while (wall_s := time.monotonic() - began) < seconds:
        spoken += b"".join(port.poll() for port in ports)
        late_s = max(late_s, wall_s - (world.t_us - first_us) / 1e6 - BEHIND_LIMIT_S)
        while (world.t_us - first_us) / 1e6 < wall_s - late_s:
            out, spoken = world.tick(spoken), b""
            for port in ports:
                port.send(out)
        if report.due(world.t_us):
            print(json.dumps({**world.truth(), "late_s": round(late_s, 3)}), flush=True)
            if watched and select.select(watched, [], [], 0.0)[0] and not os.read(stdin, 4096):
                return
        time.sleep(0.001)


def arguments_of() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     epilog="The ports may be given together, so that several programs see one flight.")
    parser.add_argument("--autopilot", choices=KINDS, default=KINDS[0], help="which one flies (%(default)s)")
    parser.add_argument("--udp-to", type=int, metavar="PORT", help="send to a program that listens on this UDP port")
    parser.add_argument("--udp", type=int, metavar="PORT", help="listen on this UDP port (0 = any free one)")
    parser.add_argument("--tcp", type=int, metavar="PORT", help="listen on this TCP port (0 = any free one)")
    parser.add_argument("--origin", action="store_true",
                        help="tell the autopilot where it is (for ground stations that do not; it has no GPS)")
    parser.add_argument("--seconds", type=float, default=600.0, help="of wall time after the boot (%(default)g)")
    parser.add_argument("--boot", type=float, metavar="S", help="simulated seconds of boot, at the least "
                        f"({', '.join(f'{kind} {s:g}' for kind, s in BOOT_S.items())})")
    parser.add_argument("--workdir", type=Path, help="where arducopter runs and keeps its log (a temporary folder)")
    return parser.parse_args()


def run(arguments: argparse.Namespace) -> None:
    with contextlib.ExitStack() as stack:
        ports = open_ports(arguments, stack)
        world = World(arguments.autopilot, arguments.workdir)
        stack.enter_context(contextlib.closing(world.autopilot))
        began = time.monotonic()
        world.boot(arguments.origin, BOOT_S[arguments.autopilot] if arguments.boot is None else arguments.boot)
        print(json.dumps({"urls": [port.url for port in ports], "autopilot": arguments.autopilot,
                          "version": version_text(world.link.status.firmware_version), "boot_s": world.t_us / 1e6,
                          "boot_wall_s": round(time.monotonic() - began, 2)}), flush=True)
        serve(world, ports, arguments.seconds)


def main() -> int:
    return serve_until_told(lambda: run(arguments_of()))


if __name__ == "__main__":
    sys.exit(main())
