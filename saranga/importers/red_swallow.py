"""Native IQ logged by TDK's evaluation software "Red Swallow" (SmartSonic boards, ICU-20201 and its siblings).

The text log opens with `# key: value` lines and one line of column names per sensor:

    # Chirp Microsystems redswallow Data Log
    # sample rate: 12.98 S/s        # Decimation factor: 1        # Content: iq
    # Sensors ID: 0,1        # Sensors FOP: 83469,76877 Hz        # Sensors NB Samples: 293,293
    # time [s],tx_id,rx_id,range [cm],intensity [a.u.],target_detected,insertionAnnotation,idata_1.6,...,qdata_481.6
    660.073,0,0,43.5,3607,1,0,0.0,2.0,...

The number in a column's name is its range in cm at 343 m/s, counted from one, so it tells the output data rate. The
sensors' configuration lies beside it under the same name with `.json`; without it bandwidths are assumed.
"""

import re
from dataclasses import dataclass
from math import log2
from pathlib import Path

import numpy as np

from saranga.errors import UsageError
from saranga.importers.log import (
    SOUND_SPEED_M_S,
    ImportedLog,
    LoggedFrame,
    Reader,
    SensorLog,
    bad_line,
    check_columns,
    counts,
    number,
    read_lines,
    repeated_rows,
    shortened,
)
from saranga.importers.red_swallow_config import SensorConfig, read_config
from saranga.messages import MAX_SAMPLES, SensorInfo
from saranga.sonar_geometry import ROLES

NAME = "red-swallow"
LOOKS = "'# Chirp Microsystems redswallow Data Log' on the first line"
LEADING = ("# time [s]", "tx_id", "rx_id", "range [cm]", "intensity [a.u.]", "target_detected", "insertionAnnotation")
BANDWIDTH_HZ = 3_400.0
RING_DOWN_SAMPLES = 20
KEYS = ("sample rate", "Decimation factor", "Content", "Sensors ID", "Sensors FOP", "Sensors NB Samples",
        "Sensors NB First samples skipped")
METRES = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}


@dataclass(frozen=True)
class _Head:
    """What opens the log; the tables go by sensor number, `lines` is how many lines the head takes."""

    rate_hz: float
    fop_hz: dict[int, float]
    samples: dict[int, int]
    odr: dict[int, int]
    lines: int


def recognises(first_line: str) -> bool:
    """The log names the program that wrote it."""
    return first_line.startswith("#") and "redswallow" in first_line.lower()


def build() -> Reader:
    """A reader of such logs; there is nothing to choose."""
    return _read


def _read(path: Path) -> ImportedLog:
    lines = read_lines(path)
    head = _read_head(path, lines)
    config_path = path.with_suffix(".json")
    config = read_config(config_path) if config_path.is_file() else None
    rows = _read_rows(path, lines, head)
    frames = _number_steps(path, rows, 1.0 / head.rate_hz)
    own: dict[int, list[float]] = {}
    for row in rows:
        if row.range_m is not None:
            own.setdefault(row.rx, []).append(row.range_m)
    heard = {row.rx for row in rows}
    transmitters = {row.tx for row in rows}
    sensors = tuple(
        _sensor(config_path, head, s, config, ROLES[n] if n < len(ROLES) else "", s in transmitters, own.get(s))
        for n, s in enumerate(head.fop_hz)
    )
    facts = {}
    if len(sensors) > 1:
        alone = all(row.tx == row.rx for row in rows)
        facts["sensors"] = ("each its own transmitter, one after the other: a cycle pairs their measurements, but they "
                            "are not of one trigger" if alone else "some hear another one's transmitter")
    assumed = {"roles": ", ".join(f"sensor {s.info.sensor} {s.info.role or 'none'}" for s in sensors)
               + " (the log has numbers, no places)"}
    silent = sorted(set(head.fop_hz) - heard)
    if silent:
        facts["silent_sensors"] = ", ".join(map(str, silent))
    nominal = re.search(r"(?:^|[-_])(\d+(?:\.\d+)?)(mm|cm|in)(?=[-_.])", path.name)
    inferred = {"odr": "from the ranges in the column names" + (", as in the configuration" if config else "")}
    if nominal:
        inferred["nominal_distance_m"] = f"{float(nominal[1]) * METRES[nominal[2]]:g} (from the file name)"
    if config is None:
        assumed["bandwidth_hz"] = f"{BANDWIDTH_HZ:g} ({config_path.name} is not beside the log)"
    if config is not None:
        facts["configuration"] = f"{config_path.name} sha256 {config.sha256}"
    firmware = f"imported {config.model} {config.firmware}" if config is not None else "imported ICU"
    return ImportedLog(
        firmware.encode()[:64].decode(errors="ignore"), "iq", sensors, frames, repeated_rows(frames), (), facts,
        inferred, assumed,
    )


def _sensor(path: Path, head: _Head, sensor: int, config: SensorConfig | None, role: str, transmits: bool,
            own: list[float] | None) -> SensorLog:
    bandwidth_hz, serial, ring_down = BANDWIDTH_HZ, "", RING_DOWN_SAMPLES
    if config is not None:
        if sensor not in config.sensors:
            raise UsageError(f"{path}: sensors has {', '.join(map(str, config.sensors))}, the log sensor {sensor}: "
                             "expected the configuration of this log")
        entry = config.sensors[sensor]
        for key, in_file, in_log in (("op_freq_hz", entry.fop_hz, head.fop_hz[sensor]),
                                     ("odr", entry.odr, head.odr[sensor])):
            if in_file != in_log:
                raise UsageError(f"{path}: sensors.{sensor} {key} is {in_file:g}: expected {in_log:g} as in the log; "
                                 "is it the configuration of another one?")
        bandwidth_hz, serial, ring_down = entry.bandwidth_hz, entry.serial, entry.ring_down_samples
    info = SensorInfo(sensor=sensor, role=role, fop_hz=head.fop_hz[sensor], bandwidth_hz=bandwidth_hz,
                      transmits=transmits, serial=serial)
    return SensorLog(info, head.odr[sensor], head.samples[sensor], ring_down,
                     own_range_m=float(np.median(own)) if own else None)


def _read_head(path: Path, lines: list[str]) -> _Head:
    if not recognises(lines[0]):
        raise bad_line(path, 1, f"{shortened(lines[0])!r}", LOOKS)
    values: dict[str, tuple[int, str]] = {}
    names: list[tuple[int, list[str]]] = []
    at = 1
    while at < len(lines) and lines[at].startswith("#"):
        if lines[at].startswith(LEADING[0]):
            names.append((at + 1, lines[at].split(",")))
        else:
            key, _, value = lines[at].lstrip("# ").partition(":")
            values[key.strip()] = (at + 1, value.strip())
        at += 1
    for key in KEYS:
        if key not in values:
            raise bad_line(path, at + 1, f"no line '# {key}: ...' before it", "the complete head of a Red Swallow log")
    for key, wanted in (("Content", "iq"), ("Decimation factor", "1")):
        line, value = values[key]
        if value.lower() != wanted:
            raise bad_line(path, line, f"{key} is {shortened(value)!r}", f"{wanted!r}, which alone can be imported")
    rate_hz = number(path, values["sample rate"][0], "sample rate", values["sample rate"][1].removesuffix("S/s"),
                     0.001, 10e3)
    ids = [int(v) for v in _listed(path, values, "Sensors ID", None, 0, 254)]
    if len(set(ids)) != len(ids):
        raise bad_line(path, values["Sensors ID"][0], f"Sensors ID is {ids}", "different numbers")
    fops = _listed(path, values, "Sensors FOP", len(ids), 20e3, 200e3)
    sizes = [int(v) for v in _listed(path, values, "Sensors NB Samples", len(ids), 2, MAX_SAMPLES)]
    _listed(path, values, "Sensors NB First samples skipped", len(ids), 0, 0)
    if len(names) != len(ids):
        raise bad_line(path, at + 1, f"{len(names)} lines of column names before it", f"{len(ids)}, one a sensor")
    odr = {s: _odr(path, *names[n], sizes[n], fops[n]) for n, s in enumerate(ids)}
    return _Head(rate_hz, dict(zip(ids, fops, strict=True)), dict(zip(ids, sizes, strict=True)), odr, at)


def _listed(path: Path, values: dict[str, tuple[int, str]], key: str, count: int | None, low: float,
            high: float) -> list[float]:
    line, text = values[key]
    parts = text.removesuffix("Hz").split(",")
    if count is not None and len(parts) != count:
        raise bad_line(path, line, f"{key} has {len(parts)} values", f"{count}, one a sensor")
    return [number(path, line, key, part.strip(), low, high) for part in parts]


def _odr(path: Path, line: int, names: list[str], samples: int, fop_hz: float) -> int:
    """Output data rate setting from the ranges in the names of the columns."""
    check_columns(path, line, names, len(LEADING) + 2 * samples, 0, f" for {samples} samples")
    for n, name in enumerate(names):
        if n < len(LEADING):
            fits, wanted = name == LEADING[n], repr(LEADING[n])
        else:
            wanted = "idata_" if n < len(LEADING) + samples else "qdata_"
            fits, wanted = name.startswith(wanted), f"{wanted!r} and a range in cm"
        if not fits:
            raise bad_line(path, line, f"column {n + 1} is {shortened(name)!r}", wanted)
    last = names[len(LEADING) + samples - 1]
    step_m = number(path, line, "range in the name of the last idata column", last[6:], 0.1, 1e5) * 0.01 / samples
    power = log2(step_m * 2.0 * fop_hz / SOUND_SPEED_M_S)
    odr = 7 - round(power)
    if not 2 <= odr <= 6 or abs(power - round(power)) > 0.05:
        raise bad_line(path, line, f"column names step by {step_m * 100:.3f} cm",
                       f"343 m/s * 2^(7 - ODR) / (2 * {fop_hz:g} Hz) with ODR 2..6")
    return odr


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    t_s: float
    tx: int
    rx: int
    range_m: float | None
    iq: np.ndarray


def _read_rows(path: Path, lines: list[str], head: _Head) -> list[_Row]:
    rows: list[_Row] = []
    tx_of: dict[int, int] = {}
    for line, text in enumerate(lines[head.lines:], start=head.lines + 1):
        fields = text.split(",")
        if len(fields) < len(LEADING):
            check_columns(path, line, fields, len(LEADING) + 2 * max(head.samples.values()), len(lines))
        t_s = number(path, line, "time", fields[0], 0.0, 1e9)
        tx, rx = (_known_sensor(path, line, name, text, head) for name, text in zip(LEADING[1:3], fields[1:3],
                                                                                   strict=True))
        n, first = head.samples[rx], len(LEADING)
        check_columns(path, line, fields, first + 2 * n, len(lines), f" for {n} samples")
        if tx_of.setdefault(rx, tx) != tx:
            raise bad_line(path, line, f"sensor {rx} hears sensor {tx}, and sensor {tx_of[rx]} before",
                           "one transmitter a sensor; split the log")
        data = counts(path, line, fields[first:], first + 1, -32768)
        found = number(path, line, LEADING[5], fields[5], 0, 255) > 0
        range_m = number(path, line, LEADING[3], fields[3], 0, 1e5) * 0.01 if found else None
        rows.append(_Row(line, t_s, tx, rx, range_m, np.stack([data[n:], data[:n]], axis=1)))
    if not rows:
        raise bad_line(path, len(lines), "no measurement after the head", "at least one row")
    return rows


def _known_sensor(path: Path, line: int, name: str, text: str, head: _Head) -> int:
    if not text.isdecimal() or int(text) not in head.fop_hz:
        raise bad_line(path, line, f"{name} is {shortened(text)!r}", f"one of {', '.join(map(str, head.fop_hz))}")
    return int(text)


def _number_steps(path: Path, rows: list[_Row], period_s: float) -> tuple[LoggedFrame, ...]:
    """Frames numbered by cycle. The log has no counter, but a clock and its period: a pause is lost cycles.

    Each sensor is counted on its own, from step to step, so that a clock that is off by a little does no harm.
    """
    start_s = min(row.t_s for row in rows)
    last: dict[int, tuple[float, int]] = {}
    frames = []
    for row in rows:
        if row.rx in last:
            before_s, before = last[row.rx]
            if row.t_s <= before_s:
                raise bad_line(path, row.line, f"time is {row.t_s:g} s", f"more than {before_s:g} s of the row before "
                               f"of sensor {row.rx}")
            step = before + max(1, round((row.t_s - before_s) / period_s))
        else:
            step = int((row.t_s - start_s) / period_s + 1e-6)
        last[row.rx] = (row.t_s, step)
        frames.append(LoggedFrame(row.rx, step, round(row.t_s * 1e6), row.iq))
    return tuple(sorted(frames, key=lambda f: (f.step, f.t_us, f.sensor)))
