"""The driver against an emulated device behind real ports, in wall time: settings, loss and return, clear refusals."""

import time

import numpy as np
import pytest
from rig_process import served

from bench.rig.driver import Rig, open_rig
from saranga.errors import DeviceError, UsageError
from saranga.recording import read_recording
from saranga.sources import FileSource, rig_link

pytestmark = [pytest.mark.wall_time, pytest.mark.xdist_group("wall_time")]


def listen(rig: Rig, seconds: float) -> list:
    until = time.monotonic() + seconds
    cycles = []
    while time.monotonic() < until:
        cycles += rig.poll(0.1)
    return cycles


def wait_for(rig: Rig, condition, seconds: float = 20.0) -> list:
    until = time.monotonic() + seconds
    cycles = []
    while not condition():
        assert time.monotonic() < until, f"not within {seconds} s: {rig.losses} {rig.counters}"
        cycles += rig.poll(0.1)
    return cycles


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_settings_modes_and_tests_reach_the_device(kind):
    with served(kind=kind) as emulated:
        rig = open_rig(emulated.url)
        assert rig.origin == "emulated"
        assert rig.link_test() == {0: 0.0, 1: 0.0}
        assert [s.self_test for s in rig.self_test().sensors] == ["pass", "pass"]
        rig.configure(5, 100, 0)
        rig.start(0, 50.0)
        cycles = wait_for(rig, lambda: rig.cycle_counters.cycles >= 20)
        cycles += rig.stop()
        assert {f.iq.shape for c in cycles for f in c.frames.values()} == {(100, 2)}
        assert {f.odr for c in cycles for f in c.frames.values()} == {5}
        rig.start(1, 50.0)
        quiet = wait_for(rig, lambda: rig.cycle_counters.cycles >= 40) + rig.stop()
        assert {f.mode for c in quiet for f in c.frames.values()} == {1}
        assert rig.counters.sequence_gaps == rig.counters.bad_crc == 0
        assert rig.losses.unplugged == rig.losses.restarts == 0
        with pytest.raises(UsageError, match="odr"):
            rig.configure(9, 100)
        rig.close()
        rig.close()


def test_temperature_sets_the_speed_of_sound():
    with served() as emulated:
        rig = open_rig(emulated.url, temperature_c=35.0)
        assert rig.temperature_c == 35.0 and rig.sound_speed_m_s == pytest.approx(351.9, abs=0.1)
        rig.start()
        wait_for(rig, lambda: rig.status is not None)
        assert rig.temperature_c == 20.0 and rig.sound_speed_m_s == pytest.approx(343.2, abs=0.1)
        rig.close()


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_pulled_cable_costs_cycles_and_not_the_record(kind, tmp_path):
    path = tmp_path / "echoes.mcap"
    with served("unplug_at_s=1.5", "unplug_for_s=1", kind=kind) as emulated:
        rig = open_rig(emulated.url, record=path, reconnect_s=20.0)
        rig.configure(6, 256, 0)
        rig.start(1, 50.0)
        before = wait_for(rig, lambda: rig.losses.unplugged == 1)
        after = wait_for(rig, lambda: rig.up)
        count = rig.cycle_counters.cycles
        after += wait_for(rig, lambda: rig.cycle_counters.cycles >= count + 20)
        live = len(before) + len(after) + len(rig.stop())
        assert rig.losses.lost_s > 0.5 and rig.counters.sequence_gaps > 40
        rig.close()
    replayed = FileSource(path)
    replayed.open()
    cycles = []
    while not replayed.exhausted:
        cycles += replayed.poll(0.0)
    assert replayed.complete and len(cycles) == live == rig.cycle_counters.cycles
    assert replayed.counters.sequence_gaps == rig.counters.sequence_gaps


def test_a_device_that_starts_again_is_set_up_again():
    with served("reset_at_s=2") as emulated:
        rig = open_rig(emulated.url)
        rig.configure(5, 64, 0)
        rig.start(1, 50.0)
        wait_for(rig, lambda: rig.losses.restarts == 1)
        count = rig.cycle_counters.cycles
        wait_for(rig, lambda: rig.cycle_counters.cycles >= count + 10)
        cycles = listen(rig, 0.2) + rig.stop()
        assert {(f.odr, f.mode, len(f.iq)) for c in cycles for f in c.frames.values()} == {(5, 1, 64)}
        rig.close()


def test_a_rig_that_does_not_come_back_is_given_up_and_the_record_stays(tmp_path):
    path = tmp_path / "echoes.mcap"
    with served("unplug_at_s=1.5") as emulated:
        rig = open_rig(emulated.url, record=path, reconnect_s=0.5)
        rig.start(1, 50.0)
        with pytest.raises(DeviceError, match=r"did not come back in 0\.5 s.*what came is safe in"):
            listen(rig, 30.0)
        rig.close()
    assert sum(1 for _ in read_recording(path).frames()) > 20


def test_a_hung_rig_is_named():
    with served("hang_at_s=1.5") as emulated:
        rig = Rig(rig_link(emulated.url), reconnect_s=0.5, silence_s=0.5)
        rig.open()
        rig.start(1, 50.0)
        with pytest.raises(DeviceError, match="is it hung"):
            listen(rig, 30.0)
        assert rig.losses.silences == 1
        rig.close()


def test_other_firmware_and_other_protocol_are_refused_with_what_to_do():
    with served("firmware=2.0") as emulated, pytest.raises(DeviceError, match=r"2\.0.*major version.*flash"):
        open_rig(emulated.url)
    with served("protocol=2") as emulated:
        rig = Rig(rig_link(emulated.url), hello_timeout_s=1.0)
        with pytest.raises(DeviceError, match="rig protocol v2, this is v1"):
            rig.open()


def test_a_port_in_use_is_named():
    with served() as emulated:
        first = open_rig(emulated.url)
        with pytest.raises(DeviceError, match="the port free"):
            open_rig(emulated.url)
        first.close()
    with pytest.raises(DeviceError, match="cannot be opened"):
        open_rig(emulated.url)


def test_a_recording_is_never_overwritten(tmp_path):
    path = tmp_path / "echoes.mcap"
    path.write_bytes(b"mine")
    with served() as emulated, pytest.raises(UsageError, match="never overwritten"):
        open_rig(emulated.url, record=path)
    assert path.read_bytes() == b"mine"


def test_the_drift_of_the_device_clock_is_found():
    with served("clock_ppm=5000") as emulated:
        rig = open_rig(emulated.url)
        rig.start(1, 50.0)
        assert rig.clock.drift() is None
        wait_for(rig, lambda: rig.cycle_counters.cycles >= 200)
        drift = rig.clock.drift()
        assert drift is not None and drift.low_ppm - 500 < 5000 < drift.high_ppm + 500
        rig.close()


def test_clock_survives_jitter_wrap_and_restart():
    from bench.rig.device_clock import DeviceClock

    clock = DeviceClock()
    rng = np.random.default_rng(1)
    for k in range(1000):
        t = k * 0.02
        clock.add(round(t * 1e6 * (1 + 300e-6)) + 123_456, 1000.0 + t + rng.exponential(0.003))
    drift = clock.drift()
    assert drift is not None and drift.ppm == pytest.approx(300, abs=60)
    clock.restart()
    for k in range(50):
        clock.add(k * 20_000, 2000.0 + k * 0.02)
    assert clock.drift() == drift
