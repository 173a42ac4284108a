"""`saranga-bench rig replay`: a recording behind a port, as if the rig were there.

It answers HELLO? with the recorded HELLO, begins at START, pauses at STOP, and goes to the recording's end. The bytes
are those recorded, damaged frames and all.
"""

import time
from collections.abc import Callable, Generator
from pathlib import Path

from bench.rig.serve import TICK_S, RigPort
from saranga.errors import UsageError
from saranga.recording import read_recording
from saranga.wire import Decoder, Hello, HelloRequest, Start, Stop, encode

CHUNK_BYTES = 32_768
"""At most this much is handed to the port at once when nothing paces the recording."""


class Replay:
    """A recording as a device: `receive` the host's bytes, `take` what is due.

    Args:
        speed: recorded seconds a second; 0 is as fast as the host takes it.
        loop: start again at the end.

    Raises:
        UsageError: no recording, no HELLO in it, or a speed outside 0..1000.
    """

    def __init__(self, path: Path, speed: float = 1.0, loop: bool = False) -> None:
        if not 0.0 <= speed <= 1000.0:
            raise UsageError(f"--speed {speed}: must be 0 (as fast as possible) to 1000")
        self.ended = False
        self.frames = 0
        self._path, self._speed, self._loop = path, speed, loop
        self._hello = _first_hello(path)
        self._decoder = Decoder()
        self._running = False
        self._frames = self._open()
        self._next = next(self._frames, None)
        self._began_us = self._next[0] if self._next else 0
        self._played_us = 0.0
        self._last_s: float | None = None

    def _open(self) -> Generator[tuple[int, bytes], None, None]:
        return read_recording(self._path).frames()

    def receive(self, data: bytes) -> bytes:
        """Take the host's bytes; returns the answers."""
        answers = []
        for message in self._decoder.feed(data):
            if isinstance(message, HelloRequest):
                answers.append(self._hello)
            elif isinstance(message, Start):
                self._running = True
            elif isinstance(message, Stop):
                self._running, self._last_s = False, None
        return b"".join(answers)

    def take(self, now_s: float) -> bytes:
        """Wire bytes that are due at `now_s` (monotonic)."""
        if not self._running or self.ended:
            return b""
        if self._last_s is not None:
            self._played_us += (now_s - self._last_s) * 1e6 * self._speed
        self._last_s = now_s
        parts: list[bytes] = []
        size = 0
        while self._next is not None and size < CHUNK_BYTES and (
                self._speed == 0.0 or self._next[0] - self._began_us <= self._played_us):
            parts.append(self._next[1])
            size += len(self._next[1])
            self.frames += 1
            self._next = next(self._frames, None)
        if self._next is None:
            if self._loop:
                self._frames = self._open()
                self._next = next(self._frames, None)
                self._played_us = 0.0
            else:
                self.ended = True
        return b"".join(parts)


def _first_hello(path: Path) -> bytes:
    decoder = Decoder()
    for _, frame in read_recording(path).frames():
        for message in decoder.feed(frame):
            if isinstance(message, Hello):
                return encode(message)
    raise UsageError(f"{path}: no HELLO in the recording: it does not say which sensor is which, so nobody could use "
                     "it; record it again")


def serve_replay(replay: Replay, port: RigPort, stop: Callable[[], bool]) -> None:
    """Run until `stop()` or the end of the recording, and then until the host has taken what is on its way."""
    while not stop() and not replay.ended:
        answer = replay.receive(port.read())
        if not port.busy:
            answer += replay.take(time.monotonic())
        if answer:
            port.write(answer)
        time.sleep(TICK_S if not answer else 0.0)
    if replay.ended:
        quiet_s = time.monotonic() + 0.5
        while not stop() and time.monotonic() < quiet_s:
            port.read()  # also pushes out what the port still holds
            time.sleep(TICK_S)
