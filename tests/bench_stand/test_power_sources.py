"""Power sources: the same contract for all, against counters and instruments that are not there (fakes)."""

import importlib
import threading
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from bench.power import energy_per_call, load_power_source, power_source_names
from bench.power.csv_log import CsvSource, read_power_log
from bench.power.ina228 import COUNTS, ENERGY_LSB_PER_A
from saranga.errors import DeviceError, UsageError

WATTS = 2.0


class FakeRapl:
    """Counters of one package at 2 W, whatever the time between two readings: they follow the clock."""

    def __init__(self, root: Path) -> None:
        self.zone = root / "intel-rapl:0"
        self.zone.mkdir(parents=True)
        (self.zone / "max_energy_range_uj").write_text("262143328850")
        self.set(0)

    def set(self, microjoules: int) -> None:
        (self.zone / "energy_uj").write_text(str(microjoules))


class FakeJoulescope:
    """The driver package: a thread that publishes statistics of 2 W, as pyjoulescope_driver does."""

    paths = ("u/js220/000415",)
    silent = False

    def __init__(self) -> None:
        self.published: list[tuple[str, Any]] = []
        self.stop = threading.Event()
        self.finalized = False

    def device_paths(self) -> list[str]:
        return list(self.paths)

    def open(self, path: str) -> None:
        self.opened = path

    def publish(self, topic: str, value: Any) -> None:
        self.published.append((topic, value))

    def subscribe(self, topic: str, flags: str, call: Any) -> None:
        assert (topic, flags) == (f"{self.opened}/s/stats/value", "pub")

        def run() -> None:
            began = time.monotonic()
            while not self.stop.wait(0.02):
                if not self.silent:
                    call(topic, {"accumulators": {"energy": {"value": WATTS * (time.monotonic() - began)}}})

        self.thread = threading.Thread(target=run)
        self.thread.start()

    def close(self, path: str) -> None:
        self.stop.set()

    def finalize(self) -> None:
        self.stop.set()
        self.finalized = True


class FakeIna228:
    """The chip at 2 W from when its accumulators were reset."""

    def __init__(self, bus: Any, address: int) -> None:
        if address != 0x40:
            raise ValueError(f"No I2C device at address: 0x{address:x}")
        self.bus_voltage = 5.02

    def set_calibration(self, shunt: float, most_a: float) -> None:
        self.calibration = (shunt, most_a)

    def reset_accumulators(self) -> None:
        self.began = time.monotonic()

    @property
    def energy(self) -> float:
        return WATTS * (time.monotonic() - self.began)


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What importlib gives: the fakes that a test puts here, else the real thing (which is absent)."""
    there: dict[str, Any] = {}
    real = importlib.import_module

    def fake(name: str, package: str | None = None) -> ModuleType:
        if name in ("pyjoulescope_driver", "adafruit_ina228", "board"):
            if name not in there:
                raise ModuleNotFoundError(f"No module named {name!r}")
            return there[name]
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", fake)
    return there


def log_at_two_watts(path: Path, seconds: float = 60.0) -> Path:
    began = time.time() - 1.0
    rows = [f"{began + 0.1 * k:.3f},{WATTS}" for k in range(round(seconds * 10))]
    path.write_text("\n".join(["time_s,power_w", *rows]) + "\n")
    return path


def opened(name: str, packages: dict[str, Any], tmp_path: Path) -> Any:
    if name == "rapl":
        fake = FakeRapl(tmp_path / "powercap")
        source = load_power_source(f"rapl:{tmp_path / 'powercap'}")
        real_mark = source.mark

        def mark() -> Any:
            fake.set(round(time.monotonic() * WATTS * 1e6) % 262143328850)
            return real_mark()

        source.mark = mark  # type: ignore[method-assign]
    elif name == "csv":
        source = load_power_source(f"csv:{log_at_two_watts(tmp_path / 'power.csv')}")
    else:
        packages["pyjoulescope_driver"] = SimpleNamespace(Driver=FakeJoulescope)
        packages["adafruit_ina228"] = SimpleNamespace(INA228=FakeIna228)
        packages["board"] = SimpleNamespace(I2C=object)
        source = load_power_source(name)
    assert source.open()
    return source


def test_all_four_sources_are_found_by_name() -> None:
    assert power_source_names() == ["csv", "ina228", "joulescope", "rapl"]


@pytest.mark.parametrize("name", ["csv", "ina228", "joulescope", "rapl"])
def test_a_source_gives_the_energy_of_an_interval(name: str, packages: dict[str, Any], tmp_path: Path) -> None:
    source = opened(name, packages, tmp_path)
    try:
        start = source.mark()
        time.sleep(0.2)
        end = source.mark()
        energy = source.between(start, end)
        assert energy.seconds > 0.15
        assert energy.mean_w == pytest.approx(WATTS, rel=0.05)
        assert source.name == name and source.origin in ("measured", "recorded")
        with pytest.raises(DeviceError, match=r"longer|is none"):
            source.between(end, end)
    finally:
        source.close()
        source.close()


@pytest.mark.parametrize("name", ["ina228", "joulescope", "rapl"])
def test_a_source_that_is_not_open_says_so(name: str) -> None:
    with pytest.raises(DeviceError, match="open it first"):
        load_power_source(name).mark()


@pytest.mark.parametrize(("name", "package"), [
    ("joulescope", "pip install pyjoulescope_driver"), ("ina228", "pip install adafruit-circuitpython-ina228")])
def test_an_absent_package_is_named_only_when_the_source_is_opened(
        name: str, package: str, packages: dict[str, Any]) -> None:
    source = load_power_source(name)
    with pytest.raises(DeviceError, match=package):
        source.open()


def test_the_joulescope_is_set_up_as_its_own_tool_does(packages: dict[str, Any]) -> None:
    packages["pyjoulescope_driver"] = SimpleNamespace(Driver=FakeJoulescope)
    source = load_power_source("joulescope:000415")
    source.open()
    driver = source._driver  # type: ignore[attr-defined]
    assert driver.published == [("u/js220/000415/s/i/range/mode", "auto"), ("u/js220/000415/s/stats/scnt", 100_000),
                                ("u/js220/000415/s/stats/ctrl", 1)]
    source.close()
    assert driver.finalized


@pytest.mark.parametrize(("paths", "wanted", "words"), [
    ((), "", "there: none"), (("u/js220/1", "u/js220/2"), "", "several"), (("u/js220/1",), ":7", "no 7 on USB"),
    (("u/jx1/1",), "", "neither a JS220 nor a JS110")])
def test_a_joulescope_that_is_not_there_or_not_clear_is_an_error(
        paths: tuple[str, ...], wanted: str, words: str, packages: dict[str, Any]) -> None:
    packages["pyjoulescope_driver"] = SimpleNamespace(Driver=type("D", (FakeJoulescope,), {"paths": paths}))
    with pytest.raises(DeviceError, match=words):
        load_power_source(f"joulescope{wanted}").open()


def test_a_joulescope_that_falls_silent_is_an_error(
        packages: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    packages["pyjoulescope_driver"] = SimpleNamespace(Driver=type("D", (FakeJoulescope,), {"silent": True}))
    monkeypatch.setattr("bench.power.joulescope.ANSWER_S", 0.1)
    source = load_power_source("joulescope")
    source.open()
    with pytest.raises(DeviceError, match="unplugged"):
        source.mark()
    source.close()


def test_the_ina228_counter_is_followed_over_its_end(packages: dict[str, Any]) -> None:
    packages["adafruit_ina228"] = SimpleNamespace(INA228=FakeIna228)
    packages["board"] = SimpleNamespace(I2C=object)
    source = load_power_source("ina228:0x40?max_a=2")
    source.open()
    whole = COUNTS * ENERGY_LSB_PER_A * 2.0
    reads = iter([whole - 1.0, 2.0])
    source._sensor = type("Chip", (), {"energy": property(lambda _: next(reads))})()  # type: ignore[attr-defined]
    start = source.mark()
    time.sleep(0.001)
    assert source.between(start, source.mark()).joules == pytest.approx(3.0, rel=1e-6)


def test_an_ina228_that_is_not_there_is_an_error(packages: dict[str, Any]) -> None:
    packages["adafruit_ina228"] = SimpleNamespace(INA228=FakeIna228)
    packages["board"] = SimpleNamespace(I2C=object)
    with pytest.raises(DeviceError, match=r"0x41.*check wiring"):
        load_power_source("ina228:0x41").open()


def test_rapl_without_counters_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="no energy counters"):
        load_power_source(f"rapl:{tmp_path}").open()


def test_energy_of_one_call_is_over_idle_and_idle_is_measured_before_and_after() -> None:
    now = [0.0]

    class Meter:
        name, origin = "fake", "recorded"
        joules = 0.0
        power_w = 1.0

        def mark(self) -> Any:
            from bench.power import Mark

            return Mark(now[0], self.joules)

        def spend(self, seconds: float, power_w: float) -> None:
            now[0] += seconds
            self.joules += seconds * power_w

        def between(self, start: Any, end: Any) -> Any:
            from bench.power import difference

            return difference("fake", start, end)

    meter = Meter()
    got = energy_per_call(lambda: meter.spend(0.01457, 1.73), meter, 100, 1.0,  # type: ignore[arg-type]
                          sleep=lambda s: meter.spend(s, 1.0))
    # the paper's figures: 0.73 W over idle for 14.57 ms is 10.6 mJ
    assert got.net_j == pytest.approx(0.73 * 0.01457)
    assert got.gross_j == pytest.approx(1.73 * 0.01457)
    assert (got.idle_before_w, got.idle_after_w, got.active_w) == pytest.approx((1.0, 1.0, 1.73))
    with pytest.raises(UsageError, match="at least 100"):
        energy_per_call(lambda: None, meter, 99)  # type: ignore[arg-type]


def test_a_power_log_is_integrated_by_straight_lines(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("Time (ms);Voltage (V);Current (mA)\n0;5,0;100\n1000;5,0;300\n2000;5,0;300\n")
    source = load_power_source(f"csv:{path}?clock=file")
    assert isinstance(source, CsvSource)
    assert source.between(source.mark_at(0.5), source.mark_at(1.5)).joules == pytest.approx(
        0.5 * (1.0 + 1.5) * 0.5 + 1.5 * 0.5)
    with pytest.raises(DeviceError, match="mark_at"):
        source.mark()
    with pytest.raises(DeviceError, match=r"covers 0\.000 \.\. 2\.000 s"):
        source.between(source.mark_at(1.0), source.mark_at(2.5))


@pytest.mark.parametrize(("text", "words"), [
    ("time_s,power_w\n0,1\n", "1 rows"),
    ("time_s,volts\n0,1\n1,1\n", "needs columns of time and power"),
    ("time_s,power_w\n0,1\n1,nan\n", r"p\.csv:3: column 'power_w' is 'nan'"),
    ("time_s,power_w\n1,1\n1,2\n", r"p\.csv:3: time does not go on"),
    ("Time (furlong),Power (W)\n1,1\n2,2\n", "no unit of time"),
    ("", "is empty"),
])
def test_a_faulty_power_log_names_its_fault(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        read_power_log(path)


def test_a_gap_in_a_power_log_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("time_s,power_w\n0,1\n0.5,1\n4,1\n5,1\n")
    source = load_power_source(f"csv:{path}?clock=file")
    with pytest.raises(DeviceError, match=r"nothing was logged for 3\.50 s"):
        source.between(source.mark_at(0.2), source.mark_at(4.5))  # type: ignore[attr-defined]


@pytest.mark.parametrize(("text", "words"), [
    ("rapel", "did you mean 'rapl'"), ("csv", "give the log"), ("csv:x?clock=utc", "epoch or file"),
    ("ina228:0x90", "0x40..0x4f"), ("ina228:0x40?shunt=1", "no option 'shunt'"), ("csv:x?longest_gap_s=-1", "above 0"),
])
def test_a_source_that_is_misspelt_is_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        load_power_source(text)
