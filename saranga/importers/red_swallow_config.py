"""The `.json` configuration beside a Red Swallow log: what each sensor was set to and calls itself."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from saranga.errors import UsageError


@dataclass(frozen=True, slots=True)
class SensorEntry:
    """One sensor; `serial` is the bar code burnt into it."""

    fop_hz: float
    odr: int
    bandwidth_hz: float
    ring_down_samples: int
    serial: str


@dataclass(frozen=True)
class SensorConfig:
    """The file; `sensors` by number."""

    model: str
    firmware: str
    sensors: dict[int, SensorEntry]
    sha256: str


def read_config(path: Path) -> SensorConfig:
    """Read it.

    Raises:
        UsageError: no JSON, or a key that is missing or no number; names file, line or key, and what was expected.
    """
    data = path.read_bytes()
    try:
        tree = json.loads(data)
    except json.JSONDecodeError as error:
        raise UsageError(f"{path}, line {error.lineno}: {error.msg}: expected the JSON configuration of a Red Swallow "
                         "log; move it away to import the log without") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}, line 1: no text: expected the JSON configuration of a Red Swallow log") from None
    model = _at(path, tree, "chsensor", "name")
    firmware = _at(path, tree, "versions", "asicfw")
    entries = _at(path, tree, "sensors")
    if not isinstance(entries, dict) or not all(key.isdecimal() for key in entries):
        raise UsageError(f"{path}: sensors is no table of sensor numbers: expected one entry a sensor")
    sensors = {int(key): _entry(path, tree, key) for key in entries}
    return SensorConfig(str(model), str(firmware), sensors, hashlib.sha256(data).hexdigest())


def _entry(path: Path, tree: Any, key: str) -> SensorEntry:
    queue = ("sensors", key, "meas_queues")
    current = int(_number(path, tree, 0, 255, *queue, "current_meas"))
    return SensorEntry(
        fop_hz=_number(path, tree, 20e3, 200e3, "sensors", key, "op_freq_hz"),
        odr=int(_number(path, tree, 2, 6, *queue, "meas", current, "odr")),
        bandwidth_hz=_number(path, tree, 1.0, 100e3, "sensors", key, "bandwidth"),
        ring_down_samples=int(_number(path, tree, 0, 680, *queue, "meas_cfg", current, "ringdown_cancel_samples")),
        serial=str(_at(path, tree, "sensors", key, "otp_info_barcode"))[:32],
    )


def _at(path: Path, tree: Any, *keys: str | int) -> Any:
    for key in keys:
        try:
            tree = tree[key]
        except (KeyError, IndexError, TypeError):
            raise UsageError(f"{path}: {'.'.join(map(str, keys))} is missing: expected the configuration of a Red "
                             "Swallow log; move it away to import the log without") from None
    return tree


def _number(path: Path, tree: Any, low: float, high: float, *keys: str | int) -> float:
    value = _at(path, tree, *keys)
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = float("nan")
    if not low <= found <= high:
        raise UsageError(f"{path}: {'.'.join(map(str, keys))} is {value!r}: expected a number in {low:g}..{high:g}")
    return found
