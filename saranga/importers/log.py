"""What an importer makes of a log, and the reading of text that every importer needs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from saranga.messages import SensorInfo

SOUND_SPEED_M_S = 343.0
"""What TDK's software takes for the speed of sound, whatever the temperature (hardware.md)."""
FULL_SCALE_COUNTS = 20_984
"""Where |IQ| of the ICU sensors saturates (hardware.md)."""
ON_CHIP_FACTOR = 0.82
"""Amplitude computed on the sensor over |IQ| (hardware.md; 0.819 in the logs of the ICU-20201)."""


@dataclass(frozen=True, slots=True)
class SensorLog:
    """One sensor of a log.

    `states_fop`, `states_range`: whether the log (or its reader) gave the carrier and the range per sample; else they
    are assumed. `own_range_m`: median of the ranges that the sensor itself reported, None where the log has none.
    """

    info: SensorInfo
    odr: int
    samples: int
    ring_down_samples: int
    states_fop: bool = True
    states_range: bool = True
    own_range_m: float | None = None


@dataclass(frozen=True, slots=True)
class LoggedFrame:
    """One row of a log. `step` counts the sensor's cycles with the lost ones; `iq` is int16 (n, 2), Q first."""

    sensor: int
    step: int
    t_us: int
    iq: NDArray[np.int16]


@dataclass(frozen=True)
class ImportedLog:
    """A log read to its end.

    Attributes:
        firmware: what HELLO says.
        content: "iq" or "amplitude" (I = amplitude, Q = 0).
        frames: ordered by step, then time.
        repeated: (sensor, step) of rows equal to the row before: the logger wrote an old measurement again.
        not_flying: steps taken before take-off.
        facts: texts kept with the recording.
        inferred: what the file implies without saying it.
        assumed: what the file does not say at all.
    """

    firmware: str
    content: str
    sensors: tuple[SensorLog, ...]
    frames: tuple[LoggedFrame, ...]
    repeated: tuple[tuple[int, int], ...] = ()
    not_flying: tuple[int, ...] = ()
    facts: dict[str, str] = field(default_factory=dict)
    inferred: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)


Reader = Callable[[Path], ImportedLog]


def read_lines(path: Path) -> list[str]:
    """Lines of a text file without their ends; blank lines at the end are left out.

    Raises:
        UsageError: missing, a folder, empty, or no text.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise UsageError(f"{path} does not exist: give the path of a log") from None
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}; give the path of a log") from error
    if not data.strip():
        raise UsageError(f"{path} is empty ({len(data)} bytes): expected a log of echoes")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _not_text(path, data, error.start) from None
    if "\0" in text:
        raise _not_text(path, data, data.index(b"\0"))
    lines = [line.rstrip("\r") for line in text.split("\n")]
    while not lines[-1].strip():
        lines.pop()
    return lines


def _not_text(path: Path, data: bytes, at: int) -> UsageError:
    line = data.count(b"\n", 0, at) + 1
    hint = "; a recording needs no import, play it with file:" if data.startswith(b"\x89MCAP") else ""
    return UsageError(f"{path}, line {line}: byte 0x{data[at]:02x} is no text: expected a text log of echoes{hint}")


def bad_line(path: Path, line: int, found: str, expected: str) -> UsageError:
    """The one form of a complaint about a line; `line` counts from 1."""
    return UsageError(f"{path}, line {line}: {found}: expected {expected}")


def check_columns(path: Path, line: int, fields: Sequence[str], columns: int, last_line: int, why: str = "") -> None:
    """Raises UsageError unless there are `columns` fields; a short last line is called what it is."""
    if len(fields) != columns:
        cut = "; the log is cut off here: remove this line to import the rest" if line == last_line else ""
        raise bad_line(path, line, f"{len(fields)} columns", f"{columns}{why}{cut}")


def counts(path: Path, line: int, fields: Sequence[str], first_column: int, low: int) -> NDArray[np.int16]:
    """Fields as counts, fractions rounded; columns count from 1 in what is said to people.

    Raises:
        UsageError: a field that is no finite number, or outside `low`..32767.
    """
    values = np.array([float(text) if is_number(text) else math.nan for text in fields])
    bad = np.flatnonzero(~((values >= low) & (values <= 32767)))
    if len(bad):
        at = int(bad[0])
        raise bad_line(path, line, f"column {first_column + at} is {shortened(fields[at])!r}",
                       f"a number of counts in {low}..32767")
    return np.rint(values).astype(np.int16)


def number(path: Path, line: int, what: str, text: str, low: float, high: float) -> float:
    """One number. Raises UsageError when it is none or outside `low`..`high`."""
    value = float(text) if is_number(text) else math.nan
    if not low <= value <= high:
        raise bad_line(path, line, f"{what} is {shortened(text)!r}", f"a number in {low:g}..{high:g}")
    return value


def is_number(text: str) -> bool:
    """Whether Python's float takes it (NaN and infinity included)."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def shortened(text: str, most: int = 40) -> str:
    """At most `most` characters, for messages."""
    return text if len(text) <= most else text[: most - 3] + "..."


def repeated_rows(frames: Sequence[LoggedFrame]) -> tuple[tuple[int, int], ...]:
    """(sensor, step) of frames whose samples equal those of the sensor's frame before."""
    before: dict[int, LoggedFrame] = {}
    found = []
    for frame in frames:
        last = before.get(frame.sensor)
        if last is not None and np.array_equal(last.iq, frame.iq):
            found.append((frame.sensor, frame.step))
        before[frame.sensor] = frame
    return tuple(found)
