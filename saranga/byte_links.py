"""Bytes to and from a rig: a serial port (or pty) and a TCP connection. Reads wait with a timeout, never for ever."""

import math
import os
import select
import socket
from typing import Protocol

import serial

from saranga.errors import DeviceError

READ_BYTES = 65_536
CONNECT_TIMEOUT_S = 5.0
WRITE_TIMEOUT_S = 1.0


class ByteLink(Protocol):
    """A two-way byte stream. Every method but `close` raises DeviceError, naming URL and cause."""

    url: str

    def open(self) -> None: ...

    def read(self, timeout_s: float) -> bytes:
        """What has come, waiting at most `timeout_s` for the first byte; b"" when nothing did."""
        ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


def _wait(descriptor: int, timeout_s: float) -> bool:
    """Whether there is something to read, an end or an error included. poll, not select: no limit of 1024 files."""
    waiter = select.poll()
    waiter.register(descriptor, select.POLLIN)
    return bool(waiter.poll(math.ceil(timeout_s * 1e3)))


class SerialLink:
    """A serial port; USB ports ignore the baud rate. The port is locked against a second reader."""

    def __init__(self, url: str, path: str, baud: int) -> None:
        self.url = url
        self._path = path
        self._baud = baud
        self._port: serial.Serial | None = None

    def open(self) -> None:
        try:
            self._port = serial.Serial(self._path, self._baud, timeout=0, write_timeout=WRITE_TIMEOUT_S,
                                       exclusive=True)
        except (OSError, ValueError) as error:
            raise DeviceError(f"{self.url}: cannot be opened: {error}; is the rig plugged in, the port free, and are "
                              "you allowed to use it?") from error

    def read(self, timeout_s: float) -> bytes:
        port = self._opened()
        try:
            # Not pyserial's read: that one waits for a full buffer or its own fixed timeout.
            readable = _wait(port.fileno(), timeout_s)
            data = os.read(port.fileno(), READ_BYTES) if readable else b""
        except BlockingIOError:
            return b""
        except OSError as error:
            raise DeviceError(f"{self.url}: lost: {error.strerror}; was it unplugged?") from error
        if readable and not data:
            raise DeviceError(f"{self.url}: lost: the other end has closed; was it unplugged?")
        return data

    def write(self, data: bytes) -> None:
        try:
            self._opened().write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceError(f"{self.url}: the rig took no bytes for {WRITE_TIMEOUT_S:g} s: is it hung?") from error
        except OSError as error:
            raise DeviceError(f"{self.url}: lost: {error}; was it unplugged?") from error

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        return self._port


class TcpLink:
    """A TCP client."""

    def __init__(self, url: str, host: str, port: int) -> None:
        self.url = url
        self._address = (host, port)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        try:
            self._socket = socket.create_connection(self._address, CONNECT_TIMEOUT_S)
        except OSError as error:
            raise DeviceError(f"{self.url}: cannot connect: {error}; does anything serve "
                              "this port?") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(WRITE_TIMEOUT_S)

    def read(self, timeout_s: float) -> bytes:
        link = self._opened()
        try:
            readable = _wait(link.fileno(), timeout_s)
            data = link.recv(READ_BYTES) if readable else b""
        except OSError as error:
            raise DeviceError(f"{self.url}: lost: {error.strerror or error}; is the other end still up?") from error
        if readable and not data:
            raise DeviceError(f"{self.url}: lost: the other end has closed the connection; is it still up?")
        return data

    def write(self, data: bytes) -> None:
        try:
            self._opened().sendall(data)
        except TimeoutError as error:
            raise DeviceError(f"{self.url}: the rig took no bytes for {WRITE_TIMEOUT_S:g} s: is it hung?") from error
        except OSError as error:
            raise DeviceError(f"{self.url}: lost: {error.strerror or error}; is the other end still up?") from error

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        return self._socket
