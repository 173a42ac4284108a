"""Recipes: what training pairs are drawn from, as data (`fixtures/synthesis/*.toml`).

A recipe is complete: every key must be there, so that a file says all about its pairs. `KEYS` is the one place that
says what a key means and may be.
"""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from saranga.plugins import nearest_hint
from saranga.synthesis.paths import KINDS, PATHS

MOST_OBSTACLES = 4


@dataclass(frozen=True)
class Key:
    """What a key may be: "range" [low, high], "number", "whole", "weights", "choice", "flag", "text", "responses"."""

    kind: str
    low: float = 0.0
    high: float = 1.0
    choices: tuple[str, ...] = ()
    length: int = 0


def _weights(names: tuple[str, ...]) -> dict[str, Key]:
    return {name: Key("number", 0.0, 1e6) for name in names}


KEYS: dict[str, dict[str, Key]] = {
    "recipe": {"name": Key("text"), "description": Key("text"), "sonar": Key("text")},
    "paths": _weights(PATHS),
    "motion": {
        "closing_m_s": Key("range", -7.0, 7.0), "sideways_m_s": Key("range", -7.0, 7.0),
        "acceleration_m_s2": Key("range", -20.0, 20.0), "turn_radius_m": Key("range", 0.1, 1e3),
        "sway_m": Key("range", 0.0, 0.5), "sway_hz": Key("range", 0.0, 20.0), "jitter_m": Key("range", 0.0, 0.02),
        "doppler": Key("flag"),
    },
    "cosine": {"a_m": Key("range", 0.0, 3.0), "b_m": Key("range", 0.0, 3.0), "omega_rad_s": Key("range", 0.0, 50.0)},
    "obstacles": {
        "count_weights": Key("weights", 0.0, 1e6, length=MOST_OBSTACLES + 1), "range_m": Key("range", 0.05, 1.66),
        "azimuth_deg": Key("range", -85.0, 85.0), "elevation_deg": Key("range", -60.0, 60.0),
        "cylinder_radius_m": Key("range", 0.001, 2.0), "point_radius_m": Key("range", 0.0005, 0.5),
        "edge_angle_deg": Key("range", 0.0, 85.0), "reflectivity_db": Key("range", -60.0, 20.0),
        "fading_db": Key("range", 0.0, 10.0), "partial_probability": Key("number", 0.0, 1.0),
    },
    "kinds": _weights(KINDS),
    "air": {"absorption_db_m": Key("range", 0.0, 5.0), "temperature_c": Key("number", -40.0, 60.0),
            "directivity": Key("flag")},
    "echo": {"bandwidth_hz": Key("range", 500.0, 20_000.0), "bands": Key("whole", 1, 64),
             "responses": Key("responses")},
    "noise": {
        "psnr_db": Key("range", -30.0, 60.0), "psnr_reference": Key("choice", choices=("newest", "image")),
        "level_counts": Key("range", 1.0, 20_000.0), "drift_db": Key("range", -20.0, 20.0),
        "bank_rows": Key("whole", 16, 65_536), "speckle_probability": Key("number", 0.0, 1.0),
        "speckle_multiplicative": Key("range", 0.0, 3.0), "own_band_probability": Key("number", 0.0, 1.0),
    },
    "rows": {"lost_probability": Key("number", 0.0, 0.5), "start_probability": Key("number", 0.0, 1.0)},
    "ring_down": {"probability": Key("number", 0.0, 1.0), "gain_db": Key("range", -60.0, 40.0)},
    "image": {"scale": Key("choice", choices=("full_scale", "free")), "saturation": Key("flag")},
    "label": {"rule": Key("choice", choices=("each", "merged")), "merge_level": Key("number", 0.01, 0.99),
              "blur_columns": Key("number", 0.0, 16.0), "least_snr_db": Key("number", -200.0, 60.0)},
}


@dataclass(frozen=True)
class Recipe:
    """A validated recipe: `tables[table][key]`, ranges as (low, high) tuples of floats."""

    name: str
    description: str
    source: str
    tables: dict[str, dict[str, Any]]

    def __getitem__(self, table: str) -> dict[str, Any]:
        return self.tables[table]

    @property
    def sha256(self) -> str:
        """Of the values, whatever the order, layout and comments of the file."""
        return hashlib.sha256(json.dumps(self.tables, sort_keys=True).encode()).hexdigest()

    def with_values(self, values: dict[str, Any]) -> "Recipe":
        """A copy with `{"table.key": value}` changed.

        Raises:
            UsageError: an unknown key, or a value out of its limits.
        """
        tables = {table: dict(keys) for table, keys in self.tables.items()}
        for dotted, value in values.items():
            table, _, key = dotted.partition(".")
            if key not in KEYS.get(table, {}):
                known = [f"{t}.{k}" for t, keys in KEYS.items() for k in keys]
                raise UsageError(f"unknown recipe value {dotted!r}{nearest_hint(dotted, known)}: give TABLE.KEY "
                                 "as in fixtures/synthesis/default.toml")
            tables[table][key] = value
        return parse_recipe(tables, self.source)


def load_recipe(name: str) -> Recipe:
    """Load a recipe by fixture name ("default", "paper") or path of a TOML file.

    Raises:
        UsageError: unknown name, malformed file, unknown or missing key, or a value out of its limits.
    """
    path = fixture_path("synthesis", name)
    return parse_recipe(load_toml(path), str(path))


def parse_recipe(tables: dict[str, Any], source: str) -> Recipe:
    """Check tables as read from TOML; `source` is named in errors.

    Raises:
        UsageError: see `load_recipe`.
    """
    for table in tables:
        if table not in KEYS:
            raise UsageError(f"{source}: unknown table [{table}]{nearest_hint(table, list(KEYS))}: known are "
                             f"{', '.join(KEYS)}")
    checked: dict[str, dict[str, Any]] = {}
    for table, keys in KEYS.items():
        given = tables.get(table)
        if not isinstance(given, dict):
            raise UsageError(f"{source}: table [{table}] is missing: copy it from fixtures/synthesis/default.toml")
        for key in given:
            if key not in keys:
                raise UsageError(f"{source}: unknown key {table}.{key}{nearest_hint(key, list(keys))}: known are "
                                 f"{', '.join(keys)}")
        for key in keys:
            if key not in given:
                raise UsageError(f"{source}: {table}.{key} is missing: copy it from fixtures/synthesis/default.toml")
        checked[table] = {key: _value(f"{source}: {table}.{key}", given[key], rule) for key, rule in keys.items()}
    for table in ("paths", "kinds"):
        if sum(checked[table].values()) <= 0.0:
            raise UsageError(f"{source}: [{table}] has no weight above 0: give one to at least one of "
                             f"{', '.join(KEYS[table])}")
    a, b = checked["cosine"]["a_m"], checked["cosine"]["b_m"]
    if checked["paths"]["cosine"] > 0.0 and a[0] - b[1] < 0.0:
        raise UsageError(f"{source}: cosine.b_m goes up to {b[1]:g} m, more than the least cosine.a_m, {a[0]:g} m: "
                         "the range a + b cos must stay above 0; lower b_m")
    return Recipe(checked["recipe"]["name"], checked["recipe"]["description"], source, checked)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _inside(value: Any, rule: Key) -> bool:
    return _is_number(value) and rule.low <= value <= rule.high


def _value(what: str, value: Any, rule: Key) -> Any:
    limits = f"{rule.low:g}..{rule.high:g}"
    if rule.kind == "number":
        if not _inside(value, rule):
            raise UsageError(f"{what} is {value!r}: it must be a number in {limits}")
        return float(value)
    if rule.kind == "whole":
        if not _inside(value, rule) or not isinstance(value, int):
            raise UsageError(f"{what} is {value!r}: it must be a whole number in {limits}")
        return value
    if rule.kind == "range":
        if not isinstance(value, list | tuple) or len(value) != 2 or not all(_inside(v, rule) for v in value):
            raise UsageError(f"{what} is {value!r}: it must be [low, high] within {limits}")
        if value[0] > value[1]:
            raise UsageError(f"{what} is {list(value)!r}: low must not exceed high; swap them")
        return (float(value[0]), float(value[1]))
    if rule.kind == "weights":
        if (not isinstance(value, list | tuple) or len(value) != rule.length
                or not all(_inside(v, rule) for v in value) or sum(value) <= 0.0):
            raise UsageError(f"{what} is {value!r}: it must be {rule.length} weights of at least 0, not all 0")
        return tuple(float(v) for v in value)
    if rule.kind == "choice":
        if value not in rule.choices:
            raise UsageError(f"{what} is {value!r}: it must be one of {', '.join(rule.choices)}")
        return value
    if rule.kind == "flag":
        if not isinstance(value, bool):
            raise UsageError(f"{what} is {value!r}: it must be true or false")
        return value
    if rule.kind == "text":
        if not isinstance(value, str) or not value:
            raise UsageError(f"{what} is {value!r}: it must be a text")
        return value
    return _responses(what, value)


def _responses(what: str, value: Any) -> list[dict[str, Any]]:
    """[{name, taps = [[range_m, level_db, phase_deg], ...]} or {name, file}, ...]."""
    if not isinstance(value, list | tuple) or not value:
        raise UsageError(f"{what} is {value!r}: it must be at least one table with name and taps or file")
    out: list[dict[str, Any]] = []
    for k, entry in enumerate(value):
        here = f"{what}[{k}]"
        if not isinstance(entry, dict) or not isinstance(entry.get("name"), str) or \
                set(entry) not in ({"name", "taps"}, {"name", "file"}):
            raise UsageError(f"{here} is {entry!r}: it must have name and either taps or file")
        if "file" in entry:
            if not isinstance(entry["file"], str) or not Path(entry["file"]).expanduser().is_file():
                raise UsageError(f"{here}.file is {entry['file']!r}: there is no such file; give a recording of one "
                                 "echo (.npz, .npy or .mcap)")
            out.append(dict(entry))
            continue
        taps = entry["taps"]
        good = isinstance(taps, list | tuple) and taps and all(
            isinstance(t, list | tuple) and len(t) == 3 and all(map(_is_number, t))
            and 0.0 <= t[0] <= 0.2 and -80.0 <= t[1] <= 0.0 for t in taps)
        if not good or taps[0][0] != 0.0:
            raise UsageError(f"{here}.taps is {taps!r}: it must be [[range_m 0..0.2, level_db -80..0, phase_deg], ...] "
                             "whose first is at 0 m, the leading edge")
        out.append({"name": entry["name"], "taps": [[float(v) for v in t] for t in taps]})
    return out
