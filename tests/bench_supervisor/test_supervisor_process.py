"""The supervisor as its own process, on an emulated device in another one. Times are generous: the machine is busy."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from bench.supervisor import Confirmation, Limits, Supervisor, SupervisorPlan
from bench.supervisor.device_log import DeviceLog
from bench.supervisor.emulated import Bay, EmulatedProcess
from saranga.byte_links import TcpLink
from saranga.errors import DeviceError, UsageError
from saranga.framing import Decoder, encode
from saranga.messages import Echo, Start, Throttle

pytestmark = [pytest.mark.wall_time, pytest.mark.xdist_group("wall_time")]
LIMITS = Limits(thrust_n=20.0, current_a=60.0, throttle=0.6, slew_per_s=5.0)


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedProcess]:
    bay = Bay(tmp_path_factory.mktemp("device") / "bay", "f4")
    yield bay.device
    bay.close()


def plan(device: EmulatedProcess, folder: Path, limits: Limits = LIMITS) -> SupervisorPlan:
    return SupervisorPlan(device.stand_url, device.stand_url, limits, token_timeout_s=1.0, stale_s=1.0, readback_s=1.0,
                          confirm_s=3.0, log_folder=folder)


def until(supervisor: Supervisor, done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 20.0
    while not done():
        assert time.monotonic() < end_s, supervisor.status()
        supervisor.refresh()
        time.sleep(0.02)


def test_it_spins_measures_and_stops_with_the_device_saying_so(device: EmulatedProcess, tmp_path: Path) -> None:
    with Supervisor.start(plan(device, tmp_path), Confirmation.typed("SPIN")) as supervisor:
        assert supervisor.origin == "emulated" and supervisor.confirmed
        assert "thrust_n" in supervisor.stand["quantities"]
        supervisor.set(0.4)
        until(supervisor, lambda: supervisor.status().state == "hold" and supervisor.status().applied > 0.39)
        supervisor.readings()
        until(supervisor, lambda: any(r.thrust_n > 0.1 and r.throttle > 0.39 for r in supervisor.readings()))
        report = supervisor.stop()
    assert report.confirmed and 0 <= report.seconds < 3.0 and not report.trips
    log = DeviceLog(device.truth)
    log.read()
    assert log.now() == 0.0 and max(log.applied) > 0.39
    with pytest.raises(DeviceError, match="has stopped"):
        supervisor.set(0.1)
    assert not psutil.pid_exists(supervisor.pid)


def test_nothing_spins_without_the_typed_word(device: EmulatedProcess, tmp_path: Path) -> None:
    log = DeviceLog(device.truth)
    log.read()
    seen = len(log.applied)
    with Supervisor.start(plan(device, tmp_path), Confirmation.typed("yes")) as supervisor:
        with pytest.raises(UsageError, match="SPIN"):
            supervisor.set(0.2)
        supervisor.set(0.0)
        time.sleep(0.3)
    log.read()
    assert max(log.applied[seen:], default=0.0) == 0.0


@pytest.mark.parametrize("value", [-0.1, 0.61, float("nan"), float("inf")])
def test_a_throttle_beyond_its_limit_is_refused_at_once(device: EmulatedProcess, tmp_path: Path, value: float) -> None:
    supervisor = object.__new__(Supervisor)
    supervisor.plan = plan(device, tmp_path)
    with pytest.raises(UsageError, match=r"limits\.throttle"):
        supervisor.set(value)


def test_a_limit_that_nothing_measures_is_refused_by_name(device: EmulatedProcess, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="vibration_m_s2"):
        Supervisor.start(plan(device, tmp_path, Limits(vibration_m_s2=50.0)), Confirmation.flag())


def test_a_device_that_is_not_there_is_named(tmp_path: Path) -> None:
    url = "teensy+tcp://127.0.0.1:9"
    with pytest.raises(DeviceError, match=r"127\.0\.0\.1:9"):
        Supervisor.start(SupervisorPlan(url, url, LIMITS, log_folder=tmp_path), Confirmation.flag())


def test_the_rig_on_the_same_port_hears_everything_and_cannot_touch_the_throttle(device: EmulatedProcess,
                                                                                 tmp_path: Path) -> None:
    with Supervisor.start(plan(device, tmp_path), Confirmation.flag()) as supervisor:
        assert supervisor.rig_url is not None
        link = TcpLink(supervisor.rig_url, "127.0.0.1", int(supervisor.rig_url.rpartition(":")[2]))
        link.open()
        supervisor.set(0.2)
        until(supervisor, lambda: supervisor.status().state == "hold")
        link.write(encode(Throttle(value=0.6, token=1, deadline_ms=5000)) + encode(Start(mode=1, rate_hz=40.0)))
        decoder, echoes = Decoder(), []

        def heard() -> bool:
            echoes.extend(m for m in decoder.feed(link.read(0.02)) if isinstance(m, Echo))
            return len(echoes) > 5

        until(supervisor, heard)
        until(supervisor, lambda: supervisor.status().tee_refused == 1)
        link.close()
        assert not supervisor.status().trips
    log = DeviceLog(device.truth)
    log.read()
    assert max(log.applied) < 0.5, "the throttle of the rig's user got through"


def test_a_trip_outlives_the_process_and_the_operator_clears_it(device: EmulatedProcess, tmp_path: Path) -> None:
    tight = Limits(thrust_n=0.05, throttle=0.6, slew_per_s=5.0)
    with Supervisor.start(plan(device, tmp_path, tight), Confirmation.flag()) as supervisor:
        with pytest.raises(DeviceError, match="thrust_n"):
            supervisor.set(0.4)
            until(supervisor, lambda: False)
        assert supervisor.stop().confirmed
    with Supervisor.start(plan(device, tmp_path), Confirmation.flag()) as supervisor:
        with pytest.raises(DeviceError, match="thrust_n"):
            supervisor.set(0.1)
        with pytest.raises(UsageError, match="CLEAR"):
            supervisor.clear(Confirmation.typed("clear"))
        supervisor.clear(Confirmation.typed("CLEAR"))
        supervisor.set(0.1)
        until(supervisor, lambda: supervisor.status().state == "hold")


def test_a_supervisor_that_was_killed_is_said_loudly(device: EmulatedProcess, tmp_path: Path,
                                                     capfd: pytest.CaptureFixture[str]) -> None:
    with Supervisor.start(plan(device, tmp_path), Confirmation.flag()) as supervisor:
        supervisor.set(0.2)
        until(supervisor, lambda: supervisor.status().state == "hold")
        os.kill(supervisor.pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match="SIGKILL"):
            until(supervisor, lambda: False)
        assert supervisor.status().state == "stopped" and "SIGKILL" in supervisor.status().why
        report = supervisor.stop()
    assert not report.confirmed and "STOP NOT CONFIRMED" in capfd.readouterr().err
    log = DeviceLog(device.truth)
    log.read()
    end_s = time.monotonic() + 5.0
    while log.now() > 0 and time.monotonic() < end_s:
        time.sleep(0.05)
        log.read()
    assert log.now() == 0.0 and log.dead_man_s, "the device's own dead-man did not idle it"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_supervisor_idles_before_it_leaves(device: EmulatedProcess, tmp_path: Path,
                                                           number: signal.Signals) -> None:
    log = DeviceLog(device.truth)
    with Supervisor.start(plan(device, tmp_path), Confirmation.flag()) as supervisor:
        supervisor.set(0.2)
        until(supervisor, lambda: supervisor.status().state == "hold")
        log.read()
        fired = len(log.dead_man_s)
        os.kill(supervisor.pid, number)
        with pytest.raises(DeviceError, match="stopped"):
            until(supervisor, lambda: False)
        report = supervisor.stop()
    log.read()
    assert report.confirmed and log.now() == 0.0
    assert len(log.dead_man_s) == fired, "it was the device's dead-man that idled, not the supervisor"
