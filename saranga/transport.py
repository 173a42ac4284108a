"""Byte links by URL for MAVLink: serial and TCP as the rig has them, and UDP."""

import contextlib
import select
import socket
from urllib.parse import urlsplit

from saranga.byte_links import READ_BYTES, ByteLink, SerialLink, TcpLink
from saranga.errors import DeviceError, UsageError

FORMS = "serial:///dev/ttyACM0?baud=115200, tcp://host:port, udpin://host:port or udpout://host:port"
DEFAULT_BAUD = 115_200


class UdpLink:
    """Datagrams as a byte stream. `listen` binds and answers whoever spoke first; else we speak to a fixed peer."""

    def __init__(self, url: str, host: str, port: int, listen: bool) -> None:
        self.url = url
        self._address = (host, port)
        self._listen = listen
        self._peer: tuple[str, int] | None = None if listen else (host, port)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if self._listen:
            try:
                self._socket.bind(self._address)
            except OSError as error:
                self.close()
                raise DeviceError(f"{self.url}: cannot listen: {error.strerror}; choose another port or stop who "
                                  "has it") from error

    def read(self, timeout_s: float) -> bytes:
        sock = self._opened()
        parts: list[bytes] = []
        if timeout_s > 0:
            select.select([sock], [], [], timeout_s)
        while True:
            try:
                data, peer = sock.recvfrom(READ_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return b"".join(parts)
            if self._peer is None:
                self._peer = peer
            if peer == self._peer:
                parts.append(data)

    def write(self, data: bytes) -> None:
        if self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                self._opened().sendto(data, self._peer)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        return self._socket


def open_transport(url: str) -> ByteLink:
    """Open a link to a vehicle.

    Raises:
        UsageError: not one of the URL forms.
        DeviceError: it cannot be opened.
    """
    link = _link(url)
    link.open()
    return link


def _link(url: str) -> ByteLink:
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise UsageError(f"vehicle URL {url!r}: {error}; use {FORMS}") from error
    if parts.scheme == "serial" and parts.path:
        baud_text = parts.query.removeprefix("baud=") or str(DEFAULT_BAUD)
        if not baud_text.isdigit() or int(baud_text) == 0:
            raise UsageError(f"vehicle URL {url!r}: baud {baud_text!r} is not a positive number; use {FORMS}")
        return SerialLink(url, parts.path, int(baud_text))
    if parts.hostname and port:
        if parts.scheme == "tcp":
            return TcpLink(url, parts.hostname, port)
        if parts.scheme in ("udpin", "udpout"):
            return UdpLink(url, parts.hostname, port, listen=parts.scheme == "udpin")
    raise UsageError(f"vehicle URL {url!r} is not understood: use {FORMS}")
