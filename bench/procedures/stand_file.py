"""stand.csv: every reading of the stand, a line each, appended; what a crash leaves is readable."""

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from bench.thrust_stand.protocol import StandReading
from saranga.errors import DeviceError, UsageError

COLUMNS = tuple(f.name for f in fields(StandReading))


class StandFile:
    """Appends; blank cells are what the stand does not measure.

    Raises:
        UsageError: the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            fresh = not path.exists() or path.stat().st_size == 0
            if not fresh:
                cut_torn_line(path)
            self._file = path.open("a", encoding="utf-8", newline="\n")
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}; choose another place with --out") from error
        if fresh:
            self._file.write(",".join(("step", *COLUMNS)) + "\n")

    def write(self, step: int, readings: Sequence[StandReading]) -> None:
        """Append readings of a step.

        Raises:
            DeviceError: the disk is full or gone.
        """
        if not readings:
            return
        try:
            for reading in readings:
                self._file.write(f"{step}," + ",".join(_cell(getattr(reading, name)) for name in COLUMNS) + "\n")
            self._file.flush()
        except OSError as error:
            raise DeviceError(f"{self.path}: cannot be written: {error.strerror}; free some space, then --resume"
                              ) from error

    def close(self) -> None:
        """May be called twice."""
        self._file.close()


def cut_torn_line(path: Path) -> None:
    """Remove a last line without its end."""
    data = path.read_bytes()
    if data and not data.endswith(b"\n"):
        path.write_bytes(data[:data.rfind(b"\n") + 1])


def _cell(value: float | int) -> str:
    if isinstance(value, int):
        return str(value)
    return f"{value:.7g}" if math.isfinite(value) else ""
