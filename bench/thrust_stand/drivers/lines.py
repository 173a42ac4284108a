"""Open stands that print lines: a microcontroller with a load cell, on a serial port or TCP. It measures only.

What a line holds is said by options: `columns`, cut at `separator`, or a regular expression with named groups.

    lines+serial:///dev/ttyUSB0?baud=57600&columns=time:ms,thrust:gf,-,rpm&separator=,
    lines+serial:///dev/ttyUSB0?regex=T=(?P<thrust>[-0-9.]+)&units=thrust:kgf

A column is NAME or NAME:UNIT; "-" is skipped; NAME is one of QUANTITIES. What stands before the first complete line,
lines that begin with "#", and empty lines are passed over.
"""

import math
import re
import time
from collections import deque

from bench.thrust_stand.calibration import Calibration
from bench.thrust_stand.csv_cells import NUMBER
from bench.thrust_stand.links import DEFAULT_BAUD, byte_link
from bench.thrust_stand.protocol import StandInfo, StandReading
from bench.thrust_stand.registry import Where
from bench.thrust_stand.units import conversion, known_units, si_unit
from saranga.byte_links import ByteLink
from saranga.errors import DeviceError

NAME = "lines"
FORMS = "lines+serial:///dev/ttyUSB0?baud=57600&columns=time:ms,thrust:gf,rpm or lines+tcp://127.0.0.1:5555?columns=..."
MEASURES = True
SPINS = False

QUANTITIES: dict[str, tuple[str, str]] = {
    "thrust": ("thrust_n", "force"), "torque": ("torque_n_m", "torque"), "rpm": ("rpm", "rotation"),
    "voltage": ("voltage_v", "voltage"), "current": ("current_a", "current"),
    "esc_temperature": ("esc_temperature_c", "temperature"),
    "motor_temperature": ("motor_temperature_c", "temperature"),
    "vibration": ("vibration_m_s2", "acceleration"), "throttle": ("throttle", "ratio"), "time": ("", "time")}
FIRST_LINE_S = 5.0
LONGEST_LINE = 4096
MOST_BAD = 20
MOST_WAITING = 10_000
Units = dict[str, tuple[float, float]]


class LineStand:
    """A ThrustStand whose lines `parse` turns into quantities by name, in the units said."""

    def __init__(self, link: ByteLink, pattern: re.Pattern[str], units: Units, calibration: Calibration) -> None:
        self.url = link.url
        self.bad_lines = 0
        self._link = link
        self._pattern = pattern
        self._units = units
        self._calibration = calibration
        self._waiting: deque[StandReading] = deque(maxlen=MOST_WAITING)
        self._rest = b""
        self._synchronised = False
        self._bad_in_a_row = 0
        self._open = False

    def open(self) -> StandInfo:
        """Connect and wait for the first line that can be read.

        Raises:
            DeviceError: no connection, silence, or lines of another form.
        """
        self._link.open()
        self._open, self._synchronised, self._bad_in_a_row, self._rest = True, False, 0, b""
        self._waiting.clear()
        try:
            end_s = time.monotonic() + FIRST_LINE_S
            while not self._waiting:
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    raise DeviceError(f"{self.url}: no line in {FIRST_LINE_S:g} s, {self.bad_lines} not readable: "
                                      "check power, cable and baud rate")
                self._receive(left_s)
        except BaseException:
            self.close()
            raise
        fields = frozenset(QUANTITIES[name][0] for name in self._units) - {"", "throttle"}
        return StandInfo(name="line stand", firmware="unknown", quantities=fields, origin="measured",
                         has_throttle=False, dead_man_s=None)

    def read(self, timeout_s: float) -> list[StandReading]:
        """What came since the last call.

        Raises:
            DeviceError: the stand is gone, or has stopped making sense.
        """
        if not self._open:
            raise DeviceError(f"{self.url} is not open: open it first")
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = 0.0 if self._waiting else max(0.0, end_s - time.monotonic())
            self._receive(left_s)
            if self._waiting or left_s == 0.0:
                break
        taken = list(self._waiting)
        self._waiting.clear()
        return taken

    def tare(self) -> float:
        """As the protocol, on the host: the stand itself is told nothing."""
        return self._calibration.tare(self.url, self.read)

    def close(self) -> None:
        """Let go. May be called twice."""
        self._open = False
        self._link.close()

    def _receive(self, timeout_s: float) -> None:
        self._rest += self._link.read(timeout_s)
        now_s = time.monotonic()
        *lines, self._rest = re.split(rb"\r\n|\n|\r(?!$)", self._rest)
        if len(self._rest) > LONGEST_LINE:
            raise DeviceError(f"{self.url}: {len(self._rest)} bytes without an end of line: is the baud rate right?")
        for line in lines:
            # What was joined in the middle of a line is no line.
            if self._synchronised:
                self._take(line.decode("utf-8", errors="replace").strip(), now_s)
            self._synchronised = True

    def _take(self, line: str, now_s: float) -> None:
        if not line or line.startswith("#"):
            return
        reading = self._reading(line, now_s)
        if reading is None:
            self.bad_lines += 1
            self._bad_in_a_row += 1
            if self._bad_in_a_row >= MOST_BAD:
                raise DeviceError(f"{self.url}: {MOST_BAD} lines in a row are not readable, the last is {line[:80]!r}; "
                                  f"they should match {self._pattern.pattern!r}: check columns, separator and "
                                  "baud rate")
            return
        self._bad_in_a_row = 0
        self._waiting.append(reading)

    def _reading(self, line: str, now_s: float) -> StandReading | None:
        """The line as a reading. "nan" is what many sketches print for a sensor that does not answer: not measured."""
        match = self._pattern.fullmatch(line)
        if match is None:
            return None
        values = {}
        for name, (factor, offset) in self._units.items():
            text = (match[name] or "").strip()
            if text.lower() in ("", "nan"):
                continue
            if not NUMBER.fullmatch(text) or not math.isfinite(float(text)):
                return None
            if QUANTITIES[name][0]:
                values[QUANTITIES[name][0]] = float(text) * factor + offset
        values["thrust_n"] = self._calibration(values.get("thrust_n", math.nan))
        return StandReading(time_s=now_s, token=0, **values)


def build(where: Where, baud: int = DEFAULT_BAUD, columns: str = "", separator: str = ",", regex: str = "",
          units: str = "", thrust_scale: float = 1.0, thrust_sign: int = 1) -> LineStand:
    """The stand behind a URL.

    Args:
        columns: names of the columns with their units, "-" for one that is skipped.
        separator: between columns; "space" is any white space, "tab" a tabulator.
        regex: in place of columns: named groups, found in the whole line.
        units: with a regex: NAME:UNIT,NAME:UNIT for groups that are not in SI.
        thrust_scale, thrust_sign: see `Calibration`.

    Raises:
        ValueError: an option that cannot be understood.
    """
    calibration = Calibration(thrust_scale, thrust_sign)
    if bool(columns) == bool(regex):
        raise ValueError("give either columns=... or regex=...: what does a line hold?")
    pattern, conversions = _from_columns(columns, separator) if columns else _from_regex(regex, units)
    if "thrust" not in conversions:
        raise ValueError(f"no column of thrust among {', '.join(conversions) or 'none'}: a thrust stand needs one")
    return LineStand(byte_link(where, baud, FORMS), pattern, conversions, calibration)


def _from_columns(columns: str, separator: str) -> tuple[re.Pattern[str], Units]:
    between = {"space": r"\s+", "tab": "\t"}.get(separator) or rf"\s*{re.escape(separator)}\s*"
    inside = r"\S*" if separator == "space" else rf"[^{re.escape(separator) if separator != 'tab' else chr(9)}]*"
    conversions: Units = {}
    parts = []
    for text in columns.split(","):
        name, _, unit = text.strip().partition(":")
        if name == "-":
            parts.append(inside)
            continue
        conversions[name] = _unit(name, unit, conversions)
        parts.append(f"(?P<{name}>{inside})")
    # Many sketches end a line with a separator.
    return re.compile(between.join(parts) + f"(?:{between})?"), conversions


def _from_regex(regex: str, units: str) -> tuple[re.Pattern[str], Units]:
    try:
        pattern = re.compile(f".*?{regex}.*")
    except re.error as error:
        raise ValueError(f"regex {regex!r}: {error}") from error
    said = dict(part.partition(":")[::2] for part in units.split(",") if part)
    unknown = [name for name in said if name not in pattern.groupindex]
    if unknown:
        raise ValueError(f"units names {unknown[0]!r}, which is no group of regex {regex!r}")
    conversions: Units = {}
    for name in pattern.groupindex:
        conversions[name] = _unit(name, said.get(name, ""), conversions)
    return pattern, conversions


def _unit(name: str, unit: str, taken: Units) -> tuple[float, float]:
    if name not in QUANTITIES:
        raise ValueError(f"column {name!r} is not known: known are {', '.join(QUANTITIES)} and - for none")
    if name in taken:
        raise ValueError(f"column {name!r} is there twice")
    dimension = QUANTITIES[name][1]
    factors = conversion(dimension, unit or si_unit(dimension))
    if factors is None:
        raise ValueError(f"column {name!r} has unit {unit!r}, which is no unit of {dimension}: known are "
                         f"{known_units(dimension)}")
    return factors
