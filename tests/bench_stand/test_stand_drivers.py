"""One contract for every driver of a stand or throttle, and each driver's own bytes."""

import math
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import pytest
from golden_frames import FRAMES
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from stand_fakes import FakeBridge, FakeCopter, LineStream, ScriptedLink, StandStream, golden_stand, teensy_link

from bench.thrust_stand.calibration import Calibration, negative_thrust
from bench.thrust_stand.drivers.lines import LineStand
from bench.thrust_stand.drivers.lines import build as build_lines
from bench.thrust_stand.drivers.motortest import MotorTest
from bench.thrust_stand.drivers.rcbenchmark import RCbenchmarkStand
from bench.thrust_stand.drivers.teensy import TeensyStand
from bench.thrust_stand.protocol import StandInfo, StandReading
from bench.thrust_stand.registry import Where, driver_modules, open_stand, open_throttle, parse_url
from saranga.errors import DeviceError, UsageError
from saranga.fixtures import fixture_dir
from saranga.wire import Fault, Hello, Throttle, encode

SWEEP = fixture_dir() / "thrust" / "rcbenchmark-1520" / "g1_11.csv"
FIELDS = {f.name for f in fields(StandReading)}
QUANTITIES = {"teensy", "emulated", "rcbenchmark", "lines", "file"}


@dataclass
class Rigged:
    """A stand and how to pull its cable, without any hardware."""

    stand: Any
    lose: Callable[[], None]
    origin: str = "measured"


@pytest.fixture(params=sorted(QUANTITIES))
def rigged(request: pytest.FixtureRequest) -> Iterator[Rigged]:
    name = request.param
    if name == "teensy":
        link = teensy_link()
        yield Rigged(TeensyStand(link), lambda: setattr(link, "lost", True))
    elif name == "emulated":
        stand = open_stand("emulated:?propeller=g1&seed=4&fault=unplug_at_s=3600")
        device = stand.link.device  # type: ignore[attr-defined]

        def pull() -> None:
            object.__setattr__(device.faults, "unplug_at_s", 0.0)

        yield Rigged(stand, pull, "emulated")
    elif name == "lines":
        link = ScriptedLink("lines+serial:///dev/fake", [], LineStream())
        yield Rigged(lines_stand(link, columns="time:ms,thrust:gf,rpm,voltage"), lambda: setattr(link, "lost", True))
    elif name == "rcbenchmark":
        bridge = FakeBridge()
        try:
            yield Rigged(open_stand(bridge.url), lambda: setattr(bridge, "silent", True))
        finally:
            bridge.close()
    else:
        stand = open_stand(f"file:{SWEEP}?speed=0")

        def play() -> None:
            stand.read(0.0)

        yield Rigged(stand, play, "recorded")


def lines_stand(link: ScriptedLink, **options: Any) -> LineStand:
    stand = build_lines(Where(link.url, "lines", "serial", "/dev/fake"), **options)
    stand._link = link
    return stand


# ---- the contract of a stand ----------------------------------------------------------------------
def test_a_stand_says_what_it_is_and_what_it_measures(rigged: Rigged) -> None:
    info = rigged.stand.open()
    try:
        assert isinstance(info, StandInfo) and info.name and info.firmware
        assert info.origin == rigged.origin
        assert "thrust_n" in info.quantities and info.quantities < FIELDS
        assert info.has_throttle == (info.dead_man_s is not None), "a throttle without dead-man says so elsewhere"
    finally:
        rigged.stand.close()


def test_a_stand_reads_what_it_says_it_measures(rigged: Rigged) -> None:
    info = rigged.stand.open()
    try:
        readings: list[StandReading] = []
        end_s = time.monotonic() + 5.0
        while len(readings) < 5 and time.monotonic() < end_s:
            readings += rigged.stand.read(0.5)
        assert len(readings) >= 5
        for reading in readings:
            assert all(math.isfinite(getattr(reading, name)) for name in info.quantities)
            assert all(math.isnan(getattr(reading, name))
                       for name in FIELDS - info.quantities - {"time_s", "throttle", "token"})
        times = [reading.time_s for reading in readings]
        assert times == sorted(times)
    finally:
        rigged.stand.close()


def test_a_stand_is_tared_to_zero_at_rest(rigged: Rigged) -> None:
    rigged.stand.open()
    try:
        offset_n = rigged.stand.tare()
        assert math.isfinite(offset_n)
        if rigged.origin != "recorded":
            assert abs(offset_n) < 0.05
            rigged.stand.read(0.0)
            again = [r.thrust_n for r in rigged.stand.read(1.0)]
            assert abs(sum(again) / len(again)) < 0.02
    finally:
        rigged.stand.close()


def test_a_stand_that_is_not_open_says_so(rigged: Rigged) -> None:
    with pytest.raises(DeviceError, match="open it first"):
        rigged.stand.read(0.0)
    rigged.stand.open()
    rigged.stand.close()
    rigged.stand.close()
    with pytest.raises(DeviceError, match="open it first"):
        rigged.stand.read(0.0)


def test_a_stand_opens_again_after_it_was_closed(rigged: Rigged) -> None:
    for _ in range(2):
        if isinstance(rigged.stand, TeensyStand) and isinstance(rigged.stand.link, ScriptedLink):
            rigged.stand.link.expected = [(FRAMES["hello_request"], FRAMES["hello"])]
        assert "thrust_n" in rigged.stand.open().quantities
        assert rigged.stand.read(1.0)
        rigged.stand.close()


def test_a_stand_that_goes_away_is_an_error_that_names_it(rigged: Rigged, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.thrust_stand.drivers.rcbenchmark.SILENT_S", 0.2)
    rigged.stand.open()
    try:
        rigged.lose()
        end_s = time.monotonic() + 5.0
        with pytest.raises(DeviceError) as caught:
            while time.monotonic() < end_s:
                rigged.stand.read(0.05)
        assert rigged.stand.url in str(caught.value)
    finally:
        rigged.stand.close()


# ---- the contract of a throttle -------------------------------------------------------------------
@pytest.fixture(params=["teensy", "emulated", "rcbenchmark", "motortest"])
def throttle(request: pytest.FixtureRequest) -> Iterator[Any]:
    if request.param == "teensy":
        # Free of a script: takes anything.
        link = teensy_link()
        link.write = lambda data: link.say(FRAMES["hello"])  # type: ignore[method-assign]
        yield TeensyStand(link)
    elif request.param == "emulated":
        yield open_throttle("emulated:?propeller=g1&seed=4")
    elif request.param == "rcbenchmark":
        bridge = FakeBridge()
        try:
            yield open_throttle(bridge.url)
        finally:
            bridge.close()
    else:
        yield MotorTest(FakeCopter(), 1, 1)


@pytest.mark.parametrize(("value", "token", "deadline_s", "words"), [
    (-0.01, 1, 0.2, r"throttle is -0.01: it must be 0\.\.1"), (1.01, 1, 0.2, r"0\.\.1"), (math.nan, 1, 0.2, "nan"),
    (math.inf, 1, 0.2, "inf"), (0.1, -1, 0.2, "token is -1"), (0.1, 2**32, 0.2, "token"), (0.1, 1, 0.0, "deadline"),
    (0.1, 1, math.nan, "deadline"), (0.1, 1, 3600.0, "at most")])
def test_a_throttle_refuses_what_is_out_of_limits(
        value: float, token: int, deadline_s: float, words: str, throttle: Any) -> None:
    throttle.open()
    try:
        with pytest.raises(UsageError, match=words):
            throttle.command(value, token, deadline_s)
    finally:
        throttle.close()


def test_a_throttle_that_is_not_open_says_so(throttle: Any) -> None:
    with pytest.raises(DeviceError, match="open it first"):
        throttle.command(0.1, 1, 0.2)
    throttle.close()


# ---- Teensy ---------------------------------------------------------------------------------------
def test_teensy_reads_the_golden_stand_frame() -> None:
    stand = TeensyStand(link := teensy_link(stream=lambda: b"", hello=FRAMES["stand"] + FRAMES["hello"]))
    info = stand.open()
    (reading,) = stand.read(0.1)
    golden = golden_stand()
    assert info.firmware == "rig 1.0" and info.dead_man_s == 5.0
    for name in ("thrust_n", "torque_n_m", "rpm", "voltage_v", "current_a", "esc_temperature_c",
                 "motor_temperature_c", "throttle", "token"):
        assert getattr(reading, name) == getattr(golden, name)
    assert math.isnan(reading.vibration_m_s2)
    assert stand.applied() == (0.25, 0xDEADBEEF)
    assert link.expected == []


def test_teensy_sends_the_golden_throttle_frame_and_idles_on_close() -> None:
    idle = encode(Throttle(value=0.0, token=0, deadline_ms=1))
    link = teensy_link([(FRAMES["throttle"], b""), (idle, b"")])
    stand = TeensyStand(link)
    stand.open()
    stand.command(0.5, 0x01000002, 0.25)
    stand.close()
    stand.close()
    assert link.expected == [] and link.closed == 1


def test_teensy_that_never_spun_is_told_nothing_on_close() -> None:
    link = teensy_link()
    stand = TeensyStand(link)
    stand.open()
    stand.close()
    assert link.expected == []


@pytest.mark.parametrize(("hello", "words"), [
    (Hello(firmware="saranga-rig 2.3", sensors=(), has_stand=True), "firmware is 'saranga-rig 2.3'.*flash"),
    (Hello(firmware="saranga-rig 1.3", sensors=()), "has no thrust stand")])
def test_teensy_with_the_wrong_firmware_or_no_stand_is_refused(hello: Hello, words: str) -> None:
    link = teensy_link(hello=encode(hello))
    with pytest.raises(DeviceError, match=words):
        TeensyStand(link).open()
    assert link.closed == 1


def test_teensy_of_another_protocol_says_which() -> None:
    stand = open_stand("emulated:?fault=protocol=2")
    stand._hello_timeout_s = 0.3  # type: ignore[attr-defined]
    with pytest.raises(DeviceError, match="speaks rig protocol v2, this is v1: update its firmware"):
        stand.open()


@pytest.mark.parametrize(("stream", "words"), [
    (lambda: b"", "it is silent"), (lambda: b"hello?\r\n", "bytes and 0 mess")])
def test_a_port_that_is_no_teensy_says_what_came(stream: Any, words: str) -> None:
    link = ScriptedLink("teensy+serial:///dev/fake", [(FRAMES["hello_request"], b"")] * 9, stream)
    with pytest.raises(DeviceError, match=words):
        TeensyStand(link, hello_timeout_s=0.2).open()


def test_a_teensy_that_streams_no_stand_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.thrust_stand.drivers.teensy.FIRST_READING_S", 0.1)
    with pytest.raises(DeviceError, match="no STAND message"):
        TeensyStand(teensy_link(stream=lambda: b"")).open()


def test_a_teensy_that_restarts_or_reports_a_latched_fault_is_an_error() -> None:
    for said, words in ((FRAMES["hello"], "has restarted by itself"),
                        (encode(Fault(code=7, text="overcurrent", latched=True)), r"fault 7 \(overcurrent\)")):
        link = teensy_link()
        stand = TeensyStand(link)
        stand.open()
        link.say(said)
        with pytest.raises(DeviceError, match=words):
            stand.read(0.2)
    link = teensy_link()
    stand = TeensyStand(link)
    stand.open()
    link.say(encode(Fault(code=3, text="deadline passed")))
    assert stand.read(0.2) and stand.faults[0].code == 3


def test_a_load_cell_that_reads_nan_is_not_said_to_measure() -> None:
    stand = TeensyStand(teensy_link(stream=StandStream(math.nan)))
    assert "thrust_n" not in stand.open().quantities
    assert math.isnan(stand.read(0.2)[0].thrust_n)
    with pytest.raises(DeviceError, match="cannot tare: thrust is nan"):
        stand.tare()


def test_an_infinite_reading_is_not_a_number() -> None:
    stand = TeensyStand(teensy_link(stream=StandStream(0.0, current_a=math.inf)))
    stand.open()
    assert math.isnan(stand.read(0.2)[0].current_a)


def test_no_tare_while_the_motor_turns_or_the_stand_shakes() -> None:
    for stream, words in ((StandStream(rpm=3000.0), "motor turns"), (StandStream(throttle=0.1), "motor turns"),
                          (Shaking(), "thrust spreads by")):
        stand = TeensyStand(teensy_link(stream=stream))
        stand.open()
        with pytest.raises(DeviceError, match=f"cannot tare.*{words}"):
            stand.tare()


class Shaking(StandStream):
    def __call__(self) -> bytes:
        self.fields["thrust_n"] = 1.0 if self.sequence % 2 else -1.0
        return super().__call__()


def test_emulated_hardware_behind_a_port_is_never_called_measured() -> None:
    hello = Hello(firmware="saranga-rig 1.0 emulated", sensors=(), has_stand=True)
    stand = TeensyStand(teensy_link(hello=encode(hello)))
    assert stand.open().origin == "emulated"


def test_a_device_without_throttle_output_cannot_be_commanded() -> None:
    stand = TeensyStand(teensy_link(hello=encode(Hello(firmware="x", sensors=(), has_stand=True))))
    assert not stand.open().has_throttle
    with pytest.raises(DeviceError, match="no throttle output"):
        stand.command(0.1, 1, 0.2)


# ---- emulated -------------------------------------------------------------------------------------
def test_the_emulated_stand_pulls_and_idles_by_itself_after_the_deadline() -> None:
    stand: Any = open_stand("emulated:?propeller=g1&seed=4")
    stand.open()
    try:
        end_s = time.monotonic() + 20.0
        last = None
        while time.monotonic() < end_s and (last is None or last.thrust_n < 0.7):
            stand.command(0.4, 7, 0.5)
            last = (stand.read(0.1) or [last])[-1]
        assert last is not None and last.thrust_n > 0.7 and last.token == 7
        assert last.throttle == pytest.approx(0.4) and stand.applied()[1] == 7
        end_s = time.monotonic() + 20.0
        while time.monotonic() < end_s and stand.applied() != (0.0, 0):
            time.sleep(0.02)
        assert stand.applied() == (0.0, 0)
    finally:
        stand.close()


def test_the_emulated_stand_with_a_negative_calibration_is_found_out() -> None:
    stand: Any = open_stand("emulated:?propeller=g1&seed=4&fault=negative_thrust")
    stand.open()
    readings: list[StandReading] = []
    end_s = time.monotonic() + 20.0
    while time.monotonic() < end_s and (not readings or readings[-1].rpm < 6000):
        stand.command(0.4, 7, 0.5)
        readings += stand.read(0.1)
    stand.close()
    wrong = negative_thrust(readings[-3:])
    assert wrong is not None and "calibration is negative" in wrong
    assert negative_thrust([StandReading(time_s=0.0, thrust_n=-0.5, rpm=0.0)]) is None
    assert negative_thrust([StandReading(time_s=0.0, thrust_n=0.5, rpm=9000.0)]) is None


# ---- RCbenchmark ----------------------------------------------------------------------------------
@pytest.fixture
def bridge() -> Iterator[FakeBridge]:
    fake = FakeBridge()
    yield fake
    fake.close()


def test_rcbenchmark_speaks_the_scripts_datagrams_to_the_byte(bridge: FakeBridge) -> None:
    stand: Any = open_stand(bridge.url)
    info = stand.open()
    assert info.name == "RCbenchmark Series 1520" and info.firmware == "1.2, bridge 1" and info.dead_man_s == 2.0
    assert info.quantities == {"thrust_n", "voltage_v", "current_a", "rpm"}
    stand.command(0.15, 7, 0.2)
    end_s = time.monotonic() + 5.0
    while stand.applied() != (0.15, 7) and time.monotonic() < end_s:
        time.sleep(0.01)
    assert stand.applied() == (0.15, 7)
    while stand.applied() != (0.0, 0) and time.monotonic() < end_s:
        time.sleep(0.01)
    stand.tare()
    stand.close()
    end_s = time.monotonic() + 5.0
    while len(bridge.received) < 4 and time.monotonic() < end_s:
        time.sleep(0.01)
    asked = [data for data in bridge.received if data != b'{"do":"hello"}']
    assert asked == [b'{"do":"throttle","us":1150.0,"token":7,"deadline_ms":200}', b'{"do":"tare","id":1}',
                     b'{"do":"throttle","us":1000.0,"token":0,"deadline_ms":1}']


def test_rcbenchmark_thrust_comes_in_newtons_whatever_the_unit(bridge: FakeBridge) -> None:
    for thrust, newtons in (({"value": 100, "unit": "g"}, 0.980665), ({"value": 0.1, "unit": "kgf"}, 0.980665),
                            ({"value": 1.5, "unit": "N"}, 1.5)):
        bridge.thrust = thrust
        stand = open_stand(bridge.url)
        stand.open()
        assert stand.read(1.0)[-1].thrust_n == pytest.approx(newtons)
        stand.close()


def test_rcbenchmark_in_an_unknown_unit_or_with_a_complaint_is_an_error(bridge: FakeBridge) -> None:
    stand = open_stand(bridge.url)
    stand.open()
    bridge.send({"error": "throttle: out of limits"})
    with pytest.raises(DeviceError, match="the script says 'throttle: out of limits'"):
        read_on(stand)
    bridge.thrust = {"value": 1, "unit": "stone"}
    with pytest.raises(DeviceError, match="thrust comes in 'stone'"):
        read_on(stand)
    stand.close()


def read_on(stand: Any) -> None:
    end_s = time.monotonic() + 5.0
    while time.monotonic() < end_s:
        stand.read(0.1)


def test_rcbenchmark_counts_rubbish_and_ignores_what_overtook(bridge: FakeBridge) -> None:
    stand: Any = open_stand(bridge.url)
    stand.open()
    assert isinstance(stand, RCbenchmarkStand)
    while stand._count < 5:
        stand.read(0.1)
    before = stand.bad_datagrams
    for rubbish in (b"\xff\xfe", b"[]", b'{"saranga":2}', b'{"saranga":1,"n":"x"}'):
        bridge.socket.sendto(rubbish, ("127.0.0.1", bridge.listen))
    bridge.send({"n": 2, "us": 2000, "token": 99, "sensors": {"thrust": {"value": 9999, "unit": "N"}}})
    end_s = time.monotonic() + 5.0
    while stand.bad_datagrams < before + 4 and time.monotonic() < end_s:
        assert all(reading.token != 99 for reading in stand.read(0.1))
    assert stand.bad_datagrams == before + 4
    stand.close()


def test_rcbenchmark_says_what_is_missing(bridge: FakeBridge, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.thrust_stand.drivers.rcbenchmark.HELLO_TIMEOUT_S", 0.4)
    bridge.hello["bridge"] = 9
    with pytest.raises(DeviceError, match="the script is bridge 9, this driver knows 1"):
        open_stand(bridge.url).open()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", bridge.listen))
        with pytest.raises(DeviceError, match=f"cannot listen on 127.0.0.1:{bridge.listen}.*BENCH_PORT"):
            open_stand(bridge.url).open()
    bridge.silent = True
    bridge.hello["bridge"] = 1
    with pytest.raises(DeviceError, match="sends no readings"):
        open_stand(bridge.url).open()
    with pytest.raises(DeviceError, match=r"no answer from 127\.0\.0\.1:9 .*rcbenchmark_bridge\.js"):
        open_stand(f"rcbenchmark+udp://127.0.0.1:9?listen={bridge.listen}").open()


def test_the_bridge_script_names_the_same_fields_as_the_driver() -> None:
    text = (Path(__file__).parents[2] / "bench" / "thrust_stand" / "rcbenchmark_bridge.js").read_text()
    for word in ("bridge: 1", "longest_ms", "idle_us", "full_us", "deadline_ms", "workingValue", "workingUnit",
                 "rcb.udp.init(RECEIVE_PORT, BENCH_IP, BENCH_PORT", "rcb.udp.onReceive", "tareLoadCells",
                 "clearTimeout(dead_man)"):
        assert word in text
    assert "RECEIVE_PORT = 55047" in text and "BENCH_PORT = 64126" in text


# ---- lines ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("options", "line", "thrust_n", "rpm"), [
    ({"columns": "time:ms,thrust:gf,rpm"}, "17,100,6000", 0.980665, 6000.0),
    ({"columns": "thrust:kgf,-,rpm:rad/s", "separator": ";"}, "0.1;anything;104.7197551", 0.980665, 1000.0),
    ({"columns": "thrust:mN,rpm", "separator": "space"}, "1500   12000", 1.5, 12000.0),
    ({"columns": "thrust,rpm", "separator": "tab"}, "1.5\t12000\t", 1.5, 12000.0),
    ({"columns": "thrust,rpm", "thrust_sign": -1, "thrust_scale": 2.0}, "-1.5, 12000", 3.0, 12000.0),
    ({"columns": "thrust,rpm"}, "1.5,nan", 1.5, math.nan),
    ({"regex": r"T=(?P<thrust>\S+) .*n=(?P<rpm>\d+)", "units": "thrust:gf"}, "ok T=100 x n=6000 end", 0.980665, 6000.0),
])
def test_lines_of_many_forms(options: dict[str, Any], line: str, thrust_n: float, rpm: float) -> None:
    link = ScriptedLink("lines+serial:///dev/fake", [], lambda: f"{line}\r\n".encode())
    stand = lines_stand(link, **options)
    stand.open()
    reading = stand.read(0.2)[0]
    assert reading.thrust_n == pytest.approx(thrust_n)
    assert reading.rpm == pytest.approx(rpm, nan_ok=True)
    stand.close()


def test_the_url_of_a_line_stand_carries_a_regular_expression() -> None:
    where, options = parse_url("lines+serial:///dev/ttyUSB0?baud=57600&regex=T=(?P<thrust>[-+0-9.]+)&units=thrust:gf")
    assert where.path == "/dev/ttyUSB0"
    assert options == {"baud": 57600, "regex": "T=(?P<thrust>[-+0-9.]+)", "units": "thrust:gf"}


@pytest.mark.parametrize(("options", "words"), [
    ({}, "either columns=... or regex"), ({"columns": "thrust", "regex": "x"}, "either columns"),
    ({"columns": "time,rpm"}, "no column of thrust"), ({"columns": "thrust,lift"}, "column 'lift' is not known"),
    ({"columns": "thrust,thrust"}, "'thrust' is there twice"), ({"columns": "thrust:V"}, "no unit of force"),
    ({"regex": "(?P<thrust>"}, "regex"), ({"regex": "(?P<thrust>.)", "units": "rpm:Hz"}, "no group"),
    ({"columns": "thrust", "thrust_scale": -1.0}, "thrust_scale is -1.0"),
    ({"columns": "thrust", "baud": 1}, "baud is 1")])
def test_a_line_stand_that_is_not_described_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        build_lines(Where("u", "lines", "serial", "/dev/fake"), **options)


def test_lines_that_make_no_sense_are_an_error_that_shows_one() -> None:
    link = ScriptedLink("lines+serial:///dev/fake", [], lambda: b"garbage\n")
    with pytest.raises(DeviceError, match="20 lines in a row are not readable, the last is 'garbage'"):
        lines_stand(link, columns="thrust,rpm").open()
    link = ScriptedLink("lines+serial:///dev/fake", [], lambda: b"\xf0" * 500)
    with pytest.raises(DeviceError, match="without an end of line: is the baud rate right"):
        lines_stand(link, columns="thrust,rpm").open()


def test_a_bad_line_among_good_ones_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.thrust_stand.drivers.lines.FIRST_LINE_S", 0.2)
    link = ScriptedLink("lines+serial:///dev/fake", [], lambda: b"1.0,100\n1.0,1e\n1.0\n")
    stand = lines_stand(link, columns="thrust,rpm")
    stand.open()
    stand.read(0.1)
    assert stand.bad_lines >= 2
    link = ScriptedLink("lines+serial:///dev/fake", [], lambda: b"")
    with pytest.raises(DeviceError, match="no line in"):
        lines_stand(link, columns="thrust,rpm").open()


# ---- file -----------------------------------------------------------------------------------------
def test_a_recording_plays_all_its_rows_and_then_ends() -> None:
    stand = open_stand(f"file:{SWEEP}?speed=0")
    stand.open()
    readings = stand.read(0.0)
    assert len(readings) == 11
    assert readings[0].throttle == pytest.approx(0.05) and readings[-1].throttle == 1.0
    assert readings[-1].thrust_n == pytest.approx(339.6867 * 9.80665e-3, rel=1e-5)
    with pytest.raises(DeviceError, match="ended after 11 rows"):
        stand.read(0.0)


def test_a_recording_keeps_the_pace_of_its_clock() -> None:
    stand = open_stand(f"file:{SWEEP}?speed=100")
    stand.open()
    began_s = time.monotonic()
    readings = []
    while len(readings) < 11:
        readings += stand.read(1.0)
    assert time.monotonic() - began_s >= readings[-1].time_s / 100.0 - 0.001


# ---- motor test -----------------------------------------------------------------------------------
def test_a_motor_test_is_one_command_long_to_the_byte() -> None:
    copter = FakeCopter()
    throttle = MotorTest(copter, 2, 1)
    throttle.open()
    throttle.command(0.25, 3, 0.4)
    throttle.close()
    throttle.close()
    # MAVLink 2: COMMAND_LONG (76) from 255/190 to 1/1, MAV_CMD 209; 2, percent, 25, 0.4 s, 1 motor, default order
    head, body = copter.frames[0][:10], copter.frames[0][10:-2]
    assert head[0] == 0xFD and head[5:7] == bytes([255, 190]) and head[7:10] == (76).to_bytes(3, "little")
    assert body == bytes.fromhex("00000040" "00000000" "0000c841" "cdcccc3e" "0000803f" "00000000" "00000000"
                                 "d100" "01" "01")
    assert [t.param3 for t in copter.tests] == [25.0, 0.0] and copter.tests[1].param4 == 0.0
    assert copter.closed == 1


def test_a_motor_test_never_lasts_more_than_a_second_and_is_not_read_back() -> None:
    throttle = MotorTest(FakeCopter(), 1, 1)
    throttle.open()
    throttle.command(0.1, 1, 1.0)
    with pytest.raises(UsageError, match="at most 1 s"):
        throttle.command(0.1, 1, 1.01)
    assert throttle.readback is False and throttle.applied() is None
    throttle.close()


def test_a_motor_test_that_never_spun_says_nothing_on_close() -> None:
    copter = FakeCopter()
    throttle = MotorTest(copter, 1, 1)
    throttle.open()
    throttle.command(0.0, 1, 0.5)
    throttle.close()
    assert len(copter.tests) == 1 and copter.tests[0].param3 == 0.0


@pytest.mark.parametrize(("copter", "words"), [
    (FakeCopter(armed=True), "the vehicle is armed"),
    (FakeCopter(vehicle=mavlink.MAV_TYPE_FIXED_WING), "no ArduPilot multirotor")])
def test_a_vehicle_that_is_armed_or_no_multirotor_is_refused(copter: FakeCopter, words: str) -> None:
    with pytest.raises(DeviceError, match=words):
        MotorTest(copter, 1, 1).open()
    assert copter.tests == [] and copter.closed == 1


def test_a_refused_motor_test_is_an_error_with_the_vehicles_reason() -> None:
    throttle = MotorTest(FakeCopter(mavlink.MAV_RESULT_FAILED, text="Motor Test: Safety switch"), 1, 1)
    throttle.open()
    throttle.command(0.1, 1, 0.5)
    with pytest.raises(DeviceError, match=r"refuses the motor test \(failed: Motor Test: Safety switch\)"):
        throttle.command(0.1, 2, 0.5)
    throttle.close()


def test_a_vehicle_that_is_lost_or_silent_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    copter = FakeCopter()
    throttle = MotorTest(copter, 1, 1)
    throttle.open()
    copter.lost = True
    with pytest.raises(DeviceError, match="unplugged"):
        throttle.command(0.1, 1, 0.5)
    throttle.close()
    monkeypatch.setattr("bench.thrust_stand.drivers.motortest.VEHICLE_SILENT_S", 0.05)
    monkeypatch.setattr("bench.thrust_stand.drivers.motortest.HEARTBEAT_TIMEOUT_S", 0.2)
    copter = FakeCopter()
    throttle = MotorTest(copter, 1, 1)
    throttle.open()
    copter.silent = True
    time.sleep(0.1)
    with pytest.raises(DeviceError, match="no word from the vehicle"):
        throttle.command(0.1, 1, 0.5)
    throttle.close()
    with pytest.raises(DeviceError, match="no heartbeat of system 1"):
        MotorTest(copter, 1, 1).open()


# ---- URLs -----------------------------------------------------------------------------------------
def test_drivers_are_found_by_name_and_say_what_they_do() -> None:
    found = driver_modules()
    assert set(found) == {"emulated", "file", "lines", "motortest", "rcbenchmark", "teensy"}
    spinning = {name for name, module in found.items() if module.SPINS}
    assert spinning == {"emulated", "motortest", "rcbenchmark", "teensy"}
    assert {name for name, module in found.items() if not module.MEASURES} == {"motortest"}
    for name, module in found.items():
        assert module.FORMS.startswith(name)


@pytest.mark.parametrize(("url", "words"), [
    ("teensi+serial:///dev/x", "did you mean 'teensy'"), ("/dev/ttyACM0", "no driver before a colon"),
    ("teensy+serial://ttyACM0", "not understood"), ("teensy+tcp://host", "not understood"),
    ("teensy+tcp://host:99999", "Port out of range"), ("teensy:", "not understood"),
    ("teensy+udp://h:1", "not understood"), ("rcbenchmark+tcp://h:1", "not understood"),
    ("rcbenchmark+udp://h:1?listen=0", r"it must be a port, 1\.\.65535"), ("emulated:?sneed=1", "did you mean 'seed'"),
    ("emulated:?seed=x", "whole number"), ("emulated:?propeller=nope", "known are a1"),
    ("emulated:g1", "not understood"),
    ("emulated:?seed=1&seed=2", "given twice"), ("emulated:?seed", "stand URL"), ("file:", "not understood"),
    ("file:no.csv", "cannot be read"), ("teensy+tcp://h:1?thrust_scale=0", "must be above 0"),
    ("teensy+tcp://h:1?thrust_sign=2", "1 or -1"), ("teensy+tcp://h:1?thrust_scale=nan", "must be above 0"),
    ("motortest+serial:///dev/x", "only spins")])
def test_a_malformed_stand_url_is_refused(url: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        open_stand(url)


@pytest.mark.parametrize(("url", "words"), [
    (f"file:{SWEEP}", "only measures"), ("lines+serial:///dev/x?columns=thrust", "only measures"),
    ("motortest+serial:///dev/x?motor=13", r"1\.\.12"), ("motortest+serial:///dev/x?system=0", r"1\.\.255")])
def test_a_malformed_throttle_url_is_refused(url: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        open_throttle(url)


def test_the_plain_urls_of_a_rig_are_those_of_its_stand() -> None:
    where, _ = parse_url("serial:///dev/ttyACM0")
    assert (where.driver, where.transport, where.path) == ("teensy", "serial", "/dev/ttyACM0")
    where, _ = parse_url("tcp://127.0.0.1:5555")
    assert (where.driver, where.transport, where.host, where.port) == ("teensy", "tcp", "127.0.0.1", 5555)


def test_a_port_that_is_absent_or_busy_is_an_error_that_names_it() -> None:
    with pytest.raises(DeviceError, match=r"/dev/nothing: cannot be opened.*plugged in"):
        open_stand("teensy+serial:///dev/nothing").open()
    with pytest.raises(DeviceError, match=r"cannot connect"):
        open_stand("teensy+tcp://127.0.0.1:9").open()
    import os
    import tty

    import serial
    master, slave = os.openpty()
    tty.setraw(slave)
    with serial.Serial(os.ttyname(slave), exclusive=True), \
            pytest.raises(DeviceError, match="the port free"):
        open_stand(f"lines+serial://{os.ttyname(slave)}?columns=thrust").open()
    os.close(master)
    os.close(slave)


def test_calibration_turns_and_scales_and_never_passes_what_is_not_finite() -> None:
    calibration = Calibration(2.0, -1)
    assert calibration(-1.5) == 3.0
    assert math.isnan(calibration(math.inf)) and math.isnan(calibration(math.nan))
    for scale in (0, -1, math.nan, math.inf, "x"):
        with pytest.raises(ValueError, match="thrust_scale is"):
            Calibration(scale)  # type: ignore[arg-type]


