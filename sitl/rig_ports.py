"""Byte ports that other programs can open: a pty (as a USB serial port looks) and TCP on the loopback.

Neither ever blocks. What is written while nobody listens, or while the listener does not keep up, is dropped whole
and counted: a piece handed to `write` arrives entire or not at all.
"""

import contextlib
import os
import select
import socket
import termios
import tty

from saranga.errors import DeviceError

READ_BYTES = 65_536


class PtyPort:
    """The master end of a pty; `url` names the other end for `saranga.sources.open_source`.

    Raises:
        DeviceError: the system has no pty to give.
    """

    def __init__(self) -> None:
        try:
            self._master, slave = os.openpty()
        except OSError as error:
            raise DeviceError(f"no pty to be had: {error.strerror}; close some terminals, or use TCP") from error
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self.url = f"serial://{self.path}"
        self.dropped_bytes = 0
        self._rest = b""
        os.set_blocking(self._master, False)
        # Closed here, so that the master can tell whether anybody has the other end open.
        os.close(slave)

    @property
    def listening(self) -> bool:
        """Whether another program has the port open."""
        poll = select.poll()
        poll.register(self._master, 0)
        return not poll.poll(0)

    @property
    def busy(self) -> bool:
        """Whether something is still on its way: what is written now would be dropped."""
        return bool(self._rest) and self.listening

    def write(self, data: bytes) -> None:
        """Send, or drop and count."""
        if not self.listening:
            self.dropped_bytes += len(data) + len(self._rest)
            self._rest = b""
            with contextlib.suppress(termios.error):
                termios.tcflush(self._master, termios.TCIOFLUSH)
            return
        self._push()
        if self._rest:
            self.dropped_bytes += len(data)
            return
        self._rest = data
        self._push()

    def _push(self) -> None:
        """As much of what is left over as the system takes."""
        with contextlib.suppress(BlockingIOError):
            while self._rest:
                self._rest = self._rest[os.write(self._master, self._rest):]

    def read(self) -> bytes:
        """What the other end has sent, b"" when nothing."""
        if self._rest and self.listening:
            self._push()
        try:
            return os.read(self._master, READ_BYTES)
        except OSError:
            # BlockingIOError: nothing came; EIO: nobody has the other end open.
            return b""

    def close(self) -> None:
        """Give the pty back. May be called twice."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1


class TcpPort:
    """A listening socket with one client at a time; the next waits until the first has left.

    Args:
        port: 0 for any free one.
        host: the loopback unless told otherwise.

    Raises:
        DeviceError: the address cannot be had.
    """

    def __init__(self, port: int = 0, host: str = "127.0.0.1") -> None:
        try:
            self._server = socket.create_server((host, port), backlog=4)
        except OSError as error:
            raise DeviceError(f"tcp://{host}:{port}: cannot be listened on: {error.strerror}; choose another port, or "
                              "0 for any") from error
        self._server.setblocking(False)
        self.url = f"tcp://{host}:{self._server.getsockname()[1]}"
        self.dropped_bytes = 0
        self._client: socket.socket | None = None
        self._rest = b""

    @property
    def listening(self) -> bool:
        """Whether a client is connected (as far as is known)."""
        self._accept()
        return self._client is not None

    @property
    def busy(self) -> bool:
        """Whether something is still on its way: what is written now would be dropped."""
        return bool(self._rest)

    def write(self, data: bytes) -> None:
        """Send, or drop and count."""
        self._accept()
        self._push()
        if self._client is None or self._rest:
            self.dropped_bytes += len(data)
            return
        self._rest = data
        self._push()

    def read(self) -> bytes:
        """What the client has sent, b"" when nothing."""
        self._accept()
        self._push()
        if self._client is None:
            return b""
        try:
            data = self._client.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def close(self) -> None:
        """Hang up and stop listening. May be called twice."""
        self._hang_up()
        self._server.close()

    def _accept(self) -> None:
        if self._client is None:
            with contextlib.suppress(BlockingIOError, OSError):
                self._client, _ = self._server.accept()
                self._client.setblocking(False)
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _push(self) -> None:
        """As much of what is left over as the system takes."""
        try:
            while self._rest and self._client is not None:
                self._rest = self._rest[self._client.send(self._rest):]
        except BlockingIOError:
            pass
        except OSError:
            self._hang_up()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
        self.dropped_bytes += len(self._rest)
        self._rest = b""
