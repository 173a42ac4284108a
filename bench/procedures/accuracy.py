"""Accuracy of any ranger by the paper's formula: 1 - mean |D_true - D_measured|, an undefined or zero reading counts 1.

Distances are in metres, the obstacle stands at a known distance (1 m in the paper, where sonar reached 89.3 % on
average). The error is not capped but for undefined readings, as printed; what a cap at 1 would give stands beside it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from saranga.errors import UsageError

PAPER_SONAR = 0.893
UNDEFINED_ERROR = 1.0
NO_OBSTACLE_CM = 65_535
"""OBSTACLE_DISTANCE: unknown; its max_distance + 1 means that nothing was seen."""


@dataclass(frozen=True)
class Readings:
    """Distances of one ranger, m; NaN where it gave none. `origin` of the numbers."""

    values_m: tuple[float, ...]
    source: str
    origin: str


@dataclass(frozen=True)
class Accuracy:
    """The paper's figure and what it hides."""

    accuracy: float
    capped: float
    readings: int
    undefined: int
    bias_m: float | None
    deviation_m: float | None
    interval: tuple[float, float]


def accuracy_of(values_m: Sequence[float], true_m: float, seed: int = 0) -> Accuracy:
    """Score readings against the true distance.

    The interval is a bootstrap over ten runs of successive readings: neighbours share what is wrong with them.

    Raises:
        UsageError: no reading, or a true distance that is none.
    """
    if not (math.isfinite(true_m) and true_m > 0.0):
        raise UsageError(f"--true-m {true_m}: must be a positive distance in metres")
    values = np.asarray(values_m, dtype=np.float64)
    if values.size == 0:
        raise UsageError("no reading at all: the ranger said nothing, or the file holds another sensor")
    undefined = ~np.isfinite(values) | (values <= 0.0)
    error = np.where(undefined, UNDEFINED_ERROR, np.abs(true_m - np.where(undefined, true_m, values)))
    good = values[~undefined]
    runs = np.array_split(error, min(10, error.size))
    weights = np.array([len(r) for r in runs])
    means = np.array([r.mean() for r in runs])
    picks = np.random.default_rng(seed).integers(0, len(runs), size=(2000, len(runs)))
    boot = 1.0 - (means[picks] * weights[picks]).sum(axis=1) / weights[picks].sum(axis=1)
    return Accuracy(
        accuracy=float(1.0 - error.mean()), capped=float(1.0 - np.minimum(error, 1.0).mean()),
        readings=int(values.size), undefined=int(undefined.sum()),
        bias_m=float(good.mean() - true_m) if good.size else None,
        deviation_m=float(good.std(ddof=1)) if good.size > 1 else None,
        interval=(float(np.quantile(boot, 0.025)), float(np.quantile(boot, 0.975))))


def read_csv(path: Path, column: str | None, scale: float = 1.0) -> Readings:
    """One column of a CSV file, times `scale`; blank, text or NaN cells are undefined readings.

    Args:
        column: its header; needed where the file has more than one column that could be meant.

    Raises:
        UsageError: no such file or column.
    """
    import csv

    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: cannot be read: {error}") from error
    names = [n for n in (rows[0] if rows else {}) if n]
    if column is None:
        likely = [n for n in names if "dist" in n.lower() or "range" in n.lower()]
        if len(likely) != 1 and len(names) != 1:
            raise UsageError(f"{path}: say which column with --column: it has {', '.join(names) or 'none'}")
        column = likely[0] if len(likely) == 1 else names[0]
    if column not in names:
        raise UsageError(f"{path}: has no column {column!r}: it has {', '.join(names) or 'none'}")
    return Readings(tuple(scale * _number(row.get(column)) for row in rows), f"{path}, column {column}", "recorded")


def read_mavlink(path: Path, message: str, sensor_id: int | None = None) -> Readings:
    """DISTANCE_SENSOR or OBSTACLE_DISTANCE of a telemetry log (.tlog); cm to m.

    A reading outside the sensor's own limits is undefined; of OBSTACLE_DISTANCE the nearest sector counts.

    Raises:
        UsageError: no log, or none of these messages in it.
    """
    if not path.is_file():
        raise UsageError(f"{path}: does not exist: give a MAVLink telemetry log (.tlog)")
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    values: list[float] = []
    others: dict[str, int] = {}
    while (m := log.recv_match()) is not None:
        kind = m.get_type()
        if kind != message:
            others[kind] = others.get(kind, 0) + 1
        elif kind == "DISTANCE_SENSOR":
            if sensor_id is None or m.id == sensor_id:
                inside = m.min_distance <= m.current_distance <= m.max_distance
                values.append(m.current_distance / 100.0 if inside else math.nan)
        else:
            seen = [d for d in m.distances if d not in (NO_OBSTACLE_CM, 0) and d <= m.max_distance]
            values.append(min(seen) / 100.0 if seen else math.nan)
    if not values:
        raise UsageError(f"{path}: holds no {message}{'' if sensor_id is None else f' of sensor {sensor_id}'} "
                         f"(it has {', '.join(sorted(others)[:8]) or 'nothing readable'}): record it with the ranger "
                         "on")
    return Readings(tuple(values), f"{path}, {message}", "recorded")


def read_rig(path: Path, sensor: str, near_m: float = 0.25, factor: float = 4.0) -> Readings:
    """Nearest echo of each cycle of a rig recording: the leading edge of the first run over `factor` times the noise.

    Args:
        near_m: nothing nearer counts: there the transmitter rings.
        factor: threshold over the median envelope of the record's far half.

    Raises:
        UsageError: no recording, no HELLO, or no transmit/receive record of that sensor.
    """
    from saranga.echo import COLUMN_M, resample, sound_speed_m_s
    from saranga.pulse import pulse_peak_delay_s
    from saranga.sources import FileSource

    source = FileSource(path)
    hello = source.open()
    bandwidth = next((s.bandwidth_hz for s in hello.sensors if s.role == sensor), None)
    if bandwidth is None:
        raise UsageError(f"{path}: has no sensor {sensor!r}: it has {', '.join(s.role for s in hello.sensors)}")
    origin = "emulated" if "emulated" in hello.firmware or "virtual" in hello.firmware else "measured"
    values: list[float] = []
    while not source.exhausted:
        for cycle in source.poll(0.0):
            frame = cycle.frames.get(sensor)
            if frame is None:
                values.append(math.nan)
                continue
            if frame.mode != 0:
                raise UsageError(f"{path}: is of receive-only records: ranging needs echoes")
            status = source.status
            known = status is not None and math.isfinite(status.temperature_c)
            c = sound_speed_m_s(status.temperature_c if known and status is not None else 20.0)
            row = np.abs(resample(frame, c))
            first = int(near_m / COLUMN_M)
            over = np.flatnonzero(row[first:] > factor * max(float(np.median(row[len(row) // 2:])), 1e-6))
            if over.size == 0:
                values.append(math.nan)
                continue
            # The peak of that echo, less the time its envelope takes to get there.
            start = first + int(over[0])
            peak = start + int(np.argmax(row[start:start + int(0.06 / COLUMN_M)]))
            values.append(peak * COLUMN_M - 0.5 * c * pulse_peak_delay_s(bandwidth))
    if not values:
        raise UsageError(f"{path}: holds no cycle")
    return Readings(tuple(values), f"{path}, sensor {sensor}", origin)


def accuracy_result(readings: Readings, true_m: float) -> dict[str, Any]:
    """JSON-ready, the paper's sonar figure beside it."""
    found = accuracy_of(readings.values_m, true_m)
    return {"accuracy": found.accuracy, "interval": list(found.interval), "accuracy_capped": found.capped,
            "readings": found.readings, "undefined": found.undefined, "bias_m": found.bias_m,
            "deviation_m": found.deviation_m, "true_m": true_m, "paper_sonar": PAPER_SONAR, "source": readings.source,
            "origin": readings.origin}


def mean_accuracy(results: Iterable[Accuracy]) -> float:
    """The paper's "average for all environments": every environment counts the same."""
    values = [r.accuracy for r in results]
    if not values:
        raise UsageError("no environment to average over")
    return sum(values) / len(values)


def _number(text: str | None) -> float:
    try:
        return float(text) if text is not None and text.strip() else math.nan
    except ValueError:
        return math.nan
