"""Joulescope JS220 (and JS110) through its own driver package, `pyjoulescope_driver`, by its energy accumulator."""

import contextlib
import importlib
import queue
import time
from typing import Any, Literal

from bench.power import Energy, Mark, difference
from saranga.errors import DeviceError

NAME = "joulescope"
ABOUT = "Joulescope JS220 or JS110 on USB: joulescope[:DEVICE]; needs `pip install pyjoulescope_driver`"
PACKAGE = "pyjoulescope_driver"
RATE_HZ = 10
SAMPLES_A_SECOND = {"js220": 1_000_000, "js110": 2_000_000}
ANSWER_S = 3.0


class Joulescope:
    """PowerSource. A mark is the instrument's next statistic, ten a second, at the time it arrives."""

    name = NAME
    origin: Literal["measured", "recorded"] = "measured"

    def __init__(self, device: str) -> None:
        self._wanted = device
        self._driver: Any = None
        self._path = ""
        self._statistics: queue.SimpleQueue[Mark] = queue.SimpleQueue()

    def open(self) -> str:
        """Raises DeviceError where the package or the instrument is absent, or several are there."""
        try:
            package = importlib.import_module(PACKAGE)
        except ImportError as error:
            raise DeviceError(f"{self.name}: its Python package is absent ({error}): pip install {PACKAGE}") from error
        self._driver = package.Driver()
        try:
            self._path = self._choose()
            self._driver.open(self._path)
            self._start()
        except DeviceError:
            self.close()
            raise
        except Exception as error:  # the package raises RuntimeError and others, undocumented
            self.close()
            raise DeviceError(f"{self.name}: cannot be opened: {error}; is another program using it?") from error
        return f"Joulescope {self._path}"

    def mark(self) -> Mark:
        """The next statistic: those that are waiting are older than now."""
        if self._driver is None:
            raise DeviceError(f"{self.name} is not open: open it first")
        with contextlib.suppress(queue.Empty):
            while True:
                self._statistics.get_nowait()
        try:
            return self._statistics.get(timeout=ANSWER_S)
        except queue.Empty:
            raise DeviceError(f"{self.name}: {self._path} has said nothing for {ANSWER_S:g} s: was it "
                              "unplugged?") from None

    def between(self, start: Mark, end: Mark) -> Energy:
        return difference(self.name, start, end)

    def close(self) -> None:
        driver, self._driver = self._driver, None
        if driver is not None:
            with contextlib.suppress(Exception):  # it may be gone
                driver.close(self._path)
            driver.finalize()

    def _choose(self) -> str:
        paths = [str(path) for path in self._driver.device_paths()]
        fitting = [path for path in paths if self._wanted.lower() in path.lower()]
        if len(fitting) == 1:
            return fitting[0]
        there = ", ".join(paths) or "none"
        if not fitting:
            raise DeviceError(f"{self.name}: no {self._wanted or 'instrument'} on USB (there: {there}): plug it in")
        raise DeviceError(f"{self.name}: several instruments ({there}): name one with joulescope:SERIAL")

    def _start(self) -> None:
        kind = next((kind for kind in SAMPLES_A_SECOND if kind in self._path.lower()), None)
        if kind is None:
            raise DeviceError(f"{self.name}: {self._path} is neither a JS220 nor a JS110")
        path, driver = self._path, self._driver
        if kind == "js110":
            driver.publish(f"{path}/s/i/range/select", "auto")
            for signal in "ivp":
                driver.publish(f"{path}/s/{signal}/ctrl", "on")
        else:
            driver.publish(f"{path}/s/i/range/mode", "auto")
        driver.publish(f"{path}/s/stats/scnt", SAMPLES_A_SECOND[kind] // RATE_HZ)
        driver.publish(f"{path}/s/stats/ctrl", "on" if kind == "js110" else 1)
        driver.subscribe(f"{path}/s/stats/value", "pub", self._take)

    def _take(self, topic: str, value: dict[str, Any]) -> None:
        """Called from the driver's thread, within milliseconds of the statistic's end."""
        self._statistics.put(Mark(time.monotonic(), float(value["accumulators"]["energy"]["value"])))


def build(path: str = "") -> Joulescope:
    """`path`: part of the device's path, such as its serial number, where there are several."""
    return Joulescope(path)
