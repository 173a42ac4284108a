"""A hovering world in wall time for ground stations to connect to: physics, flight sensors, embedded autopilot.

    python tests/live/world_process.py --tcp 0 --udp 0 --seconds 120

Prints one JSON line with the addresses, then the truth five times a second. Ends after `--seconds`, or when
its standard input closes.
"""

import argparse
import json
import select
import sys
import time

import numpy as np

from sitl.airframe import load_airframe
from sitl.autopilot.embedded import EmbeddedAutopilot
from sitl.autopilot.servers import MavlinkPort, TcpServer, UdpClient, UdpServer
from sitl.physics import Physics
from sitl.sensors import FlightSensors

REPORT_US = 200_000
ORIGIN = {"AHRS_ORIG_LAT": 42.27381, "AHRS_ORIG_LON": -71.80989, "AHRS_ORIG_ALT": 150.0}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tcp", type=int, help="listen on this TCP port (0 = any)")
    parser.add_argument("--udp", type=int, help="listen on this UDP port (0 = any)")
    parser.add_argument("--udp-to", type=int, help="send to a program that listens on this UDP port")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--origin", action="store_true", help="know where it is without being told")
    arguments = parser.parse_args()
    ports: list[MavlinkPort] = []
    if arguments.tcp is not None:
        ports.append(TcpServer(port=arguments.tcp))
    if arguments.udp is not None:
        ports.append(UdpServer(port=arguments.udp))
    if arguments.udp_to is not None:
        ports.append(UdpClient(port=arguments.udp_to))
    physics = Physics(load_airframe(), np.zeros(3), seed=1)
    sensors = FlightSensors(1)
    autopilot = EmbeddedAutopilot(1, ORIGIN if arguments.origin else None)
    autopilot.start(physics.state)
    autopilot.step(physics.state, b"")  # compiled before the clock starts
    print(json.dumps({"urls": [port.url for port in ports], "version": autopilot.version}), flush=True)
    began = time.monotonic()
    report_us = 0
    data = b""
    while (elapsed_s := time.monotonic() - began) < arguments.seconds:
        data += b"".join(port.poll() for port in ports)
        while physics.state.t_us < elapsed_s * 1e6:
            state = physics.state
            throttle, out = autopilot.step(state, sensors.step(state) + data)
            data = b""
            physics.step(autopilot.tick_us, throttle)
            for port in ports:
                port.send(out)
        if physics.state.t_us >= report_us:
            report_us += REPORT_US
            state = physics.state
            print(json.dumps({"t_s": state.t_us / 1e6, "pos_m": state.pos_m.tolist(),
                              "vel_m_s": state.vel_m_s.tolist(), "armed": autopilot.vehicle.armed,
                              "mode": autopilot.vehicle.mode, "clients": sum(port.clients for port in ports)}),
                  flush=True)
            if select.select([sys.stdin], [], [], 0.0)[0] and not sys.stdin.read(1):
                break
        time.sleep(0.001)
    for port in ports:
        port.close()


if __name__ == "__main__":
    main()
