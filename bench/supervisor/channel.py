"""JSON lines over a socket pair. Its end (EOF) is a message too: the other process has died, however it died."""

import json
import socket
from typing import Any

from saranga.errors import DeviceError

READ_BYTES = 65_536
SEND_BUFFER_BYTES = 1 << 20
BACKLOG_BYTES = 1 << 22


class Channel:
    """One end. Neither end ever waits for the other longer than it says."""

    def __init__(self, link: socket.socket) -> None:
        self._socket = link
        link.setblocking(False)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._in = b""
        self._out = bytearray()
        self.dropped = 0
        self.ended = False

    def fileno(self) -> int:
        """For poll."""
        return self._socket.fileno()

    def receive(self) -> list[dict[str, Any]]:
        """Messages that have come; `ended` is true once no more can come."""
        messages: list[dict[str, Any]] = []
        while not self.ended:
            try:
                data = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self.ended = True
                break
            *lines, self._in = (self._in + data).split(b"\n")
            messages += [json.loads(line) for line in lines]
        return messages

    def offer(self, message: dict[str, Any]) -> None:
        """Send without waiting. What the other side does not fetch is dropped and counted, whole messages only."""
        if len(self._out) > BACKLOG_BYTES:
            self.dropped += 1
        else:
            self._out += json.dumps(message, separators=(",", ":")).encode() + b"\n"
        self._push()

    def send(self, message: dict[str, Any], timeout_s: float) -> None:
        """Send, waiting at most `timeout_s`.

        Raises:
            DeviceError: the other side is gone or takes nothing.
        """
        self._socket.settimeout(timeout_s)
        try:
            self._socket.sendall(json.dumps(message, separators=(",", ":")).encode() + b"\n")
        except OSError as error:
            raise DeviceError(f"the other process takes no messages: {error}") from error
        finally:
            self._socket.setblocking(False)

    def close(self) -> None:
        """May be called twice."""
        self._socket.close()
        self.ended = True

    def _push(self) -> None:
        try:
            while self._out:
                del self._out[: self._socket.send(self._out)]
        except BlockingIOError:
            pass
        except OSError:
            self._out.clear()
