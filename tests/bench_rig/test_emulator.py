"""The emulated device through the decoder that a host uses, in simulated time."""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from bench.rig.bench_acoustics import Reflector
from bench.rig.emulator import EmulatedDevice
from bench.rig.faults import DeviceFaults, fault_names, parse_faults
from bench.rig.noise_law import NoiseLaw, parse_shields
from saranga.echo import load_sonar
from saranga.errors import UsageError
from saranga.wire import (
    FLAG_BOOT,
    FLAG_OVERRUN,
    Config,
    Decoder,
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
    Throttle,
    encode,
)

SECOND = 1_000_000


@dataclass
class Quantities:
    thrust_n: float
    rpm: float


class SquarePlant:
    """Thrust follows the square of the throttle at once: what the device makes of a plant is what is tested here."""

    def step(self, dt_s: float, throttle: float) -> Quantities:
        return Quantities(4.0 * throttle**2, 20_000.0 * throttle)


class Host:
    """Sends messages and keeps what comes back."""

    def __init__(self, device: EmulatedDevice) -> None:
        self.device = device
        self.decoder = Decoder()
        self.t_us = 0

    def wait(self, seconds: float) -> list[Message]:
        self.t_us += round(seconds * SECOND)
        return self.decoder.feed(self.device.advance(self.t_us))

    def send(self, *messages: Message) -> list[Message]:
        return self.decoder.feed(self.device.receive(b"".join(map(encode, messages)), self.t_us))


def host(sonar: str = "pair", plant: Any = None, noise: NoiseLaw | None = None, reflector: Reflector | None = None,
         seed: int = 1, shield: str = "none", **faults: Any) -> Host:
    """Switched on, and its first HELLO heard."""
    h = Host(EmulatedDevice(load_sonar(sonar), plant, noise, DeviceFaults(**faults), reflector=reflector, seed=seed,
                            shield=shield))
    h.wait(0.0)
    return h


def echoes(messages: list[Message], sensor: int | None = None) -> list[Echo]:
    return [m for m in messages if isinstance(m, Echo) and sensor in (None, m.sensor)]


def rms(frames: list[Echo], after: int = 40) -> float:
    return math.sqrt(np.mean([np.sum(f.iq[after:].astype(float) ** 2, axis=1).mean() for f in frames]))


def test_switched_on_it_says_hello_and_is_idle() -> None:
    h = Host(EmulatedDevice(load_sonar("pair")))
    first, *more = h.wait(1.5)
    assert isinstance(first, Hello) and first.flags == FLAG_BOOT and not first.has_stand
    assert [(s.role, s.transmits) for s in first.sensors] == [("left", True), ("right", False)]
    assert [type(m) for m in more] == [Status]
    (again,) = h.send(HelloRequest())
    assert isinstance(again, Hello) and again.flags == 0


def test_it_triggers_at_the_rate_it_is_told_and_stops() -> None:
    h = host("triple")
    h.send(Start(rate_hz=75.0))
    frames = echoes(h.wait(2.0))
    assert len(frames) == 450
    assert {f.trigger for f in frames} == set(range(1, 151))
    assert all(len({f.device_time_us for f in frames if f.trigger == t}) == 1 for t in (1, 75, 150))
    h.send(Stop())
    assert echoes(h.wait(1.0)) == []
    assert h.decoder.counters.sequence_gaps == 0


def test_the_device_clock_wraps_and_drifts() -> None:
    device = EmulatedDevice(load_sonar("pair"), faults=DeviceFaults(clock_ppm=1000.0), start_us=2**32 - SECOND)
    h = Host(device)
    h.send(Start(rate_hz=10.0))
    times = [f.device_time_us for f in echoes(h.wait(2.0), 0)]
    steps = np.diff(np.array(times, dtype=np.int64)) % 2**32
    assert min(times) < SECOND < max(times)
    assert steps.tolist() == pytest.approx([100_100] * 19, abs=1)


def test_the_transmitter_rings_and_the_pole_is_where_it_was_put() -> None:
    h = host(reflector=Reflector(0.8, 30.0))
    h.send(Start())
    messages = h.wait(1.0)
    records = [np.mean([f.iq.astype(float) for f in echoes(messages, k)], axis=0) for k in (0, 1)]
    left, right = (np.hypot(*record.T) for record in records)
    assert left[3] > 20_000 and left[25] < 200
    peaks = [40 + int(np.argmax(envelope[40:])) for envelope in (left, right)]
    # Two ways to a pole 0.77 m from its surface, the pulse's 4.4 samples, and nearer to the right sensor.
    assert peaks[0] == pytest.approx(2 * 0.795 / 343.2 * 26_500 + 4.4, abs=2)
    assert 1 <= peaks[0] - peaks[1] <= 6


def test_receive_only_hears_noise_by_thrust_and_shield() -> None:
    law = NoiseLaw(hover_rms_counts=2000.0, hover_thrust_n=1.0, insertion_loss_db={"none": 0.0, "foam": 12.0})
    h = host(plant=SquarePlant(), noise=law)
    found = {}
    h.send(Start(mode=1, rate_hz=50.0))
    for shield in ("none", "foam"):
        h.device.mount(shield)
        h.send(Throttle(value=0.5, token=1, deadline_ms=5000))
        h.wait(0.1)
        found[shield] = rms(echoes(h.wait(4.0)))
    assert found["none"] == pytest.approx(2000.0, rel=0.03)
    assert 20 * math.log10(found["none"] / found["foam"]) == pytest.approx(12.0, abs=0.3)
    h.send(Throttle(value=0.0, token=2, deadline_ms=100))
    h.wait(0.1)
    assert rms(echoes(h.wait(2.0))) == pytest.approx(60.0, rel=0.05)


def test_the_dead_man_idles_exactly_at_its_deadline() -> None:
    h = host(plant=SquarePlant())
    (stand,) = h.send(Throttle(value=0.4, token=7, deadline_ms=200))
    assert isinstance(stand, Stand) and (stand.throttle, stand.token) == (pytest.approx(0.4), 7)
    assert h.wait(0.199) and h.device.throttle.applied == pytest.approx(0.4)
    said = h.wait(0.002)
    assert h.device.throttle.applied == 0.0
    assert [m.text for m in said if isinstance(m, Fault)] == ["throttle deadline passed without a new command: idle"]
    assert [(m.throttle, m.token) for m in said if isinstance(m, Stand)][-1] == (0.0, 0)
    assert h.wait(1.0) and h.device.quantities.thrust_n == 0.0


def test_a_refreshed_throttle_is_held() -> None:
    h = host(plant=SquarePlant())
    for token in range(20):
        h.send(Throttle(value=0.5, token=token, deadline_ms=200))
        h.wait(0.1)
        assert h.device.quantities.thrust_n == pytest.approx(1.0, abs=1e-6)


def test_stand_comes_fifty_times_a_second_with_what_it_measures() -> None:
    h = host(plant=SquarePlant())
    stands = [m for m in h.wait(2.0) if isinstance(m, Stand)]
    assert len(stands) == 100
    assert math.isnan(stands[-1].voltage_v) and stands[-1].thrust_n == 0.0


def test_without_a_stand_a_throttle_is_refused() -> None:
    (fault,) = host().send(Throttle(value=0.1, token=1, deadline_ms=100))
    assert isinstance(fault, Fault) and "THROTTLE" in fault.text


def test_link_test_sends_the_known_sequence_and_shows_a_wrong_bit() -> None:
    good, bad = echoes(host(link_errors="right").send(SelfTest(kind=1)))
    ramp = np.arange(256, dtype=np.int16)
    assert np.array_equal(good.iq, np.stack([ramp, -ramp], axis=1))
    assert np.count_nonzero(bad.iq != good.iq) == 1


def test_configuration_changes_the_records() -> None:
    h = host()
    h.send(Config(odr=4, samples=100), Start())
    assert {f.iq.shape for f in echoes(h.wait(0.1))} == {(100, 2)}
    assert [m.text for m in h.send(Config(sensor=0, odr=4, samples=64)) if isinstance(m, Fault)]


def test_same_seed_same_bytes() -> None:
    def stream(seed: int) -> bytes:
        device = EmulatedDevice(load_sonar("pair"), faults=DeviceFaults(drops=0.1, corrupt=0.1), seed=seed)
        return device.receive(encode(Start()), 0) + device.advance(SECOND)

    assert stream(3) == stream(3) != stream(4)


def test_planted_link_faults_are_seen_by_the_counters() -> None:
    h = host(duplicates=0.1, drops=0.1, corrupt=0.1)
    h.send(Start(rate_hz=100.0))
    h.wait(5.0)
    counters = h.decoder.counters
    assert 50 < counters.duplicates < 150
    assert 120 < counters.sequence_gaps < 280
    assert counters.bad_crc + counters.bad_cobs > 50


def test_repeated_records_have_fresh_numbers() -> None:
    h = host(repeats=0.1)
    h.send(Start(rate_hz=100.0))
    frames = echoes(h.wait(3.0), 0)
    same = sum(np.array_equal(a.iq, b.iq) for a, b in itertools.pairwise(frames))
    assert 15 <= same <= 50 and h.decoder.counters.duplicates == 0


def test_a_reset_forgets_the_start_and_the_throttle() -> None:
    h = host(plant=SquarePlant(), reset_at_s=1.0)
    h.send(Start(), Throttle(value=0.5, token=1, deadline_ms=5000))
    before = h.wait(0.999)
    after = h.wait(1.0)
    assert echoes(before) and not echoes(after)
    assert [m.flags for m in after if isinstance(m, Hello)] == [FLAG_BOOT]
    assert h.device.throttle.applied == 0.0


def test_unplugged_it_lives_on_unheard_and_idles_by_itself() -> None:
    h = host(plant=SquarePlant(), unplug_at_s=1.0, unplug_for_s=2.0)
    h.send(Start(rate_hz=10.0), Throttle(value=0.5, token=1, deadline_ms=1500))
    assert len(echoes(h.wait(0.99), 0)) == 9
    assert h.wait(2.0) == [] and h.device.throttle.applied == 0.0
    # The device did not know: it still triggers, and the numbers show what was missed.
    assert h.wait(1.0)
    assert h.decoder.counters.sequence_gaps > 0


def test_a_hung_device_says_nothing_and_hears_nothing() -> None:
    h = host(hang_at_s=1.0)
    h.send(Start())
    assert h.wait(0.9)
    h.wait(0.2)
    assert h.wait(1.0) == [] and h.send(HelloRequest()) == []


def test_another_protocol_version_is_heard_as_foreign() -> None:
    h = host(protocol=2)
    assert h.wait(1.0) == [] and h.decoder.foreign_version == 2


def test_a_late_owner_costs_cycles_and_they_are_counted() -> None:
    h = Host(EmulatedDevice(load_sonar("pair"), backlog_us=500_000))
    h.send(Start(rate_hz=50.0))
    assert len(echoes(h.wait(0.4), 0)) == 20
    late = echoes(h.wait(2.0), 0)
    assert len(late) <= 2 and late[0].flags == FLAG_OVERRUN and h.device.overruns >= 98
    assert h.decoder.counters.sequence_gaps == 0


def test_shields_differ_from_mounting_to_mounting_by_the_spread_given() -> None:
    law = NoiseLaw(hover_rms_counts=1000.0, insertion_loss_db={"none": 0.0, "foam": 10.0}, mounting_sd_db=0.5)
    device = EmulatedDevice(load_sonar("pair"), SquarePlant(), law)
    device.quantities = Quantities(law.hover_thrust_n, 0.0)
    levels = []
    for _ in range(300):
        device.mount("foam")
        levels.append(20 * math.log10(1000.0 / device.rotor_rms_counts()))
    assert np.mean(levels) == pytest.approx(10.0, abs=0.1) and np.std(levels) == pytest.approx(0.5, rel=0.15)
    with pytest.raises(UsageError, match="shield 'tin'"):
        device.mount("tin")


def test_stand_faults_reach_the_host() -> None:
    h = host(plant=SquarePlant(), nan_stand_at_s=1.0, negative_thrust=True)
    h.send(Throttle(value=0.5, token=1, deadline_ms=5000))
    stands = [m for m in h.wait(2.0) if isinstance(m, Stand)]
    assert stands[20].thrust_n == pytest.approx(-1.0) and math.isnan(stands[-1].thrust_n)


def test_faults_are_parsed_and_wrong_ones_named() -> None:
    faults = parse_faults(["duplicates=0.02", "swapped_sensors", "dead_sensor=left", "firmware=3.1"])
    assert faults.given() == {"swapped_sensors": True, "dead_sensor": "left", "duplicates": 0.02, "firmware": "3.1"}
    assert parse_faults(fault_names()).given().keys() == set(fault_names())
    for text, why in (("swaped_sensors", "did you mean"), ("drops=2", "0..1"), ("dead_sensor=up", "one of"),
                      ("missing_horn=yes", "true or false"), ("hang_at_s=nan", "number")):
        with pytest.raises(UsageError, match=why):
            parse_faults([text])


def test_shields_are_parsed() -> None:
    losses = parse_shields(["tin=7.5", "foam"])
    assert losses["tin"] == 7.5 and losses["none"] == 0.0 and 5.0 < losses["foam"] < 30.0
    for text in ("tin", "tin=much", "tin=99"):
        with pytest.raises(UsageError, match="shield"):
            parse_shields([text])
