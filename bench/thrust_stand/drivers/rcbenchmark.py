"""A stand of Tyto Robotics (Series 1520, 1580, 1780) through its application's script: `rcbenchmark_bridge.js`.

The script runs inside the RCbenchmark application and speaks JSON datagrams; both ends are ours, the stand's own
protocol is not touched. Its readback is what the script has set, not what the ESC does.
"""

import contextlib
import json
import math
import socket
import time
from collections import deque
from typing import Any

from bench.thrust_stand.calibration import Calibration
from bench.thrust_stand.drivers.teensy import check_command
from bench.thrust_stand.protocol import StandInfo, StandReading
from bench.thrust_stand.registry import Where
from bench.thrust_stand.units import conversion, known_units
from saranga.errors import DeviceError

NAME = "rcbenchmark"
FORMS = "rcbenchmark+udp://127.0.0.1:55047[?listen=64126&bind=127.0.0.1]"
MEASURES = True
SPINS = True

BRIDGE_VERSION = 1
DEFAULT_LISTEN = 64_126
HELLO_TIMEOUT_S = 5.0
HELLO_REPEAT_S = 0.5
SILENT_S = 2.0
MOST_BYTES = 65_536
MOST_WAITING = 10_000
# the script's names of sensors -> (field, dimension); of two speeds the first that turns is taken
SENSORS: dict[str, tuple[str, str]] = {
    "thrust": ("thrust_n", "force"), "torque": ("torque_n_m", "torque"), "voltage": ("voltage_v", "voltage"),
    "current": ("current_a", "current"), "motorElectricalSpeed": ("rpm", "rotation"),
    "motorOpticalSpeed": ("rpm", "rotation"), "vibration": ("vibration_m_s2", "acceleration")}


class RCbenchmarkStand:
    """ThrustStand and ThrottleOutput in one, over the script."""

    readback = True

    def __init__(self, where: Where, listen: int, bind: str, calibration: Calibration) -> None:
        self.url = where.url
        self.bad_datagrams = 0
        self.lost_datagrams = 0
        self.foreign_datagrams = 0
        self._peer = (where.host, where.port)
        self._bind = (bind, listen)
        self._calibration = calibration
        self._socket: socket.socket | None = None
        self._hello: dict[str, Any] | None = None
        self._waiting: deque[StandReading] = deque(maxlen=MOST_WAITING)
        self._last: StandReading | None = None
        self._count: int | None = None
        self._tared = 0
        self._heard_s = 0.0
        self._error = ""
        self._spun = False

    # ---- connection ------------------------------------------------------------------------------
    def open(self) -> StandInfo:
        """Bind, ask the script who it is, and wait for its first reading.

        Raises:
            DeviceError: the port is taken, the script does not answer, is another version, or reads no thrust.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._hello, self._last, self._count, self._spun, self._error = None, None, None, False, ""
        self._waiting.clear()
        try:
            self._bind_and_ask()
        except BaseException:
            self.close()
            raise
        assert self._hello is not None and self._last is not None
        measured = frozenset(field for field, _ in SENSORS.values() if math.isfinite(getattr(self._last, field)))
        longest_ms = float(self._hello["longest_ms"])
        return StandInfo(name=f"RCbenchmark {self._hello.get('board', '')}".strip(), origin="measured",
                         firmware=f"{self._hello.get('firmware', 'unknown')}, bridge {self._hello['bridge']}",
                         quantities=measured, has_throttle=True, dead_man_s=longest_ms * 1e-3)

    def close(self) -> None:
        """Idle the throttle if it was ever used, and let go. Never raises."""
        if self._socket is None:
            return
        if self._spun and self._hello is not None:
            with contextlib.suppress(DeviceError):  # gone: the script's own dead man idles it
                self._send({"do": "throttle", "us": self._idle_us(), "token": 0, "deadline_ms": 1})
        self._socket.close()
        self._socket = None

    def _bind_and_ask(self) -> None:
        sock = self._opened()
        try:
            sock.bind(self._bind)
            self._peer = (socket.gethostbyname(self._peer[0]), self._peer[1])
        except (OSError, OverflowError) as error:
            raise DeviceError(f"{self.url}: cannot listen on {self._bind[0]}:{self._bind[1]}: {error}; stop who has "
                              "the port, or choose another with ?listen= here and BENCH_PORT in the script") from error
        began_s = ask_s = time.monotonic()
        while self._hello is None or self._last is None:
            now_s = time.monotonic()
            if now_s - began_s >= HELLO_TIMEOUT_S:
                raise DeviceError(self._no_answer())
            if now_s >= ask_s:
                self._send({"do": "hello"})
                ask_s = now_s + HELLO_REPEAT_S
            self._receive(min(ask_s, began_s + HELLO_TIMEOUT_S) - now_s)
        bridge = self._hello.get("bridge")
        if bridge != BRIDGE_VERSION:
            raise DeviceError(f"{self.url}: the script is bridge {bridge!r}, this driver knows {BRIDGE_VERSION}: run "
                              "the rcbenchmark_bridge.js of this version")
        if not all(isinstance(self._hello.get(key), int | float) for key in ("longest_ms", "idle_us", "full_us")):
            raise DeviceError(f"{self.url}: the script does not state its limits: run the rcbenchmark_bridge.js of "
                              "this version")

    def _no_answer(self) -> str:
        peer = f"{self._peer[0]}:{self._peer[1]}"
        if self._hello is not None:
            return (f"{self.url}: the script answers but sends no readings in {HELLO_TIMEOUT_S:g} s: is the stand "
                    "connected in the application?")
        stray = f"; {self.foreign_datagrams} datagrams came from elsewhere" if self.foreign_datagrams else ""
        return (f"{self.url}: no answer from {peer} in {HELLO_TIMEOUT_S:g} s{stray}: is rcbenchmark_bridge.js running, "
                f"with RECEIVE_PORT {self._peer[1]} and BENCH_PORT {self._bind[1]}?")

    # ---- measuring -------------------------------------------------------------------------------
    def read(self, timeout_s: float) -> list[StandReading]:
        """What came since the last call.

        Raises:
            DeviceError: the script has been silent for 2 s, or complains.
        """
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = 0.0 if self._waiting else max(0.0, end_s - time.monotonic())
            self._receive(left_s)
            if self._waiting or left_s == 0.0:
                break
        self._check_alive()
        taken = list(self._waiting)
        self._waiting.clear()
        return taken

    def tare(self) -> float:
        """The application tares its load cells; what is left after that is taken off here.

        Raises:
            DeviceError: the motor turns, or no confirmation came.
        """
        wanted = self._tared + 1
        self._send({"do": "tare", "id": wanted})
        end_s = time.monotonic() + 10.0
        while self._tared < wanted:
            if time.monotonic() >= end_s:
                raise DeviceError(f"{self.url}: tare was not confirmed in 10 s: look at the application's console")
            self._receive(0.1)
            self._check_alive()
        return self._calibration.tare(self.url, self.read)

    # ---- spinning --------------------------------------------------------------------------------
    def command(self, value: float, token: int, deadline_s: float) -> None:
        """Throttle for at most `deadline_s`, which the script keeps.

        Raises:
            UsageError: a value outside its limits. DeviceError: the script is gone or complains.
        """
        self._opened()
        if self._hello is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        check_command(value, token, deadline_s, float(self._hello["longest_ms"]) * 1e-3)
        self._check_alive()
        idle_us, full_us = self._idle_us(), float(self._hello["full_us"])
        self._spun = True
        self._send({"do": "throttle", "us": round(idle_us + value * (full_us - idle_us), 1), "token": token,
                    "deadline_ms": max(1, round(deadline_s * 1e3))})

    def applied(self) -> tuple[float, int] | None:
        """What the script last said it has set."""
        self._receive(0.0)
        return None if self._last is None else (self._last.throttle, self._last.token)

    def _idle_us(self) -> float:
        assert self._hello is not None
        return float(self._hello["idle_us"])

    # ---- datagrams -------------------------------------------------------------------------------
    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        return self._socket

    def _send(self, what: dict[str, Any]) -> None:
        try:
            self._opened().sendto(json.dumps(what, separators=(",", ":")).encode("latin-1"), self._peer)
        except OSError as error:
            raise DeviceError(f"{self.url}: cannot send: {error.strerror}; is the other computer up?") from error

    def _receive(self, timeout_s: float) -> None:
        """Take in what waits, waiting at most `timeout_s` for the first."""
        sock = self._opened()
        sock.settimeout(max(timeout_s, 0.0))
        while True:
            try:
                data, sender = sock.recvfrom(MOST_BYTES)
            except (BlockingIOError, TimeoutError):
                break
            except ConnectionRefusedError as error:
                raise DeviceError(f"{self.url}: nobody listens there: is rcbenchmark_bridge.js running?") from error
            except OSError as error:
                raise DeviceError(f"{self.url}: lost: {error.strerror}") from error
            sock.setblocking(False)
            if sender[0] != self._peer[0]:
                self.foreign_datagrams += 1
                continue
            self._take(data)
        if self._error:
            error_text, self._error = self._error, ""
            raise DeviceError(f"{self.url}: the script says {error_text!r}: look at the application's console")

    def _take(self, data: bytes) -> None:
        try:
            message = json.loads(data.decode("latin-1"))
        except ValueError:
            self.bad_datagrams += 1
            return
        if not isinstance(message, dict) or message.get("saranga") != 1:
            self.bad_datagrams += 1
            return
        self._heard_s = time.monotonic()
        if isinstance(message.get("error"), str):
            self._error = message["error"]
        elif isinstance(message.get("hello"), dict):
            self._hello = message["hello"]
        elif isinstance(message.get("tared"), int):
            self._tared = message["tared"]
        elif isinstance(message.get("n"), int) and isinstance(message.get("sensors"), dict):
            self._take_reading(message)
        else:
            self.bad_datagrams += 1

    def _take_reading(self, message: dict[str, Any]) -> None:
        """A datagram that overtook another is dropped: the newer reading is known already."""
        count = message["n"]
        if self._count is not None and count != 1:
            if count <= self._count:
                return
            self.lost_datagrams += count - self._count - 1
        self._count = count
        values: dict[str, float] = {}
        for key, (field, dimension) in SENSORS.items():
            entry = message["sensors"].get(key)
            if not isinstance(entry, dict) or not isinstance(entry.get("value"), int | float):
                continue
            factors = conversion(dimension, str(entry.get("unit", "")))
            if factors is None:
                raise DeviceError(f"{self.url}: {key} comes in {entry.get('unit')!r}, which is no unit of {dimension}: "
                                  f"known are {known_units(dimension)}")
            value = float(entry["value"]) * factors[0] + factors[1]
            if math.isfinite(value) and not (field == "rpm" and values.get("rpm", 0.0) > 0.0):
                values[field] = value
        values["thrust_n"] = self._calibration(values.get("thrust_n", math.nan))
        self._last = StandReading(time_s=self._heard_s, throttle=self._throttle(message), token=_token(message),
                                  **values)
        self._waiting.append(self._last)

    def _throttle(self, message: dict[str, Any]) -> float:
        applied_us = message.get("us")
        if self._hello is None or not isinstance(applied_us, int | float):
            return math.nan
        idle_us, full_us = self._idle_us(), float(self._hello["full_us"])
        return (applied_us - idle_us) / (full_us - idle_us)

    def _check_alive(self) -> None:
        silent_s = time.monotonic() - self._heard_s
        if silent_s > SILENT_S:
            raise DeviceError(f"{self.url}: silent for {silent_s:.1f} s: has the script or the application "
                              "stopped?")


def _token(message: dict[str, Any]) -> int:
    token = message.get("token")
    return token if isinstance(token, int) else 0


def build(where: Where, listen: int = DEFAULT_LISTEN, bind: str = "127.0.0.1", thrust_scale: float = 1.0,
          thrust_sign: int = 1) -> RCbenchmarkStand:
    """The stand behind a URL, whose host and port are the script's RECEIVE_PORT.

    Args:
        listen: the script's BENCH_PORT.
        bind: address to listen on; the loopback unless the application runs on another computer.
        thrust_scale, thrust_sign: see `Calibration`.
    """
    if where.transport != "udp" or not where.host or not where.port:
        raise where.refused(FORMS)
    if not isinstance(listen, int) or not 0 < listen < 65_536:
        raise ValueError(f"listen is {listen!r}: it must be a port, 1..65535")
    return RCbenchmarkStand(where, listen, str(bind), Calibration(thrust_scale, thrust_sign))
