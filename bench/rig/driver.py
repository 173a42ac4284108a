"""The rig as the bench uses it: configuration, self tests, both modes, and a stream that survives a pulled cable."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.rig.device_clock import DeviceClock
from bench.rig.firmware_version import check_firmware, origin_of
from saranga.byte_links import ByteLink
from saranga.echo import EchoCycle, sound_speed_m_s
from saranga.errors import DeviceError, UsageError
from saranga.recording import FrameWriter
from saranga.sources import HELLO_REPEAT_S, HELLO_TIMEOUT_S, LinkSource, rig_link
from saranga.wire import (
    FLAG_BOOT,
    FLAG_OVERRUN,
    MODE_TRANSMIT_RECEIVE,
    Config,
    Echo,
    Fault,
    Hello,
    HelloRequest,
    Message,
    SelfTest,
    Stand,
    Start,
    Status,
    Stop,
)

ANSWER_S = 10.0
REOPEN_S = 0.2
LINK_TEST = 1
ASSUMED_TEMPERATURE_C = 20.0
MOST_STANDS = 100_000


@dataclass
class Losses:
    """What the cable and the device did to the stream, besides the link's and the assembler's own counters.

    `unplugged`: times the port was lost; `silences`: times it was open and said nothing; `restarts`: times the device
    began anew; `lost_s`: time without a link in all; `overruns`: frames that say cycles before them were lost.
    """

    unplugged: int = 0
    silences: int = 0
    restarts: int = 0
    lost_s: float = 0.0
    overruns: int = 0


class Rig(LinkSource):
    """A rig on the bench. Unlike `LinkSource` it does not start by itself, and it does not end with the cable.

    Args:
        link: the bytes.
        record: a new MCAP file that everything received goes to, gaps and all.
        metadata: texts kept with it.
        reconnect_s: how long the rig may be gone before `poll` gives up.
        silence_s: a started rig that says nothing for this long is gone.
        temperature_c: of the air, where the rig does not measure it.
        now, sleep: the host's clock, s; another one than the wall's runs it in simulated time.
    """

    def __init__(self, link: ByteLink, *, record: Path | None = None, metadata: dict[str, str] | None = None,
                 reconnect_s: float = 10.0, silence_s: float = 2.0, hello_timeout_s: float = HELLO_TIMEOUT_S,
                 temperature_c: float | None = None, now: Callable[[], float] = time.monotonic,
                 sleep: Callable[[float], None] = time.sleep) -> None:
        super().__init__(link, hello_timeout_s=hello_timeout_s, now=now)
        self.losses = Losses()
        self._sleep = sleep
        self.clock = DeviceClock()
        self.origin = "measured"
        self._record_path = record
        self._metadata = metadata or {}
        self._reconnect_s = reconnect_s
        self._silence_s = silence_s
        self._temperature_c = temperature_c
        self._stands: deque[Stand] = deque(maxlen=MOST_STANDS)
        self._config: Config | None = None
        self._running: Start | None = None
        self._heard_s = 0.0
        self._down_since_s: float | None = None
        self._down_why = ""
        self._linked = False
        self._try_s = 0.0
        self._ask_s = 0.0
        self._asked = self._answered = 0
        self._link_echoes: dict[int, Echo] | None = None
        self._bad_configs: list[str] = []

    # ---- opening and settings --------------------------------------------------------------------
    def open(self) -> Hello:
        """Connect, and learn who it is; nothing is triggered yet.

        Raises:
            DeviceError: no connection, no HELLO, or a firmware that this version does not know.
            UsageError: the file to record to exists.
        """
        self._link.open()
        self._is_open = self._linked = True
        self._opened_s = self._heard_s = self.now()
        try:
            if self._record_path is not None:
                self._writer = FrameWriter(self._record_path, {"source": self.name, **self._metadata})
            hello = self._await_hello()
            check_firmware(self.name, hello)
        except BaseException:
            self.close()
            raise
        self.origin = origin_of(hello)
        return hello

    def configure(self, odr: int, samples: int, ring_down_samples: int = 20) -> None:
        """Set all sensors, and wait until it has taken effect.

        Raises:
            UsageError: values no sensor has. DeviceError: the rig refuses or does not answer.
        """
        self._bad_configs.clear()
        self._config = Config(odr=odr, samples=samples, ring_down_samples=ring_down_samples)
        self._tell(self._config)
        self._sync()
        if self._bad_configs:
            raise DeviceError(f"{self.name}: the rig refuses the configuration: {self._bad_configs[-1]}")

    def start(self, mode: int = MODE_TRANSMIT_RECEIVE, rate_hz: float = 1e6 / 25_600) -> None:
        """Trigger from now on."""
        self._running = Start(mode=mode, rate_hz=rate_hz)
        self._tell(self._running)
        self._heard_s = self.now()

    def stop(self) -> list[EchoCycle]:
        """Trigger no more; returns the cycles that were still on their way."""
        self._running = None
        self._tell(Stop())
        self._sync()
        last = self._assembler.flush()
        return self._take_ready() + ([last] if last is not None else [])

    def self_test(self) -> Hello:
        """Built-in test of all sensors; HELLO with the results."""
        self._tell(SelfTest(kind=0))
        return self._sync()

    def link_test(self) -> dict[int, float | None]:
        """Each sensor sends a known sequence: share of wrong samples by sensor, None for one that sent nothing.

        Raises:
            UsageError: the rig is running.
        """
        if self._running is not None:
            raise UsageError(f"{self.name}: the link test needs an idle rig: stop it first")
        hello = self.hello
        assert hello is not None
        self._link_echoes = {}
        try:
            self._tell(SelfTest(kind=LINK_TEST))
            self._sync()
            echoes = self._link_echoes
        finally:
            self._link_echoes = None
        return {s.sensor: _wrong_share(echoes[s.sensor]) if s.sensor in echoes else None for s in hello.sensors}

    # ---- the stream ------------------------------------------------------------------------------
    def take_stands(self) -> list[Stand]:
        """STAND messages since the last call."""
        taken = list(self._stands)
        self._stands.clear()
        return taken

    @property
    def up(self) -> bool:
        """Whether the link stands right now."""
        return self._down_since_s is None

    @property
    def temperature_c(self) -> float | None:
        """Of the air: as the rig measures it, else as given, else None."""
        if self.status is not None and np.isfinite(self.status.temperature_c):
            return self.status.temperature_c
        return self._temperature_c

    @property
    def sound_speed_m_s(self) -> float:
        """At the air's temperature; at 20 C where nobody knows it (`temperature_c` is None)."""
        known = self.temperature_c
        return sound_speed_m_s(ASSUMED_TEMPERATURE_C if known is None else known)

    def _receive(self, timeout_s: float) -> None:
        if self._down_since_s is not None and not self._recover(timeout_s):
            return
        try:
            data = self._link.read(timeout_s)
        except DeviceError as error:
            self._lost(error)
            return
        now = self.now()
        if data:
            self._heard_s = now
            self._keep(data, now)
        elif self._running is not None and self._down_since_s is None and now - self._heard_s > self._silence_s:
            self.losses.silences += 1
            self._go_down(f"{self.name}: nothing came for {self._silence_s:g} s: is it hung?")

    def _keep(self, data: bytes, now_s: float) -> None:
        if self._writer is not None:
            self._writer.write(data, round((now_s - self._opened_s) * 1e6))
        self._take_bytes(data)

    def _take_bytes(self, data: bytes) -> None:
        now_s = self.now()
        for message in self.decoder.feed(data):
            self._see(message)
            if isinstance(message, Echo) and self._link_echoes is not None:
                self._link_echoes[message.sensor] = message
                continue
            if isinstance(message, Echo):
                self.losses.overruns += bool(message.flags & FLAG_OVERRUN)
            cycle = self._assembler.add(message)
            if cycle is not None:
                self.clock.add(cycle.t_us, now_s)
                self._ready.append(cycle)

    def _see(self, message: Message) -> None:
        if isinstance(message, Status):
            self.status = message
        elif isinstance(message, Stand):
            self._stands.append(message)
        elif isinstance(message, Fault):
            self.faults.append(message)
            if "CONFIG" in message.text:
                self._bad_configs.append(message.text)
        elif isinstance(message, Hello):
            self._hello_came(message)

    # ---- loss and return -------------------------------------------------------------------------
    def send(self, message: Message) -> None:
        # SELF TEST of kind 0 is answered by a HELLO as well.
        self._asked += isinstance(message, HelloRequest) or (isinstance(message, SelfTest) and message.kind == 0)
        super().send(message)

    def _tell(self, message: Message) -> None:
        """Send, and where the cable is out, as soon as it is in again."""
        while True:
            while self._down_since_s is not None:
                self._receive(REOPEN_S)
            try:
                self.send(message)
                return
            except DeviceError as error:
                self._lost(error)

    def _lost(self, error: DeviceError) -> None:
        self.losses.unplugged += self._down_since_s is None
        self._go_down(str(error))

    def _go_down(self, why: str) -> None:
        self._link.close()
        self._linked = False
        if self._down_since_s is not None:
            return
        self._down_since_s, self._down_why = self.now(), why
        self._try_s = 0.0
        # The rest of a frame that was cut: it must not grow together with what comes next.
        self._keep(b"\0", self._down_since_s)

    def _recover(self, timeout_s: float) -> bool:
        """One step towards a link; True when there is something to read from."""
        assert self._down_since_s is not None
        now = self.now()
        if now - self._down_since_s > self._reconnect_s:
            raise DeviceError(f"{self._down_why}; it did not come back in {self._reconnect_s:g} s: check cable and "
                              "power" + (f"; what came is safe in {self._record_path}" if self._record_path else ""))
        if not self._linked and now >= self._try_s:
            self._try_s = now + REOPEN_S
            try:
                self._link.open()
                self._linked, self._ask_s = True, now
            except DeviceError:
                pass
        if self._linked and now >= self._ask_s:
            self._ask_s = now + HELLO_REPEAT_S
            try:
                self.send(HelloRequest())
            except DeviceError:
                self._link.close()
                self._linked = False
        if not self._linked:
            self._sleep(max(0.0, min(timeout_s, REOPEN_S)))
        return self._linked

    def _hello_came(self, hello: Hello) -> None:
        known = self.hello
        back = self._down_since_s is not None
        if known is not None and [(s.sensor, s.serial) for s in known.sensors] != [(s.sensor, s.serial)
                                                                                    for s in hello.sensors]:
            raise DeviceError(f"{self.name}: another rig answers than at the start (sensors "
                              f"{[s.serial for s in known.sensors]}, now {[s.serial for s in hello.sensors]}): start a "
                              "new recording for it")
        if self._down_since_s is not None:
            self.losses.lost_s += self.now() - self._down_since_s
            self._down_since_s = None
        restarted = known is not None and bool(hello.flags & FLAG_BOOT)
        if restarted:
            self.losses.restarts += 1
            self.clock.restart()
        if back or restarted:
            self._answered = self._asked
            self._resume()
        elif not hello.flags & FLAG_BOOT:
            self._answered += 1

    def _resume(self) -> None:
        """Tell it again what it was told; a device that was not switched off does not mind."""
        self._heard_s = self.now()
        try:
            if self._config is not None:
                self.send(self._config)
            if self._running is not None:
                self.send(self._running)
        except DeviceError as error:
            self._lost(error)

    def _sync(self) -> Hello:
        """Wait for the answer to a HELLO? sent now: all that was sent before it has been taken."""
        self._tell(HelloRequest())
        deadline = self.now() + ANSWER_S
        while self._answered < self._asked:
            left_s = deadline - self.now()
            if left_s <= 0.0:
                raise DeviceError(f"{self.name}: the rig does not answer within {ANSWER_S:g} s: is it hung? Switch it "
                                  "off and on")
            self._receive(min(left_s, 0.1))
        assert self.hello is not None
        return self.hello


def _wrong_share(echo: Echo) -> float:
    ramp = np.arange(len(echo.iq), dtype=np.int16)
    return float(np.mean((echo.iq[:, 0] != ramp) | (echo.iq[:, 1] != -ramp)))


def open_rig(url: str, *, record: Path | None = None, metadata: dict[str, str] | None = None,
             reconnect_s: float = 10.0, temperature_c: float | None = None) -> Rig:
    """The rig that a URL names, connected: `serial:///dev/ttyACM0[?baud=N]` or `tcp://host:port`.

    Raises:
        UsageError: no such form, a recording that exists, a temperature outside -40..60 C.
        DeviceError: nobody there, another program has it, or a firmware this version does not know.
    """
    if temperature_c is not None and not -40.0 <= temperature_c <= 60.0:
        raise UsageError(f"temperature {temperature_c} C is outside -40..60: give the temperature of the air")
    rig = Rig(rig_link(url), record=record, metadata=metadata, reconnect_s=reconnect_s, temperature_c=temperature_c)
    rig.open()
    return rig
