"""MAVLink bytes between an autopilot and outside programs: TCP and UDP, on loopback unless told otherwise.

Nothing blocks. Bytes of several programs are cut at frame borders before they are joined, so two programs
cannot garble each other. What a program does not read is dropped and counted, never waited for.
"""

import contextlib
import errno
import select
import socket
from typing import Protocol

from saranga.errors import DeviceError, UsageError
from sitl.autopilot.frames import FrameReader

LOOPBACK = "127.0.0.1"
MAX_BACKLOG_BYTES = 1 << 18
MAX_CLIENTS = 16
DATAGRAM_BYTES = 1400


class MavlinkPort(Protocol):
    """One way in and out. `url` is what to tell the other program, `dropped_bytes` what nobody took."""

    url: str
    dropped_bytes: int

    @property
    def clients(self) -> int: ...

    def poll(self) -> bytes:
        """Whole MAVLink frames that came in since the last call."""
        ...

    def send(self, data: bytes) -> None:
        """To every program that is connected."""
        ...

    def close(self) -> None: ...


def _bind(kind: socket.SocketKind, host: str, port: int, scheme: str) -> socket.socket:
    if not 0 <= port <= 65535:
        raise UsageError(f"{scheme}://{host}:{port}: port must be within 0 .. 65535 (0 = any free one)")
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        if kind == socket.SOCK_STREAM:
            sock.listen(MAX_CLIENTS)
    except OSError as error:
        sock.close()
        if error.errno == errno.EADDRINUSE:
            raise DeviceError(f"{scheme} port {port} on {host} is in use by another program: "
                              "stop that program, or choose another port (0 takes any free one)") from error
        raise DeviceError(f"{scheme}://{host}:{port} cannot be opened: {error.strerror or error}; "
                          f"use an address of this machine such as {LOOPBACK}") from error
    sock.setblocking(False)
    return sock


class _TcpClient:
    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.reader = FrameReader()
        self.backlog = bytearray()


class TcpServer:
    """Listens; any number of programs may connect (`tcp:HOST:PORT` in MAVProxy, `tcpout://` in MAVSDK).

    Raises:
        DeviceError: the port is taken or cannot be opened.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 5760) -> None:
        self._listener = _bind(socket.SOCK_STREAM, host, port, "tcp")
        self.url = f"tcp://{host}:{self._listener.getsockname()[1]}"
        self._clients: list[_TcpClient] = []
        self.dropped_bytes = 0

    @property
    def clients(self) -> int:
        return len(self._clients)

    def poll(self) -> bytes:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while len(self._clients) < MAX_CLIENTS:
                sock, _ = self._listener.accept()
                sock.setblocking(False)
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients.append(_TcpClient(sock))
        out = []
        for client in list(self._clients):
            try:
                data = client.sock.recv(65536)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            if not data:
                self._drop(client)
                continue
            out += [frame.raw for frame in client.reader.feed(data)]
        return b"".join(out)

    def wait(self, seconds: float) -> bool:
        """Until something comes, or a program connects or leaves; False when nothing did."""
        waiter = select.poll()
        for sock in (self._listener, *(client.sock for client in self._clients)):
            waiter.register(sock, select.POLLIN)
        return bool(waiter.poll(1000.0 * seconds))

    def send(self, data: bytes) -> None:
        if not data:
            return
        if not self._clients:
            self.dropped_bytes += len(data)
        for client in list(self._clients):
            client.backlog += data
            try:
                sent = client.sock.send(client.backlog)
                del client.backlog[:sent]
            except BlockingIOError:
                pass
            except OSError:
                self._drop(client)
                continue
            if len(client.backlog) > MAX_BACKLOG_BYTES:  # it does not read: let it go rather than wait
                self._drop(client)

    def _drop(self, client: _TcpClient) -> None:
        self.dropped_bytes += len(client.backlog)
        client.sock.close()
        self._clients.remove(client)

    def close(self) -> None:
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()


class _UdpPort:
    """What both UDP ends share: one socket, frames cut per sender."""

    url: str

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._readers: dict[tuple[str, int], FrameReader] = {}
        self.dropped_bytes = 0

    def poll(self) -> bytes:
        out = []
        while True:
            try:
                data, peer = self._sock.recvfrom(65536)
            except BlockingIOError:
                break
            except ConnectionError:  # an earlier datagram found nobody listening
                continue
            if peer not in self._readers:
                if len(self._readers) >= MAX_CLIENTS:
                    self._readers.pop(next(iter(self._readers)))
                self._readers[peer] = FrameReader()
            out += [frame.raw for frame in self._readers[peer].feed(data)]
        return b"".join(out)

    def _send_to(self, data: bytes, peers: list[tuple[str, int]]) -> None:
        if not peers:
            self.dropped_bytes += len(data)
        for peer in peers:
            for start in range(0, len(data), DATAGRAM_BYTES):
                part = data[start:start + DATAGRAM_BYTES]
                try:
                    self._sock.sendto(part, peer)
                except OSError:
                    self.dropped_bytes += len(part)

    def close(self) -> None:
        self._sock.close()


class UdpServer(_UdpPort):
    """Listens for datagrams and answers whoever sent some (`udpout:` in MAVProxy and MAVSDK).

    Raises:
        DeviceError: the port is taken or cannot be opened.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 14550) -> None:
        super().__init__(_bind(socket.SOCK_DGRAM, host, port, "udp"))
        self.url = f"udp://{host}:{self._sock.getsockname()[1]}"

    @property
    def clients(self) -> int:
        return len(self._readers)

    def send(self, data: bytes) -> None:
        if data:
            self._send_to(data, list(self._readers))


class UdpClient(_UdpPort):
    """Sends to a program that listens, as QGroundControl does on 14550 (`udpin:` in MAVProxy, `udpin://` in MAVSDK).

    Raises:
        DeviceError: no socket can be opened.
        UsageError: a port outside 1..65535.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 14550) -> None:
        if not 0 < port <= 65535:
            raise UsageError(f"udp://{host}:{port}: port must be within 1 .. 65535")
        local = LOOPBACK if host in (LOOPBACK, "localhost") else "0.0.0.0"
        super().__init__(_bind(socket.SOCK_DGRAM, local, 0, "udp"))
        try:
            self._peer = (socket.gethostbyname(host), port)
        except OSError as error:
            self._sock.close()
            raise DeviceError(f"udp://{host}:{port}: host {host!r} is not known; give an address") from error
        self.url = f"udpin://{host}:{port}"

    @property
    def clients(self) -> int:
        return len(self._readers)

    def send(self, data: bytes) -> None:
        if data:
            self._send_to(data, [self._peer])
