"""The Teensy driver through real ports: the emulated device behind a pty and TCP, served by a thread."""

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from bench.rig.emulate_command import make_device
from bench.rig.serve import TruthFile, open_port, serve
from bench.thrust_stand.registry import open_stand
from saranga.errors import DeviceError


@pytest.fixture(params=["pty", "tcp"])
def served(request: pytest.FixtureRequest) -> Iterator[tuple[str, Any]]:
    port = open_port(request.param)
    device = make_device("pair", "g1", [], 0.0, "none", [], 1, backlog_us=500_000)
    stop = threading.Event()
    began_s = time.monotonic()
    thread = threading.Thread(target=serve, args=(device, port, TruthFile(None, began_s), began_s, stop.is_set))
    thread.start()
    yield f"teensy+{port.url}", device
    stop.set()
    thread.join(10.0)
    port.close()
    assert not thread.is_alive()


def wait_for(condition: Any, timeout_s: float = 30.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "in vain"
        time.sleep(0.01)


def test_a_stand_on_a_port_measures_spins_and_idles_by_itself(served: tuple[str, Any]) -> None:
    url, _ = served
    stand: Any = open_stand(url)
    info = stand.open()
    assert info.origin == "emulated" and info.has_throttle and "thrust_n" in info.quantities
    stand.tare()
    newest = {"thrust_n": 0.0}

    def pulls() -> bool:
        stand.command(0.5, 21, 1.0)
        for reading in stand.read(0.05):
            newest["thrust_n"] = reading.thrust_n
        return newest["thrust_n"] > 1.0 and stand.applied()[1] == 21

    wait_for(pulls)
    wait_for(lambda: stand.applied() == (0.0, 0))
    assert stand.counters.bad_crc == 0
    stand.close()


def test_a_stand_that_is_unplugged_is_an_error_and_opens_again(served: tuple[str, Any]) -> None:
    url, device = served
    stand = open_stand(url)
    stand.open()
    object.__setattr__(device.faults, "unplug_at_s", 0.0)
    with pytest.raises(DeviceError, match=r"lost: .*(unplugged|still up)"):
        wait_for(lambda: stand.read(0.05) is None)
    stand.close()
    with pytest.raises(DeviceError, match="cannot"):
        stand.open()
    object.__setattr__(device.faults, "unplug_at_s", None)
    wait_for(lambda: opens(stand))
    assert stand.read(5.0)
    stand.close()


def opens(stand: Any) -> bool:
    try:
        return bool(stand.open().has_throttle)
    except DeviceError:
        return False


@pytest.mark.parametrize("served", ["pty"], indirect=True)
def test_a_serial_port_that_somebody_holds_is_refused(served: tuple[str, Any]) -> None:
    url, _ = served
    first = open_stand(url)
    first.open()
    with pytest.raises(DeviceError, match=r"cannot be opened.*the port free"):
        open_stand(url).open()
    first.close()
