"""Our own stand: a Teensy that speaks rig protocol v1 (STAND in, THROTTLE out), on a serial port or TCP.

The same device may carry the sonar rig. Its throttle has a dead-man of its own: each command says how long it holds.
"""

import math
import re
import time
from collections import deque

from bench.thrust_stand.calibration import Calibration
from bench.thrust_stand.links import DEFAULT_BAUD, byte_link
from bench.thrust_stand.protocol import StandInfo, StandReading
from bench.thrust_stand.registry import Where
from saranga.byte_links import ByteLink
from saranga.errors import DeviceError, UsageError
from saranga.framing import VERSION, Decoder, LinkCounters, encode
from saranga.messages import FLAG_BOOT, Fault, Hello, HelloRequest, Stand, Throttle

NAME = "teensy"
FORMS = "teensy+serial:///dev/ttyACM0[?baud=N&thrust_sign=-1&thrust_scale=F] or teensy+tcp://127.0.0.1:5555"
MEASURES = True
SPINS = True

FIRMWARE_MAJOR = 1
OUR_FIRMWARE = re.compile(r"saranga-rig (\d+)\.")
LONGEST_DEADLINE_S = 5.0
HELLO_TIMEOUT_S = 5.0
HELLO_REPEAT_S = 0.5
FIRST_READING_S = 2.0
MOST_WAITING = 10_000
FIELDS = ("thrust_n", "torque_n_m", "rpm", "voltage_v", "current_a", "esc_temperature_c", "motor_temperature_c")


class TeensyStand:
    """ThrustStand and ThrottleOutput in one. `link` may be replaced before `open`, to listen in.

    Args:
        link: the bytes.
        calibration: of the thrust, on top of the device's own.
        hello_timeout_s: how long `open` waits for HELLO.
    """

    readback = True

    def __init__(self, link: ByteLink, calibration: Calibration | None = None,
                 hello_timeout_s: float = HELLO_TIMEOUT_S) -> None:
        self.url = link.url
        self.link = link
        self.faults: deque[Fault] = deque(maxlen=32)
        self._calibration = calibration or Calibration()
        self._hello_timeout_s = hello_timeout_s
        self._decoder = Decoder()
        self._waiting: deque[StandReading] = deque(maxlen=MOST_WAITING)
        self._hello: Hello | None = None
        self._last: StandReading | None = None
        self._open = False
        self._ready = False
        self._spun = False

    @property
    def counters(self) -> LinkCounters:
        """What came and what was wrong with it."""
        return self._decoder.counters

    # ---- connection ------------------------------------------------------------------------------
    def open(self) -> StandInfo:
        """Connect, ask HELLO? until HELLO comes, and wait for the first STAND.

        Raises:
            DeviceError: no connection, no HELLO, wrong protocol or firmware, no stand on it, or it does not stream.
        """
        self.link.open()
        self._open, self._spun = True, False
        # Nothing that was heard before counts: another device may be at the port now.
        self._decoder, self._hello, self._last = Decoder(), None, None
        self._waiting.clear()
        try:
            hello = self._await_hello()
            self._check(hello)
            self._await_reading()
        except BaseException:
            self.close()
            raise
        assert self._last is not None
        self._ready = True
        measured = frozenset(name for name in FIELDS if math.isfinite(getattr(self._last, name)))
        return StandInfo(name="Teensy stand", firmware=hello.firmware, quantities=measured,
                         origin="emulated" if "emulated" in hello.firmware.lower().split() else "measured",
                         has_throttle=hello.has_throttle, dead_man_s=LONGEST_DEADLINE_S if hello.has_throttle else None)

    def close(self) -> None:
        """Idle the throttle if it was ever used, and let go. Never raises."""
        if not self._open:
            return
        self._open = self._ready = False
        try:
            if self._spun:
                self.link.write(encode(Throttle(value=0.0, token=0, deadline_ms=1)))
        except DeviceError:
            pass  # Gone already: its own dead-man idles it.
        finally:
            self.link.close()

    def _await_hello(self) -> Hello:
        began_s = ask_s = time.monotonic()
        while self._hello is None:
            now_s = time.monotonic()
            if now_s - began_s >= self._hello_timeout_s:
                raise DeviceError(self._no_hello())
            if now_s >= ask_s:
                self.link.write(encode(HelloRequest()))
                ask_s = now_s + HELLO_REPEAT_S
            self._receive(min(ask_s, began_s + self._hello_timeout_s) - now_s)
        return self._hello

    def _no_hello(self) -> str:
        waited = f"{self.url}: no HELLO in {self._hello_timeout_s:g} s"
        foreign, counters = self._decoder.foreign_version, self.counters
        if foreign is not None:
            return f"{waited}; it speaks rig protocol v{foreign}, this is v{VERSION}: update its firmware"
        if counters.bytes_in:
            return (f"{waited}: {counters.bytes_in} bytes and {counters.messages} messages came: is it the stand's "
                    "port, at the right baud rate?")
        return f"{waited}, it is silent: check power and cable, and that this is the stand's port"

    def _check(self, hello: Hello) -> None:
        version = OUR_FIRMWARE.match(hello.firmware)
        if version and int(version[1]) != FIRMWARE_MAJOR:
            raise DeviceError(f"{self.url}: firmware is {hello.firmware!r}, this driver knows saranga-rig "
                              f"{FIRMWARE_MAJOR}.x: flash the firmware of this version (docs/firmware.md)")
        if not hello.has_stand:
            raise DeviceError(f"{self.url}: {hello.firmware!r} has no thrust stand: check the load cell's wiring and "
                              "the firmware's configuration, or give another --stand")

    def _await_reading(self) -> None:
        end_s = time.monotonic() + FIRST_READING_S
        while self._last is None:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                raise DeviceError(f"{self.url}: it said HELLO, but no STAND message in {FIRST_READING_S:g} s: check "
                                  "the load cell's amplifier")
            self._receive(left_s)

    # ---- measuring -------------------------------------------------------------------------------
    def read(self, timeout_s: float) -> list[StandReading]:
        """What came since the last call.

        Raises:
            DeviceError: the device is gone, has restarted, or reports a latched fault.
        """
        self._opened()
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = 0.0 if self._waiting else max(0.0, end_s - time.monotonic())
            self._receive(left_s)
            if self._waiting or left_s == 0.0:
                break
        taken = list(self._waiting)
        self._waiting.clear()
        return taken

    def tare(self) -> float:
        """As the protocol: half a second of readings, the motor standing."""
        return self._calibration.tare(self.url, self.read)

    # ---- spinning --------------------------------------------------------------------------------
    def command(self, value: float, token: int, deadline_s: float) -> None:
        """Throttle for at most `deadline_s` (0.001..5).

        Raises:
            UsageError: a value outside its limits. DeviceError: the device is gone or has no throttle.
        """
        check_command(value, token, deadline_s, LONGEST_DEADLINE_S)
        self._opened()
        if self._hello is None or not self._hello.has_throttle:
            raise DeviceError(f"{self.url}: it has no throttle output: give another --throttle")
        self._spun = True
        self.link.write(encode(Throttle(value=value, token=token, deadline_ms=max(1, round(deadline_s * 1e3)))))

    def applied(self) -> tuple[float, int] | None:
        """What the device last said it applies."""
        self._opened()
        self._receive(0.0)
        return None if self._last is None else (self._last.throttle, self._last.token)

    # ---- bytes -----------------------------------------------------------------------------------
    def _opened(self) -> None:
        if not self._open:
            raise DeviceError(f"{self.url} is not open: open it first")

    def _receive(self, timeout_s: float) -> None:
        data = self.link.read(max(0.0, timeout_s))
        now_s = time.monotonic()
        for message in self._decoder.feed(data):
            if isinstance(message, Stand):
                self._last = self._reading(message, now_s)
                self._waiting.append(self._last)
            elif isinstance(message, Hello):
                restarted = self._ready and message.flags & FLAG_BOOT
                self._hello = message
                if restarted:
                    raise DeviceError(f"{self.url}: the device has restarted by itself: check its supply, and "
                                      "tare again")
            elif isinstance(message, Fault):
                self.faults.append(message)
                if message.latched:
                    raise DeviceError(f"{self.url}: the device reports fault {message.code} ({message.text}), which "
                                      "stays until its power is cycled: find the cause first")

    def _reading(self, message: Stand, now_s: float) -> StandReading:
        values = {name: _finite(getattr(message, name)) for name in FIELDS}
        values["thrust_n"] = self._calibration(values["thrust_n"])
        return StandReading(time_s=now_s, throttle=_finite(message.throttle), token=message.token, **values)


def check_command(value: float, token: int, deadline_s: float, longest_s: float) -> None:
    """Limits that every throttle shares.

    Raises:
        UsageError: naming the value and its limit.
    """
    if not 0.0 <= value <= 1.0:
        raise UsageError(f"throttle is {value!r}: it must be 0..1")
    if not 0 <= token < 2**32:
        raise UsageError(f"throttle token is {token!r}: it must be 0..2^32-1")
    if not 0.0 < deadline_s <= longest_s:
        raise UsageError(f"throttle deadline is {deadline_s!r} s: it must be above 0 and at most {longest_s:g} s")


def _finite(value: float) -> float:
    return value if math.isfinite(value) else math.nan


def build(where: Where, baud: int = DEFAULT_BAUD, thrust_scale: float = 1.0, thrust_sign: int = 1) -> TeensyStand:
    """The stand behind a URL.

    Args:
        baud: of a serial port; USB ports ignore it.
        thrust_scale, thrust_sign: see `Calibration`.
    """
    return TeensyStand(byte_link(where, baud, FORMS), Calibration(thrust_scale, thrust_sign))
