"""A log made elsewhere becomes a rig recording, and what is known about it becomes JSON."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

import saranga.importers
from saranga.errors import BenchError, UsageError
from saranga.importers.log import SOUND_SPEED_M_S, ImportedLog, Reader, SensorLog, read_lines, shortened
from saranga.plugins import call_with_options, nearest_hint, plugins
from saranga.recording import FrameWriter
from saranga.resample import COLUMN_M, RANGE_COLUMNS, iq_rate_hz
from saranga.sources import FileSource
from saranga.wire import FLAG_BOOT, MODE_TRANSMIT_RECEIVE, Echo, Hello, encode

GRID_M = RANGE_COLUMNS * COLUMN_M


def format_names() -> list[str]:
    """Formats that can be imported."""
    return list(plugins(saranga.importers))


def find_reader(path: Path, name: str | None, options: dict[str, Any]) -> tuple[str, Reader]:
    """The importer called `name`, or the one that knows the first line of the file.

    Raises:
        UsageError: an unknown name or option, or a file that nobody knows.
    """
    known = plugins(saranga.importers)
    if name is None:
        first = read_lines(path)[0]
        name = next((n for n, module in known.items() if module.recognises(first)), None)
        if name is None:
            looks = "; ".join(f"{n}: {module.LOOKS}" for n, module in known.items())
            raise UsageError(f"{path}, line 1: {shortened(first)!r} opens no known format: expected one of {looks}")
    elif name not in known:
        raise UsageError(f"unknown log format {name!r}{nearest_hint(name, list(known))}: known are {', '.join(known)}")
    return name, call_with_options("log format", name, known[name].build, options)


def import_log(path: Path, out: Path, name: str | None = None, options: dict[str, Any] | None = None) -> dict[str, Any]:
    """Import `path` to the new recording `out`, read that back, and say what is in it.

    Returns:
        The JSON object of `saranga-bench rig import`. `fop_hz` and `range_per_sample_m` are null where the log does
        not say, one number where the sensors agree, else a list in the order of `by_sensor`.

    Raises:
        UsageError: a file that is not as its format demands, or an `out` that exists.
        BenchError: the recording does not read back as written.
    """
    name, read = find_reader(path, name, options or {})
    log = read(path)
    notes = {**log.facts, **_notes(path, log)}
    metadata = {
        "origin": "recorded",
        "source": path.name,
        "source_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "importer": name,
        "content": log.content,
        "repeated_frames": json.dumps([list(pair) for pair in log.repeated]),
        "before_take_off_steps": json.dumps(list(log.not_flying)),
        **notes,
        **{f"inferred_{key}": text for key, text in log.inferred.items()},
        **{f"assumed_{key}": text for key, text in log.assumed.items()},
    }
    _write(log, out, metadata)
    return _summary(log, out, metadata, notes, _read_back(log, out))


def _notes(path: Path, log: ImportedLog) -> dict[str, str]:
    """What holds for any format."""
    notes = {}
    if not path.read_bytes().endswith(b"\n"):
        notes["last_line"] = "has no line end: the log may be cut off in its last number"
    record_m = max(s.samples * _range_per_sample_m(s) for s in log.sensors)
    if record_m > GRID_M:
        notes["beyond_the_image"] = f"records reach {record_m:.2f} m, an echo image shows the first {GRID_M:g} m"
    return notes


def _write(log: ImportedLog, out: Path, metadata: dict[str, str]) -> None:
    """All or nothing: under another name until it is whole."""
    if out.exists():
        raise UsageError(f"{out} exists: recordings are never overwritten; choose another name")
    part = out.with_name(out.name + ".part")
    part.unlink(missing_ok=True)
    settings = {s.info.sensor: s for s in log.sensors}
    hello = Hello(firmware=log.firmware, sensors=tuple(s.info for s in log.sensors), flags=FLAG_BOOT,
                  device_time_us=log.frames[0].t_us)
    start_us = min(frame.t_us for frame in log.frames)
    try:
        with FrameWriter(part, metadata) as writer:
            writer.write(encode(hello), 0)
            for frame in log.frames:
                sensor = settings[frame.sensor]
                echo = Echo(sensor=frame.sensor, sequence=frame.step, trigger=frame.step, device_time_us=frame.t_us,
                            fop_hz=sensor.info.fop_hz, odr=sensor.odr, mode=MODE_TRANSMIT_RECEIVE,
                            iq=frame.iq)
                writer.write(encode(echo), frame.t_us - start_us)
        part.replace(out)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _read_back(log: ImportedLog, out: Path) -> dict[str, int]:
    """Play the recording as any user of it will; its own counters are what is reported."""
    source = FileSource(out)
    source.open()
    frames = cycles = 0
    while not source.exhausted:
        for cycle in source.poll(0.0):
            cycles += 1
            frames += len(cycle.frames)
    source.close()
    placed = sum(1 for frame in log.frames for s in log.sensors if s.info.sensor == frame.sensor and s.info.role)
    if frames != placed or not source.complete:
        raise BenchError(f"{out} reads back {frames} frames of {placed}: the recording is not to be trusted; report it")
    return {"cycles": cycles, "lost": source.counters.sequence_gaps, "incomplete": source.cycle_counters.incomplete}


def _summary(log: ImportedLog, out: Path, metadata: dict[str, str], notes: dict[str, str],
             played: dict[str, int]) -> dict[str, Any]:
    by_sensor = [_sensor_summary(log, sensor) for sensor in log.sensors]
    times = [frame.t_us for frame in log.frames]
    return {
        "verdict": "PASS",
        "frames": len(log.frames),
        "sensors": len(log.sensors),
        "lost": played["lost"],
        "fop_hz": _common([s["fop_hz"] for s in by_sensor]),
        "range_per_sample_m": _common([s["range_per_sample_m"] for s in by_sensor]),
        "content": log.content,
        "cycles": played["cycles"],
        "incomplete_cycles": played["incomplete"],
        "repeated": len(log.repeated),
        "repeated_frames": [{"sensor": sensor, "step": step} for sensor, step in log.repeated],
        "before_take_off_steps": list(log.not_flying),
        "duration_s": round((max(times) - min(times)) / 1e6, 6),
        "by_sensor": by_sensor,
        "checks": [],
        "metrics": {},
        "notes": notes,
        "provenance": {
            "origin": metadata["origin"],
            "source": metadata["source"],
            "source_sha256": metadata["source_sha256"],
            "importer": metadata["importer"],
            "inferred": log.inferred,
            "assumed": log.assumed,
            "sound_speed_m_s": SOUND_SPEED_M_S,
        },
        "run": str(out),
    }


def _sensor_summary(log: ImportedLog, sensor: SensorLog) -> dict[str, Any]:
    info = sensor.info
    skipped = set(log.repeated) | {(info.sensor, step) for step in log.not_flying}
    mine = [frame for frame in log.frames if frame.sensor == info.sensor]
    step_m = _range_per_sample_m(sensor)
    used = [np.hypot(*frame.iq.astype(np.float64).T) for frame in mine if (info.sensor, frame.step) not in skipped]
    consensus = None
    if used and sensor.ring_down_samples < sensor.samples:
        first = sensor.ring_down_samples
        mean = np.mean(used, axis=0)
        peak = first + int(np.argmax(mean[first:]))
        consensus = {
            "sample": peak,
            "range_m": round(peak * step_m, 4),
            "counts": round(float(mean[peak]), 1),
            "frames": len(used),
            "first_sample": first,
        }
    return {
        "sensor": info.sensor,
        "role": info.role,
        "frames": len(mine),
        "samples": sensor.samples,
        "fop_hz": info.fop_hz if sensor.states_fop else None,
        "odr": sensor.odr,
        "range_per_sample_m": step_m if sensor.states_range else None,
        "used_fop_hz": info.fop_hz,
        "used_range_per_sample_m": step_m,
        "record_m": round(sensor.samples * step_m, 4),
        "peak_counts": max((round(float(np.hypot(*f.iq.astype(np.float64).T).max()), 1) for f in mine), default=None),
        "consensus": consensus,
        "own_range_m": sensor.own_range_m,
    }


def _range_per_sample_m(sensor: SensorLog) -> float:
    return SOUND_SPEED_M_S / (2.0 * iq_rate_hz(sensor.info.fop_hz, sensor.odr))


def _common(values: list[Any]) -> Any:
    return values[0] if all(value == values[0] for value in values) else values
