"""Where echoes come from: serial port or pty, TCP, a recording, or the same process. One protocol, one class each."""

import re
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from saranga.byte_links import ByteLink, SerialLink, TcpLink
from saranga.echo import EchoCycle
from saranga.echo_stream import EchoSource, EchoStream
from saranga.errors import DeviceError, UsageError
from saranga.recording import FrameWriter, read_recording
from saranga.wire import MODE_TRANSMIT_RECEIVE, VERSION, Hello, HelloRequest, Message, Start, Stop, encode

__all__ = ["EchoSource", "FileSource", "InProcessSource", "LinkSource", "open_source", "rig_link"]

FORMS = "serial:///dev/ttyACM0[?baud=N], tcp://host:port, file:recording.mcap"
HELLO_TIMEOUT_S = 5.0
HELLO_REPEAT_S = 0.5
CYCLE_RATE_HZ = 1e6 / 25_600


class LinkSource(EchoStream):
    """A rig behind a byte link.

    Args:
        link: the bytes.
        mode: 0 transmit/receive, 1 receive only.
        rate_hz: triggers a second.
        hello_timeout_s: how long `open` waits for HELLO.
        record: a new MCAP file that everything received goes to.
        now: the clock, s, that timeouts and the recording go by.
    """

    def __init__(self, link: ByteLink, mode: int = MODE_TRANSMIT_RECEIVE, rate_hz: float = CYCLE_RATE_HZ,
                 hello_timeout_s: float = HELLO_TIMEOUT_S, record: Path | None = None,
                 now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(link.url)
        self.now = now
        self._link = link
        self._start = Start(mode=mode, rate_hz=rate_hz)
        self._hello_timeout_s = hello_timeout_s
        self._record = record
        self._writer: FrameWriter | None = None
        self._opened_s = 0.0
        self._is_open = False

    def open(self) -> Hello:
        """Connect, ask HELLO? until HELLO comes, then START.

        Raises:
            DeviceError: no connection, or no HELLO in time; says what came instead and what to do.
        """
        self._link.open()
        self._is_open = True
        self._opened_s = self.now()
        try:
            if self._record is not None:
                self._writer = FrameWriter(self._record, {"source": self.name})
            hello = self._await_hello()
            self.send(self._start)
        except BaseException:
            self.close()
            raise
        return hello

    def poll(self, timeout_s: float) -> list[EchoCycle]:
        if not self._is_open:
            raise DeviceError(f"{self.name} is not open: open it first")
        deadline = self.now() + timeout_s
        while True:
            self._receive(0.0 if self._ready else max(0.0, deadline - self.now()))
            if self._ready or self.now() >= deadline:
                return self._take_ready()

    def send(self, message: Message) -> None:
        """Send a message to the rig."""
        self._link.write(encode(message))

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            try:
                self.send(Stop())
            except DeviceError:
                pass  # It is gone already: nothing is left to stop.
            finally:
                self._link.close()
        if self._writer is not None:
            writer, self._writer = self._writer, None
            writer.close()

    def _receive(self, timeout_s: float) -> None:
        data = self._link.read(timeout_s)
        if data:
            if self._writer is not None:
                self._writer.write(data, round((self.now() - self._opened_s) * 1e6))
            self._take_bytes(data)

    def _await_hello(self) -> Hello:
        deadline = self._opened_s + self._hello_timeout_s
        ask = self._opened_s
        while self.hello is None:
            now = self.now()
            if now >= deadline:
                raise DeviceError(self._no_hello())
            if now >= ask:
                self.send(HelloRequest())
                ask = now + HELLO_REPEAT_S
            self._receive(min(ask, deadline) - now)
        return self.hello

    def _no_hello(self) -> str:
        counters = self.counters
        waited = f"{self.name}: no HELLO from the rig in {self._hello_timeout_s:g} s"
        if self.decoder.foreign_version is not None:
            return (f"{waited}; it speaks rig protocol v{self.decoder.foreign_version}, this is v{VERSION}: "
                    "update its firmware")
        if counters.messages:
            return f"{waited}, though {counters.messages} other messages came: update its firmware"
        if counters.bytes_in:
            bad = counters.bad_cobs + counters.bad_crc + counters.bad_message
            return (f"{waited}: {counters.bytes_in} bytes came, {bad} bad frames among them: is it the rig's port, "
                    "at the right baud rate?")
        return f"{waited}, it is silent: check power and cable, and that this is the rig's port"


class FileSource(EchoStream):
    """A recording. What was cut off its end is simply not there.

    Args:
        paced: play it at the pace of the device's clock, as a live rig would; else each poll gives the next cycle.
    """

    def __init__(self, path: Path, name: str | None = None, paced: bool = False) -> None:
        super().__init__(name or f"file:{path}")
        self._recording = read_recording(path)
        self._frames = self._recording.frames()
        self._paced = paced
        self._began: tuple[float, int] | None = None
        self._at_end = False

    @property
    def complete(self) -> bool:
        """Whether the recording was closed properly; right once `exhausted`."""
        return self._recording.complete

    def open(self) -> Hello:
        """Read up to the first HELLO.

        Raises:
            UsageError: not a recording, or no HELLO in it.
        """
        while self.hello is None and self._advance():
            pass
        if self.hello is None:
            raise UsageError(f"{self.name}: no HELLO in the recording, {self.counters.bytes_in} bytes read: "
                             "it does not say which sensor is which; record it again")
        return self.hello

    def poll(self, timeout_s: float) -> list[EchoCycle]:
        while not self._ready and self._advance():
            pass
        if self._ready and self._paced and not self._wait_until_due(self._ready[0].t_us, timeout_s):
            return []
        self.exhausted = self._at_end
        return self._take_ready()

    def close(self) -> None:
        self._frames.close()
        self.exhausted = self._at_end = True

    def _advance(self) -> bool:
        if self._at_end:
            return False
        for _, frame in self._frames:
            self._take_bytes(frame)
            return True
        self._at_end = True
        last = self._assembler.flush()
        if last is not None:
            self._ready.append(last)
        return False

    def _wait_until_due(self, t_us: int, timeout_s: float) -> bool:
        now = time.monotonic()
        if self._began is None or t_us < self._began[1]:
            self._began = (now, t_us)
        wait_s = self._began[0] + (t_us - self._began[1]) / 1e6 - now
        time.sleep(max(0.0, min(wait_s, timeout_s)))
        return wait_s <= timeout_s


class InProcessSource(EchoStream):
    """A rig in the same process: `feed` it the rig's bytes, `poll` the cycles. It never waits.

    Args:
        answer: takes the host's bytes, returns the rig's; None where whoever feeds it starts the rig.
    """

    def __init__(self, answer: Callable[[bytes], bytes] | None = None, name: str = "in-process") -> None:
        super().__init__(name)
        self._answer = answer
        self._started = False

    def feed(self, data: bytes) -> None:
        """Wire bytes from the rig, cut anywhere."""
        self._take_bytes(data)

    def open(self) -> Hello:
        """Raises DeviceError when the rig has not said HELLO."""
        self._tell(HelloRequest())
        if self.hello is None:
            raise DeviceError(f"{self.name}: no HELLO from the rig: feed its HELLO before opening")
        self._tell(Start())
        self._started = True
        return self.hello

    def poll(self, timeout_s: float = 0.0) -> list[EchoCycle]:
        return self._take_ready()

    def close(self) -> None:
        if self._started:
            self._started = False
            self._tell(Stop())

    def _tell(self, message: Message) -> None:
        if self._answer is not None:
            self._take_bytes(self._answer(encode(message)))


def open_source(url: str, record: Path | None = None) -> EchoSource:
    """The source that a URL names; it connects when its `open` is called.

    Args:
        url: `serial:///dev/ttyACM0[?baud=N]` (also a pty), `tcp://host:port`, `file:recording.mcap` (played at
            its own pace).
        record: new MCAP file for what is received (live sources only).

    Raises:
        UsageError: none of these forms, or a recording that does not exist.
    """
    if url.startswith("file:"):
        path = Path(url.removeprefix("file:").removeprefix("//")).expanduser()
        if record is not None:
            raise UsageError(f"{url}: a recording cannot be recorded again; copy the file")
        return FileSource(path, url, paced=True)
    return LinkSource(rig_link(url), record=record)


def rig_link(url: str) -> ByteLink:
    """The byte link to a live rig that a URL names, not yet open.

    Raises:
        UsageError: not `serial:///dev/ttyACM0[?baud=N]` or `tcp://host:port`.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise UsageError(f"echo source {url!r}: {error}; use {FORMS}") from error
    if parts.scheme == "serial" and re.fullmatch(r"/.+", parts.path) and not parts.netloc:
        query = parse_qs(parts.query, keep_blank_values=True)
        bauds = query.pop("baud", ["115200"])
        if query or not re.fullmatch(r"[1-9][0-9]{1,7}", bauds[-1]):
            raise UsageError(f"echo source {url!r}: {parts.query!r} is not baud=N with N in 10..99999999; use {FORMS}")
        return SerialLink(url, parts.path, int(bauds[-1]))
    if parts.scheme == "tcp" and parts.hostname and port and parts.path in ("", "/"):
        return TcpLink(url, parts.hostname, port)
    raise UsageError(f"echo source {url!r} is not understood: use {FORMS}")
