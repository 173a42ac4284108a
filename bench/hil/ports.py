"""The two ports that a companion connects to, and the moment at which its bytes arrive."""

import time
from collections.abc import Callable
from urllib.parse import urlsplit

from saranga.errors import UsageError
from sitl.autopilot.servers import LOOPBACK, TcpServer
from sitl.rig_ports import TcpPort

Hear = Callable[[bytes, float], None]


def parse_listen(option: str, url: str) -> tuple[str, int]:
    """Host and port of `tcp://host:port`; port 0 takes any free one.

    Raises:
        UsageError: another form.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise UsageError(f"{option} {url}: {error}; use tcp://{LOOPBACK}:7000") from error
    if parts.scheme != "tcp" or not parts.hostname or port is None or parts.path not in ("", "/"):
        raise UsageError(f"{option} {url}: use tcp://host:port, such as tcp://{LOOPBACK}:7000 (0: any free port)")
    return parts.hostname, port


def is_loopback(host: str) -> bool:
    return host == "localhost" or host == "::1" or host.startswith("127.")


class StampedPort:
    """A MAVLink port that tells `hear` about bytes at the moment they come, also while the simulation waits."""

    def __init__(self, host: str, port: int) -> None:
        self._server = TcpServer(host, port)
        self._heard = b""
        self.url = self._server.url
        self.hear: Hear = lambda data, now_s: None

    @property
    def clients(self) -> int:
        return self._server.clients

    def poll(self) -> bytes:
        """Whole frames since the last call."""
        self._read()
        heard, self._heard = self._heard, b""
        return heard

    def send(self, data: bytes) -> None:
        self._server.send(data)

    def wait(self, seconds: float) -> None:
        """Wait, and note what comes meanwhile."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            if self._server.wait(left):
                self._read()

    def close(self) -> None:
        self._server.close()

    def _read(self) -> None:
        data = self._server.poll()
        if data:
            self.hear(data, time.monotonic())
            self._heard += data


__all__ = ["StampedPort", "TcpPort", "is_loopback", "parse_listen"]
