"""A sweep from a file, played as a stand: RCbenchmark CSV, or a stand.csv of our own. It measures only."""

import time
from dataclasses import fields
from pathlib import Path

import numpy as np

from bench.thrust_stand.formats import read_sweep
from bench.thrust_stand.protocol import StandInfo, StandReading
from bench.thrust_stand.registry import Where
from bench.thrust_stand.sweep_table import SweepTable
from saranga.errors import DeviceError

NAME = "file"
FORMS = "file:sweep.csv[?speed=1&thrust_sign=-1]"
MEASURES = True
SPINS = False

NOT_MEASURED = {"time_s", "token", "throttle"}
PULSE_IDLE_S, PULSE_SPAN_S = 1e-3, 1e-3


class FileStand:
    """Rows at the pace of the file's clock (times `speed`), or all at once with speed 0."""

    def __init__(self, url: str, table: SweepTable, speed: float) -> None:
        self.url = url
        self._table = table
        self._speed = speed
        self._readings = _readings(table)
        times = np.array([reading.time_s for reading in self._readings])
        # Clocks of such files start again now and then: time only goes on.
        self._due_s = np.cumsum(np.maximum(np.diff(times, prepend=times[:1]), 0.0))
        self._next = 0
        self._began_s: float | None = None

    def open(self) -> StandInfo:
        """Start playing from the first row."""
        self._next, self._began_s = 0, time.monotonic()
        measured = frozenset(f.name for f in fields(StandReading) if f.name in self._table.quantities) - NOT_MEASURED
        return StandInfo(name=f"recording {self._table.path.name}", firmware=self._table.format, quantities=measured,
                         origin="recorded", has_throttle=False, dead_man_s=None)

    def read(self, timeout_s: float) -> list[StandReading]:
        """Rows that are due. Their times are those of the file.

        Raises:
            DeviceError: not open, or all rows have been read.
        """
        if self._began_s is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        if self._next >= len(self._readings):
            raise DeviceError(f"{self.url}: the recording has ended after {len(self._readings)} rows")
        if self._speed > 0.0:
            wait_s = self._due_s[self._next] / self._speed - (time.monotonic() - self._began_s)
            time.sleep(max(0.0, min(float(wait_s), timeout_s)))
            due = int(np.searchsorted(self._due_s, (time.monotonic() - self._began_s) * self._speed, side="right"))
        else:
            due = len(self._readings)
        taken = self._readings[self._next:due]
        self._next = max(due, self._next)
        return taken

    def tare(self) -> float:
        """Nothing: a recording was tared by whoever made it."""
        return 0.0

    def close(self) -> None:
        self._began_s = None


def _readings(table: SweepTable) -> list[StandReading]:
    quantities = dict(table.quantities)
    quantities.setdefault("time_s", np.arange(table.rows, dtype=float))
    if "throttle" not in quantities and "esc_s" in quantities:
        quantities["throttle"] = np.clip((quantities["esc_s"] - PULSE_IDLE_S) / PULSE_SPAN_S, 0.0, 1.0)
    names = [f.name for f in fields(StandReading) if f.name in quantities and f.name != "token"]
    rows = np.stack([quantities[name] for name in names], axis=1).tolist()
    tokens = np.nan_to_num(quantities.get("token", np.zeros(table.rows))).astype(int).tolist()
    return [StandReading(**dict(zip(names, row, strict=True)), token=token)
            for row, token in zip(rows, tokens, strict=True)]


def build(where: Where, speed: float = 1.0, rpm: str = "", thrust_sign: int = 1) -> FileStand:
    """The recording behind a URL.

    Args:
        speed: of playing; 0 gives all rows at once.
        rpm: "electrical" or "optical", for files that have both.
        thrust_sign: -1 turns all thrusts round.

    Raises:
        ValueError: a speed that is none. UsageError: the file cannot be read or has a fault.
    """
    if where.transport or not where.path:
        raise where.refused(FORMS)
    if not isinstance(speed, int | float) or not 0.0 <= speed <= 1e6:
        raise ValueError(f"speed is {speed!r}: it must be 0..1000000")
    options: dict[str, object] = {"rpm": rpm} if rpm else {}
    if thrust_sign != 1:
        options["thrust_sign"] = thrust_sign
    return FileStand(where.url, read_sweep(Path(where.path).expanduser(), **options), float(speed))
