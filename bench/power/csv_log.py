"""Power logged by any instrument into a CSV file: time and power, or time, voltage and current, with units.

The log's clock is Unix time, so that marks taken here meet it; with `clock=file` marks are times of the file.
"""

import math
import time
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bench.power import Energy, Mark
from bench.thrust_stand.csv_cells import number, read_text, rows_of, separator_of, uses_decimal_comma
from bench.thrust_stand.formats.rcbenchmark import HEADING
from bench.thrust_stand.units import conversion, known_units
from saranga.errors import DeviceError, UsageError

NAME = "csv"
ABOUT = "a log with time and power (or voltage and current): csv:power.csv?clock=epoch|file"
LONGEST_GAP_S = 1.0
COLUMNS = {"time": ("time", "s"), "timestamp": ("time", "s"), "power": ("power", "W"), "voltage": ("voltage", "V"),
           "current": ("current", "A"), "time_s": ("time", "s"), "power_w": ("power", "W"),
           "voltage_v": ("voltage", "V"), "current_a": ("current", "A")}
Array = NDArray[np.float64]


class CsvSource:
    """PowerSource that reads its log when an interval is asked for, as the log is then complete."""

    name = NAME
    origin: Literal["measured", "recorded"] = "recorded"

    def __init__(self, path: Path, epoch: bool, longest_gap_s: float) -> None:
        self.path = path
        self._epoch = epoch
        self._longest_gap_s = longest_gap_s

    def open(self) -> str:
        """Raises UsageError where the file is no such log."""
        times, power = read_power_log(self.path)
        return f"{self.path}: {len(times)} rows over {times[-1] - times[0]:g} s, {power.mean():.3f} W in the mean"

    def mark(self) -> Mark:
        """Now, in Unix time."""
        if not self._epoch:
            raise DeviceError(f"{self.path}: its clock is its own: give marks with mark_at, or log Unix time")
        return Mark(time.time())

    def mark_at(self, time_s: float) -> Mark:
        """A time of the log."""
        return Mark(time_s)

    def between(self, start: Mark, end: Mark) -> Energy:
        """Integral of the power, straight lines between rows.

        Raises:
            DeviceError: the log does not cover the interval, or has a gap in it.
        """
        times, power = self._log_up_to(end.time_s)
        if not end.time_s > start.time_s:
            raise DeviceError(f"{self.path}: an interval from {start.time_s:g} to {end.time_s:g} s is none")
        if start.time_s < times[0] or end.time_s > times[-1]:
            raise DeviceError(f"{self.path}: covers {times[0]:.3f} .. {times[-1]:.3f} s, not {start.time_s:.3f} .. "
                              f"{end.time_s:.3f} s: was the log running, and is its clock Unix time?")
        inside = times[(times > start.time_s) & (times < end.time_s)]
        at = np.concatenate([[start.time_s], inside, [end.time_s]])
        around = times[np.searchsorted(times, start.time_s, "right") - 1:np.searchsorted(times, end.time_s, "left") + 1]
        gap = float(np.diff(around).max())
        if gap > self._longest_gap_s:
            raise DeviceError(f"{self.path}: nothing was logged for {gap:.2f} s inside the interval, at most "
                              f"{self._longest_gap_s:g} s is taken: log faster")
        return Energy(float(np.trapezoid(np.interp(at, times, power), at)), end.time_s - start.time_s)

    def _log_up_to(self, end_s: float) -> tuple[Array, Array]:
        """The log; one that is still being written is given `longest_gap_s` and a second to reach `end_s`."""
        deadline_s = time.monotonic() + self._longest_gap_s + 1.0
        while True:
            times, power = read_power_log(self.path)
            written = self._epoch and 0.0 <= time.time() - times[-1] < self._longest_gap_s + 2.0
            if times[-1] >= end_s or not written or time.monotonic() > deadline_s:
                return times, power
            time.sleep(0.1)

    def close(self) -> None:
        """Nothing is held."""


def read_power_log(path: Path) -> tuple[Array, Array]:
    """Times (rising, s) and power (W) of a log.

    Raises:
        UsageError: no such columns, or a fault: file, line, column and value are named.
    """
    text = read_text(path)
    first = next(line for line in text.splitlines() if line.strip())
    separator = separator_of(first)
    header, *body = rows_of(path, text, separator)
    decimal_comma = uses_decimal_comma(path, body, separator)
    found: dict[str, Array] = {}
    for k, cell in enumerate(header.cells):
        match = HEADING.fullmatch(cell)
        plain = " ".join((match[1] if match else cell).lower().split())
        if plain not in COLUMNS:
            continue
        quantity, unit = COLUMNS[plain]
        factors = conversion(quantity, match[2] if match else unit)
        if factors is None or (match and not match[2]):
            raise UsageError(f"{path}:{header.line}: column {cell!r} has no unit of {quantity}: known are "
                             f"{known_units(quantity)}")
        values = []
        for row in body:
            value = number(row.cells[k], decimal_comma) if k < len(row.cells) else None
            if value is None or not math.isfinite(value):
                raise UsageError(f"{path}:{row.line}: column {cell!r} is {(row.cells[k:k + 1] or [''])[0]!r}, not a "
                                 "finite number; correct it or remove the line")
            values.append(value * factors[0] + factors[1])
        found[quantity] = np.array(values)
    power = found.get("power")
    if power is None and {"voltage", "current"} <= set(found):
        power = found["voltage"] * found["current"]
    if "time" not in found or power is None:
        raise UsageError(f"{path}:{header.line}: needs columns of time and power, or of time, voltage and current, "
                         f"such as time_s,power_w; it has {', '.join(header.cells)[:100]}")
    if len(power) < 2:
        raise UsageError(f"{path}: {len(power)} rows: at least 2 are needed for an interval")
    back = np.flatnonzero(np.diff(found["time"]) <= 0.0)
    if back.size:
        raise UsageError(f"{path}:{body[int(back[0]) + 1].line}: time does not go on: correct it")
    return found["time"], power


def build(path: str = "", clock: str = "epoch", longest_gap_s: str = str(LONGEST_GAP_S)) -> CsvSource:
    """The log of a path.

    Args:
        clock: "epoch" (Unix time) or "file" (its own, for `mark_at`).
        longest_gap_s: between rows.

    Raises:
        ValueError: an option that is none of these.
    """
    if not path:
        raise ValueError("give the log: csv:power.csv")
    if clock not in ("epoch", "file"):
        raise ValueError(f"clock is {clock!r}: it must be epoch or file")
    gap_s = float(longest_gap_s)
    if not 0.0 < gap_s <= 3600.0:
        raise ValueError(f"longest_gap_s is {longest_gap_s}: it must be above 0, at most 3600")
    return CsvSource(Path(path).expanduser(), clock == "epoch", gap_s)
