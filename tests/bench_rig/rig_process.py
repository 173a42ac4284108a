"""An emulated device behind a port in this process: a thread that serves it, and is gone after the test."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from bench.rig.emulate_command import make_device
from bench.rig.emulator import EmulatedDevice
from bench.rig.serve import BACKLOG_US, RigPort, TruthFile, open_port, serve


@dataclass
class Served:
    url: str
    device: EmulatedDevice
    port: RigPort


@contextmanager
def served(*faults: str, kind: str = "pty", sonar: str = "pair", seed: int = 1, reflector: str = "0.8,30",
           plant: Any = None) -> Iterator[Served]:
    port = open_port(kind)
    stop = threading.Event()
    device = make_device(sonar, None, [], 0.0, reflector, list(faults), seed, backlog_us=BACKLOG_US)
    device.plant = plant
    device.warm_up()
    began_s = time.monotonic()
    errors: list[BaseException] = []

    def run() -> None:
        try:
            serve(device, port, TruthFile(None, began_s), began_s, stop.is_set)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield Served(port.url, device, port)
    finally:
        stop.set()
        thread.join(10.0)
        port.close()
    assert not errors and not thread.is_alive()
