"""The bridge script itself, run in node with the application's interface around it, and our driver at the other end."""

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.thrust_stand.registry import open_stand
from saranga.errors import DeviceError

HERE = Path(__file__).parent
SCRIPT = HERE.parents[1] / "bench" / "thrust_stand" / "rcbenchmark_bridge.js"
pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="node is absent: it runs the bridge script")


class Application:
    """The stand-in application as a process; `outputs` is what it set the ESC to, in order."""

    def __init__(self) -> None:
        self.port, self.listen = free_port(), free_port()
        self.url = f"rcbenchmark+udp://127.0.0.1:{self.port}?listen={self.listen}"
        self.process = subprocess.Popen(
            ["node", HERE / "rcbenchmark_application.js", SCRIPT, str(self.port), str(self.listen)],
            stdout=subprocess.PIPE, text=True)
        self.outputs: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.outputs.append(json.loads(line))

    def wait_for(self, us: float, timeout_s: float = 20.0) -> dict[str, Any]:
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            found = [output for output in self.outputs if output["us"] == us]
            if found:
                return found[-1]
            time.sleep(0.01)
        raise AssertionError(f"never set to {us}: {self.outputs}")

    def ends_at(self, us: float, timeout_s: float = 20.0) -> bool:
        """Whether what it set last is, or soon becomes, `us`: its answer may overtake its output."""
        end_s = time.monotonic() + timeout_s
        while self.outputs[-1]["us"] != us and time.monotonic() < end_s:
            time.sleep(0.01)
        return self.outputs[-1]["us"] == us

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._thread.join()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


@pytest.fixture
def application() -> Iterator[Application]:
    running = Application()
    yield running
    running.close()


@pytest.fixture
def stand(application: Application, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr("bench.thrust_stand.drivers.rcbenchmark.HELLO_TIMEOUT_S", 30.0)
    application.wait_for(1000)
    opened: Any = open_stand(application.url)
    opened.open()
    yield opened
    opened.close()


def settled(stand: Any, applied: tuple[float, int]) -> None:
    end_s = time.monotonic() + 20.0
    while stand.applied() != applied and time.monotonic() < end_s:
        time.sleep(0.01)
    assert stand.applied() == applied


def test_the_script_idles_the_motor_first_and_measures_in_si(application: Application, stand: Any) -> None:
    assert [output["us"] for output in application.outputs] == [1000]
    settled(stand, (0.0, 0))  # until the script has said so, a reading does not know the throttle
    reading = stand.read(5.0)[-1]
    assert reading.thrust_n == pytest.approx(3.5 * 9.80665e-3)
    assert reading.torque_n_m == pytest.approx(0.01) and reading.vibration_m_s2 == pytest.approx(0.5 * 9.80665)
    assert reading.throttle == 0.0 and reading.token == 0


def test_the_script_tares_and_refuses_to_while_the_motor_turns(stand: Any) -> None:
    stand.tare()
    assert abs(stand.read(5.0)[-1].thrust_n) < 1e-6
    stand.command(0.2, 3, 2.0)
    with pytest.raises(DeviceError, match="the motor turns"):
        stand.tare()


def test_the_scripts_dead_man_idles_the_motor_after_the_deadline(application: Application, stand: Any) -> None:
    stand.command(0.25, 7, 0.3)
    on = application.wait_for(1250)
    settled(stand, (0.25, 7))
    settled(stand, (0.0, 0))
    assert application.ends_at(1000)
    off = application.outputs[-1]
    assert 250 <= off["t_ms"] - on["t_ms"] <= 5000, "not before its deadline; much after only on a busy machine"


def test_commands_in_time_keep_the_motor_turning(application: Application, stand: Any) -> None:
    end_s = time.monotonic() + 1.5
    token = 0
    while time.monotonic() < end_s:
        token += 1
        stand.command(0.3, token, 2.0)
        time.sleep(0.05)
    assert {output["us"] for output in application.outputs[1:]} == {1300}


def test_the_script_idles_on_what_it_cannot_understand(application: Application, stand: Any) -> None:
    for wrong in ({"do": "throttle", "us": 5000, "token": 1, "deadline_ms": 100},
                  {"do": "throttle", "us": "1200", "token": 1, "deadline_ms": 100},
                  {"do": "throttle", "us": 1200, "token": 1, "deadline_ms": 60_000},
                  {"do": "throttle", "us": 1200, "token": 1}):
        stand.command(0.4, 9, 2.0)
        application.wait_for(1400)
        settled(stand, (0.4, 9))
        stand._send(wrong)
        end_s = time.monotonic() + 20.0
        with pytest.raises(DeviceError, match="out of limits"):
            while time.monotonic() < end_s:
                stand.read(0.1)
        assert application.ends_at(1000)
        application.outputs.clear()


def test_closing_the_driver_idles_the_motor(application: Application, stand: Any) -> None:
    stand.command(0.5, 9, 2.0)
    application.wait_for(1500)
    stand.close()
    end_s = time.monotonic() + 1.5
    while application.outputs[-1]["us"] != 1000 and time.monotonic() < end_s:
        time.sleep(0.01)
    assert application.outputs[-1]["us"] == 1000, "well before the 2 s of its deadline"


def test_rubbish_on_the_scripts_port_is_answered_and_changes_nothing(application: Application, stand: Any) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for data in (b"\xff\x00", b"[1]", b"null", b'{"do":"explode"}', b"1500"):
            sock.sendto(data, ("127.0.0.1", application.port))
    with pytest.raises(DeviceError, match="the script says"):
        end_s = time.monotonic() + 20.0
        while time.monotonic() < end_s:
            stand.read(0.1)
    assert [output["us"] for output in application.outputs] == [1000]
