"""Where the sonar sensors sit and what they are: `fixtures/sonars/*.toml` checked into a dataclass."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml

ROLES = ("left", "right", "down")
BASELINE_TOLERANCE_M = 1e-4

# table -> key -> (lowest, highest); every one of them is a required number.
LIMITS: dict[str, dict[str, tuple[float, float]]] = {
    "sonar": {"cycle_us": (5_000, 1_000_000)},
    "receiver": {
        "fop_hz": (20e3, 200e3), "odr": (2, 6), "samples": (16, 680), "bandwidth_hz": (100.0, 50e3),
        "ring_down_samples": (0, 300), "full_scale_counts": (1.0, 32767.0),
        "saturation_counts": (1.0, 32767.0), "quiet_floor_counts": (0.0, 10e3), "counts_at_1m": (1.0, 1e6),
    },
    "horn": {"a_h_m": (1e-4, 0.1), "a_v_m": (1e-4, 0.1)},
    "weather": {"temperature_c": (-40.0, 60.0)},
}
# The same for numbers that may be left out.
OPTIONAL: dict[str, dict[str, tuple[float, float]]] = {"receiver": {"noise_bandwidth_hz": (100.0, 50e3)}}
CALIBRATION_LIMITS = {"delay_m": (-0.05, 0.05), "phase_rad": (-2.0 * math.pi, 2.0 * math.pi)}
INTEGERS = {"cycle_us", "odr", "samples", "ring_down_samples"}
TEXTS = {"name", "description", "transmitter"}
POSITION_LIMIT_M = 1.0


@dataclass(frozen=True)
class SensorCalibration:
    """How a sensor differs from the left one: its echoes come `delay_m` of path late and `phase_rad` ahead.

    `saranga.disparity.calibrate` measures it. The phase is that of the carrier apart from the delay of the envelope.
    """

    delay_m: float = 0.0
    phase_rad: float = 0.0


@dataclass(frozen=True)
class SonarGeometry:
    """A suite of sonar sensors. Positions are body FRD from the airframe's centre.

    `baseline_h_m` is left to right, `baseline_v_m` left to down (0 without such a sensor). A single sensor has the
    role "left". Counts are |IQ| of the sensor's int16 output. `counts_at_1m` is the echo of a large plane at 1 m on
    axis, transmit/receive. `noise_bandwidth_hz`: band of the propellers' noise as the sensor hears it, where it is
    known to differ from `bandwidth_hz`. `calibration` is by role; a role in it has a known phase against the left
    sensor.
    """

    name: str
    description: str
    positions_m: dict[str, tuple[float, float, float]]
    transmitter: str
    baseline_h_m: float
    baseline_v_m: float
    cycle_us: int
    fop_hz: float
    odr: int
    samples: int
    bandwidth_hz: float
    ring_down_samples: int
    full_scale_counts: float
    saturation_counts: float
    quiet_floor_counts: float
    counts_at_1m: float
    a_h_m: float
    a_v_m: float
    temperature_c: float
    calibration: dict[str, SensorCalibration] = field(default_factory=dict)
    noise_bandwidth_hz: float | None = None

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles present, in the order left, right, down."""
        return tuple(role for role in ROLES if role in self.positions_m)

    @property
    def iq_rate_hz(self) -> float:
        """Complex samples a second: fop / 2^(7 - odr)."""
        return self.fop_hz / 2.0 ** (7 - self.odr)


def load_sonar(name: str) -> SonarGeometry:
    """Load a suite by fixture name ("pair", "triple") or path of a TOML file.

    Raises:
        UsageError: unknown name, malformed file, or a value out of its limits; names file, key, value and
            limit.
    """
    path = fixture_path("sonars", name)
    tables = load_toml(path)
    _known_only(path, tables)
    values = {key: _number(path, tables, table, key, *limits)
              for table, keys in LIMITS.items() for key, limits in keys.items()}
    values |= {key: _number(path, tables, table, key, *limits) for table, keys in OPTIONAL.items()
               for key, limits in keys.items() if key in tables[table]}
    positions = {role: _position(path, tables, role) for role in ROLES if role in tables["positions_m"]}
    baseline_h, baseline_v = _baselines(path, tables, positions)
    sonar = tables["sonar"]
    for key in TEXTS:
        if not isinstance(sonar.get(key), str):
            raise UsageError(f"{path}: sonar.{key} is {sonar.get(key)!r}: it must be a text; add it")
    if sonar["transmitter"] not in positions:
        raise UsageError(f"{path}: sonar.transmitter is {sonar['transmitter']!r}: it must be one of "
                         f"{', '.join(positions)}, the sensors in [positions_m]")
    if values["saturation_counts"] < values["full_scale_counts"]:
        raise UsageError(f"{path}: receiver.saturation_counts is {values['saturation_counts']:g}: it must "
                         "be at "
                         f"least receiver.full_scale_counts, {values['full_scale_counts']:g}")
    return SonarGeometry(name=sonar["name"], description=sonar["description"], positions_m=positions,
                         transmitter=sonar["transmitter"], baseline_h_m=baseline_h, baseline_v_m=baseline_v,
                         calibration=_calibration(path, tables, positions), **values)


def _known_only(path: Path, tables: dict[str, Any]) -> None:
    known: dict[str, set[str]] = {table: set(keys) | set(OPTIONAL.get(table, ())) for table, keys in LIMITS.items()}
    known["sonar"] |= TEXTS
    known["positions_m"] = set(ROLES)
    known["baselines_m"] = {"horizontal", "vertical"}
    known["calibration"] = set(ROLES) - {"left"}
    for table, keys in tables.items():
        if table not in known:
            raise UsageError(f"{path}: unknown table [{table}]: known are {', '.join(sorted(known))}")
        if not isinstance(keys, dict):
            raise UsageError(f"{path}: {table} is {keys!r}: it must be a table, [{table}]")
        for key in keys:
            if key not in known[table]:
                raise UsageError(f"{path}: unknown key {table}.{key}: known are "
                                 f"{', '.join(sorted(known[table]))}")
    for table in known:
        optional = {"calibration"} | ({"baselines_m"} if set(tables.get("positions_m", ())) == {"left"} else set())
        if table not in tables and table not in optional:
            raise UsageError(f"{path}: table [{table}] is missing: copy it from fixtures/sonars/pair.toml")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _number(path: Path, tables: dict[str, Any], table: str, key: str, low: float, high: float) -> Any:
    if key not in tables[table]:
        raise UsageError(f"{path}: {table}.{key} is missing: give a number in {low:g}..{high:g}")
    value = tables[table][key]
    if not _is_number(value) or not low <= value <= high:
        raise UsageError(f"{path}: {table}.{key} is {value!r}: it must be a number in {low:g}..{high:g}")
    if key not in INTEGERS:
        return float(value)
    if not isinstance(value, int):
        raise UsageError(f"{path}: {table}.{key} is {value!r}: it must be a whole number in "
                         f"{low:g}..{high:g}")
    return value


def _position(path: Path, tables: dict[str, Any], role: str) -> tuple[float, float, float]:
    value = tables["positions_m"][role]
    if (not isinstance(value, list) or len(value) != 3
            or not all(_is_number(v) and abs(v) <= POSITION_LIMIT_M for v in value)):
        raise UsageError(f"{path}: positions_m.{role} is {value!r}: it must be [x, y, z] in metres, each "
                         "within "
                         f"{POSITION_LIMIT_M:g} m of the centre")
    return (float(value[0]), float(value[1]), float(value[2]))


def _calibration(path: Path, tables: dict[str, Any],
                 positions: dict[str, tuple[float, float, float]]) -> dict[str, SensorCalibration]:
    """The optional tables [calibration.ROLE], complete where they are given."""
    found = {}
    for role, keys in tables.get("calibration", {}).items():
        table = f"calibration.{role}"
        if role not in positions:
            raise UsageError(f"{path}: [{table}] is of a sensor that [positions_m] does not have: remove it")
        if not isinstance(keys, dict) or set(keys) - set(CALIBRATION_LIMITS):
            raise UsageError(f"{path}: {table} is {keys!r}: it must be a table of "
                             f"{' and '.join(CALIBRATION_LIMITS)}")
        values = {key: _number(path, {table: keys}, table, key, *limits)
                  for key, limits in CALIBRATION_LIMITS.items()}
        found[role] = SensorCalibration(**values)
    return found


def _baselines(path: Path, tables: dict[str, Any],
               positions: dict[str, tuple[float, float, float]]) -> tuple[float, float]:
    """Baselines from the positions, checked against what the file says and what localisation assumes."""
    for role in ("left", "right"):
        if role not in positions and set(positions) != {"left"}:
            raise UsageError(f"{path}: positions_m.{role} is missing: the left and the right sensor are "
                             "required (or left alone, a single sensor)")
    if "right" not in positions:
        if tables.get("baselines_m"):
            raise UsageError(f"{path}: positions_m.right is missing, but baselines_m is {tables['baselines_m']!r}: add "
                             "the sensor, or remove [baselines_m] of a single sensor")
        return 0.0, 0.0
    left, right, down = positions["left"], positions["right"], positions.get("down")
    span_h = right[1] - left[1]
    span_v = down[2] - left[2] if down else 0.0
    stated = tables["baselines_m"]
    checks = [("horizontal", "right", 1, span_h)] + ([("vertical", "down", 2, span_v)] if down else [])
    if not down and "vertical" in stated:
        raise UsageError(f"{path}: baselines_m.vertical is {stated['vertical']!r} without positions_m.down: "
                         "remove it or add the sensor")
    for key, role, axis, span in checks:
        strays = [abs(a - b) for i, (a, b) in enumerate(zip(positions[role], left, strict=True)) if i != axis]
        if span < 0.01 or max(strays) > BASELINE_TOLERANCE_M:
            side = "right of" if axis == 1 else "below"
            raise UsageError(f"{path}: positions_m.{role} is {list(positions[role])}: localisation needs it "
                             "straight "
                             f"{side} the left sensor, {list(left)}, by at least 0.01 m")
        value = stated.get(key)
        if not _is_number(value) or abs(value - span) > BASELINE_TOLERANCE_M:
            raise UsageError(f"{path}: baselines_m.{key} is {value!r}: [positions_m] put the sensors "
                             f"{span:.4f} m "
                             "apart; make them agree")
    return span_h, span_v
