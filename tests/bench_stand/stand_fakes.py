"""The other end of each driver, in bytes: what a driver must send, to the byte, and what comes back."""

import json
import socket
import threading
import time
from typing import Any

from golden_frames import FRAMES, MESSAGES
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import DeviceError
from saranga.wire import Stand, encode


class ScriptedLink:
    """A byte link with a script: each write must be the next expected bytes, whose answer is then there to read.

    `stream` is called at each read and gives what the device says by itself.
    """

    def __init__(self, url: str, expected: list[tuple[bytes, bytes]] | None = None, stream: Any = None) -> None:
        self.url = url
        self.expected = list(expected or [])
        self.stream = stream
        self.lost = False
        self.opened = 0
        self.closed = 0
        self._waiting = b""

    def open(self) -> None:
        self.opened += 1

    def say(self, data: bytes) -> None:
        self._waiting += data

    def read(self, timeout_s: float) -> bytes:
        if self.lost:
            raise DeviceError(f"{self.url}: lost: Input/output error; was it unplugged?")
        if self.stream is not None:
            self._waiting += self.stream()
        data, self._waiting = self._waiting, b""
        if not data and timeout_s > 0.0:
            time.sleep(min(timeout_s, 0.002))
        return data

    def write(self, data: bytes) -> None:
        if self.lost:
            raise DeviceError(f"{self.url}: lost: Input/output error; was it unplugged?")
        assert self.expected, f"nothing more was expected, {data.hex()} came"
        wanted, answer = self.expected.pop(0)
        assert data == wanted, f"expected {wanted.hex()}, got {data.hex()}"
        self._waiting += answer

    def close(self) -> None:
        self.closed += 1


class StandStream:
    """STAND frames at each read: thrust around `thrust_n`, the motor standing unless said."""

    def __init__(self, thrust_n: float = 0.02, **fields: Any) -> None:
        self.fields = {"thrust_n": thrust_n, "torque_n_m": 0.0, "rpm": 0.0, "voltage_v": 11.1, "current_a": 0.1,
                       "esc_temperature_c": 25.0, "motor_temperature_c": 26.0, **fields}
        self.sequence = 100

    def __call__(self) -> bytes:
        self.sequence += 1
        return encode(Stand(sequence=self.sequence, **self.fields))


def teensy_link(expected: list[tuple[bytes, bytes]] | None = None, stream: Any = None,
                hello: bytes = FRAMES["hello"]) -> ScriptedLink:
    """A Teensy that answers HELLO? and streams."""
    return ScriptedLink("teensy+serial:///dev/fake", [(FRAMES["hello_request"], hello), *(expected or [])],
                        stream or StandStream())


def golden_stand() -> Any:
    """The STAND of the golden frames, as a message."""
    return MESSAGES["stand"]


class LineStream:
    """Lines at each read; the first is cut, as one that is joined in its middle."""

    def __init__(self, thrust: str = "2.0") -> None:
        self.thrust = thrust
        self.count = 0
        self.begun = False

    def __call__(self) -> bytes:
        self.count += 1
        head = b"" if self.begun else b"00,9"
        self.begun = True
        return head + b"\r\n# comment\r\n" + f"{self.count},{self.thrust},0,11.1".encode()


class FakeBridge:
    """What rcbenchmark_bridge.js does, on a loopback socket: answers, streams, keeps the dead man, logs what came."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.01)
        free = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        free.bind(("127.0.0.1", 0))
        self.listen = free.getsockname()[1]
        free.close()
        self.port = self.socket.getsockname()[1]
        self.url = f"rcbenchmark+udp://127.0.0.1:{self.port}?listen={self.listen}"
        self.received: list[bytes] = []
        self.hello = {"board": "Series 1520", "firmware": "1.2", "bridge": 1, "longest_ms": 2000, "idle_us": 1000,
                      "full_us": 2000}
        self.thrust: Any = {"value": 2.0, "unit": "g"}
        self.us, self.token, self.until_s = 1000, 0, 0.0
        self.silent = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def send(self, what: dict[str, Any]) -> None:
        self.socket.sendto(json.dumps({"saranga": 1, **what}).encode("latin-1"), ("127.0.0.1", self.listen))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.socket.close()

    def _run(self) -> None:
        count = 0
        while not self._stop.is_set():
            try:
                data = self.socket.recv(65_536)
            except (TimeoutError, ConnectionRefusedError):
                data = b""
            if data:
                self.received.append(data)
                self._answer(json.loads(data.decode("latin-1")))
            if self.us > 1000 and time.monotonic() > self.until_s:
                self.us, self.token = 1000, 0
            if not self.silent:
                count += 1
                self.send({"n": count, "us": self.us, "token": self.token, "sensors": {
                    "thrust": self.thrust, "voltage": {"value": 11.1, "unit": "V"},
                    "current": {"value": 0.1, "unit": "A"},
                    "motorElectricalSpeed": {"value": 0, "unit": "RPM"},
                    "motorOpticalSpeed": {"value": 0, "unit": "RPM"}, "pressure": {"value": 1, "unit": "Pa"}}})

    def _answer(self, message: dict[str, Any]) -> None:
        if message["do"] == "hello":
            self.send({"hello": self.hello})
        elif message["do"] == "throttle":
            self.us, self.token = message["us"], message["token"]
            self.until_s = time.monotonic() + message["deadline_ms"] * 1e-3
        elif message["do"] == "tare":
            self.send({"tared": message["id"]})


class FakeCopter:
    """ArduCopter's side of a motor test, with MAVLink's own codec; frames from the host are kept as bytes."""

    def __init__(self, result: int = mavlink.MAV_RESULT_ACCEPTED, armed: bool = False,
                 vehicle: int = mavlink.MAV_TYPE_QUADROTOR, text: str = "") -> None:
        self.url = "motortest+serial:///dev/fake"
        self.result, self.armed, self.vehicle, self.text = result, armed, vehicle, text
        self.frames: list[bytes] = []
        self.tests: list[Any] = []
        self.lost = False
        self.silent = False
        self.closed = 0
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser = mavlink.MAVLink(None)
        self._waiting = b""

    def open(self) -> None:
        pass

    def read(self, timeout_s: float) -> bytes:
        if self.lost:
            raise DeviceError(f"{self.url}: lost: Input/output error; was it unplugged?")
        if self.silent:
            time.sleep(min(timeout_s, 0.01))
            return b""
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        self._waiting += mavlink.MAVLink_heartbeat_message(
            self.vehicle, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, mavlink.MAV_STATE_STANDBY, 3).pack(self._mav)
        data, self._waiting = self._waiting, b""
        return data

    def write(self, data: bytes) -> None:
        if self.lost:
            raise DeviceError(f"{self.url}: lost: Input/output error; was it unplugged?")
        if not data:
            return
        for message in self._parser.parse_buffer(data) or []:
            if message.get_type() == "COMMAND_LONG":
                self.frames.append(bytes(message.get_msgbuf()))
                self.tests.append(message)
                if self.text:
                    self._waiting += mavlink.MAVLink_statustext_message(4, self.text.encode()).pack(self._mav)
                self._waiting += mavlink.MAVLink_command_ack_message(
                    message.command, self.result, 0, 0, 255, 190).pack(self._mav)

    def close(self) -> None:
        self.closed += 1
