"""The emulated device as a process: bytes on a pty or TCP port in wall time, its truth in a file, orders on stdin.

Orders, one a line: `shield NAME` puts a shield on, `unplug` and `plug` pull the cable, `quit` ends it.
"""

import json
import os
import select
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, Protocol

from bench.rig.emulator import EmulatedDevice
from saranga.errors import BenchError, UsageError
from sitl.rig_ports import PtyPort, TcpPort

TICK_S = 0.002
BACKLOG_US = 500_000
QUEUE_BYTES = 1_000_000
"""What waits for a host that does not keep up, some seconds; more is dropped, and the sequence numbers show it."""


class RigPort(Protocol):
    """Where a host connects. `plug(False)` is the cable pulled: the host's end goes dead."""

    url: str

    @property
    def busy(self) -> bool: ...
    def plug(self, plugged: bool) -> None: ...
    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class _Pluggable:
    """What both ports share: nothing comes and nothing goes while the cable is out."""

    _port: PtyPort | TcpPort | None = None

    def plug(self, plugged: bool) -> None:
        raise NotImplementedError

    @property
    def busy(self) -> bool:
        return self._port is not None and self._port.busy

    def read(self) -> bytes:
        return self._port.read() if self._port is not None else b""

    def write(self, data: bytes) -> None:
        if self._port is not None:
            self._port.write(data)

    def close(self) -> None:
        self.plug(False)


class PluggablePty(_Pluggable):
    """A pty under a name that stays, as /dev/serial/by-id does when a cable is pulled and put in again."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="saranga-rig-")
        self._link = Path(self._folder.name) / "rig"
        self.url = f"serial://{self._link}"
        self.plug(True)

    def plug(self, plugged: bool) -> None:
        if plugged and self._port is None:
            port = PtyPort()
            self._port = port
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(port.path)
        elif not plugged and self._port is not None:
            self._link.unlink(missing_ok=True)
            self._port.close()
            self._port = None

    def close(self) -> None:
        super().close()
        self._folder.cleanup()


class PluggableTcp(_Pluggable):
    """A TCP port of the loopback that refuses connections while the cable is out."""

    def __init__(self, number: int = 0) -> None:
        port = TcpPort(number)
        self._port = port
        self.url = port.url
        self._number = int(self.url.rpartition(":")[2])

    def plug(self, plugged: bool) -> None:
        if plugged and self._port is None:
            self._port = TcpPort(self._number)
        elif not plugged and self._port is not None:
            self._port.close()
            self._port = None


def open_port(kind: str) -> RigPort:
    """"pty", "tcp" (any free port) or "tcp:PORT".

    Raises:
        UsageError: none of these. DeviceError: the port cannot be had.
    """
    if kind == "pty":
        return PluggablePty()
    name, _, number = kind.partition(":")
    if name == "tcp" and (not number or (number.isdigit() and int(number) < 65_536)):
        return PluggableTcp(int(number or 0))
    raise UsageError(f"--port {kind!r}: must be pty, tcp or tcp:PORT")


class TruthFile:
    """JSON lines of what the device was given and did; `t_s` is the host's monotonic clock. Each line at once."""

    def __init__(self, path: Path | None, began_s: float) -> None:
        self.began_s = began_s
        try:
            self._file: IO[str] | None = path.open("w", encoding="utf-8", buffering=1) if path is not None else None
        except OSError as error:
            raise UsageError(f"--truth {path}: cannot be written: {error.strerror}") from error

    def __call__(self, event: dict[str, Any]) -> None:
        if self._file is not None:
            t_s = self.began_s + event.get("t_us", 0) * 1e-6
            self._file.write(json.dumps({"t_s": round(t_s, 6), **event}) + "\n")

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


class Orders:
    """Lines from stdin, without waiting. The end of stdin is no order: the device goes on."""

    def __init__(self, stream: IO[str] | None) -> None:
        self._descriptor = -1
        self._rest = b""
        if stream is not None:
            try:
                self._descriptor = stream.fileno()
            except (OSError, ValueError):
                self._descriptor = -1

    def take(self) -> list[str]:
        if self._descriptor < 0:
            return []
        waiter = select.poll()
        waiter.register(self._descriptor, select.POLLIN)
        if not waiter.poll(0):
            return []
        try:
            data = os.read(self._descriptor, 4096)
        except OSError:
            data = b""
        if not data:
            self._descriptor = -1
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines if line.strip()]


def serve(device: EmulatedDevice, port: RigPort, truth: TruthFile, began_s: float, stop: Callable[[], bool],
          orders: Orders | None = None, say: Callable[[str], None] | None = None) -> None:
    """Run the device in wall time until `stop()` or the order to quit. `began_s` is its time 0, monotonic."""
    orders = orders or Orders(None)
    say = say or (lambda text: print(text, file=sys.stderr, flush=True))
    by_hand, waiting = True, b""
    while not stop():
        t_us = round((time.monotonic() - began_s) * 1e6)
        for order in orders.take():
            word, _, rest = order.partition(" ")
            if word == "quit":
                return
            if word in ("plug", "unplug"):
                by_hand = word == "plug"
                truth({"t_us": t_us, "event": word})
                say(f"done {order}")
            elif word == "shield":
                try:
                    device.mount(rest)
                    say(f"done {order}")
                except BenchError as error:
                    say(f"refused {order}: {error}")
            else:
                say(f"refused {order}: orders are shield NAME, unplug, plug, quit")
        plugged = by_hand and device.plugged(t_us)
        port.plug(plugged)
        # The device lives on, and its dead-man with it, whether the cable is in or not.
        said = device.receive(port.read(), t_us)
        waiting = waiting + said if plugged else b""
        if len(waiting) > QUEUE_BYTES:
            truth({"t_us": t_us, "event": "dropped", "bytes": len(waiting)})
            waiting = b""
        if waiting and not port.busy:
            port.write(waiting)
            waiting = b""
        time.sleep(TICK_S)
