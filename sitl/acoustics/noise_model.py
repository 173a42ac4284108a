"""A shield as the thrust bench measured it: noise at one sensor against the thrust of one motor, and the file of it.

A bench sweep (receive-only sensor, one propeller) yields RMS |IQ| over 20000 against thrust, without and with the
shield (hardware.md, "Noise experiment"). A flight takes from it

- with a reference of the same session: the insertion loss at each motor's thrust, as if the shield stood between every
  motor and every sensor as it stood on the bench; how loud the bare propeller is stays that of the airframe
  (`rotor_noise.py`), so gain and placement of the bench sensor drop out;
- without one: the level itself, 1 / distance^2 in power from the bench's hub to each of the airframe's hubs.

Between swept thrusts values are interpolated linearly. Outside nothing was measured: the insertion loss stays that of
the nearest end, the level follows T^1.25 from it, and how much of a flight lay there is counted and told. A sweep whose
ends are further than SWEPT_MARGIN from the hover thrust of the airframe is refused.
"""

import json
import math
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from saranga.errors import UsageError
from saranga.fixtures import load_toml
from sitl.validation import Table, validate

Floats = NDArray[np.float64]
Origin = Literal["measured", "emulated", "recorded", "simulated"]
TABLE = "noise_model"
SWEPT_MARGIN = 0.25
"""Part of its end value by which a sweep may miss the hover thrust before a flight refuses it."""
THRUST_EXPONENT = 1.25
"""Of the RMS pressure with thrust outside the sweep, as in `rotor_noise.py`."""
LOUDEST_RMS = 1.2
"""|IQ| of a saturated sensor is 1.05 full scales: no RMS can be more."""
LARGEST_LOSS_DB = 80.0
SMALLEST_LOSS_DB = -20.0
"""Insertion loss: a bad mounting can make it louder; beyond these it is no measurement."""


@dataclass(frozen=True)
class NoiseModel:
    """Noise behind one shield against thrust. All tuples have the length of `thrust_n`; checked when made.

    Attributes:
        origin: what stood at the other end. A number is never better than this.
        source: run id, date, propeller, sensor: one line for people.
        thrust_n: of one motor, increasing, at least two.
        noise_rms: RMS |IQ| / 20000 of the shielded sensor at these, power of the background taken off.
        reference_rms: unshielded at the same thrusts, same session; None where it was not measured.
        insertion_loss_db: 20 log10(reference / noise) at equal thrust; needs the reference. Made from the two where
            it is left out.
        interval_low_db, interval_high_db: 95 % of it, both or none.
        hub_distance_m: propeller hub to sensor on the bench.

    Raises:
        UsageError: a value that no measurement can be; names it and what is allowed.
    """

    name: str
    description: str
    origin: Origin
    source: str
    thrust_n: tuple[float, ...]
    noise_rms: tuple[float, ...]
    hub_distance_m: float
    reference_rms: tuple[float, ...] | None = None
    insertion_loss_db: tuple[float, ...] | None = None
    interval_low_db: tuple[float, ...] | None = None
    interval_high_db: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _check(self)
        if self.insertion_loss_db is None and self.reference_rms is not None:
            loss = tuple(20.0 * math.log10(r / n) for r, n in zip(self.reference_rms, self.noise_rms, strict=True))
            object.__setattr__(self, "insertion_loss_db", loss)
            _check_losses(self)

    @property
    def swept_n(self) -> tuple[float, float]:
        """Smallest and largest thrust of the sweep."""
        return self.thrust_n[0], self.thrust_n[-1]

    def loss_at_db(self, thrust_n: Floats) -> Floats:
        """Insertion loss at each motor's thrust, of any shape; that of the nearest end outside the sweep.

        Raises:
            UsageError: the model has no reference.
        """
        if self.insertion_loss_db is None:
            raise UsageError(f"noise model {self.name!r} has no insertion loss: it was swept without a reference")
        return np.interp(thrust_n, self.thrust_n, self.insertion_loss_db)

    def rms_at(self, thrust_n: Floats) -> Floats:
        """RMS |IQ| / 20000 at the bench's distance for each motor's thrust; T^1.25 beyond either end, 0 at 0."""
        low, high = self.swept_n
        inside = np.clip(thrust_n, low, high)
        beyond = (np.maximum(thrust_n, 0.0) / inside) ** THRUST_EXPONENT
        return np.interp(inside, self.thrust_n, self.noise_rms) * beyond

    def outside(self, thrust_n: Floats) -> NDArray[np.bool_]:
        """Where nothing was measured."""
        low, high = self.swept_n
        return (thrust_n < low) | (thrust_n > high)

    def check_covers(self, hover_n: float) -> None:
        """Refuse to fly on a sweep that says nothing about hovering.

        Raises:
            UsageError: `hover_n`, the thrust of one motor at hover, lies too far outside the sweep.
        """
        low, high = self.swept_n
        if not low * (1.0 - SWEPT_MARGIN) <= hover_n <= high * (1.0 + SWEPT_MARGIN):
            raise UsageError(f"noise model {self.name!r} was swept from {low:.3g} to {high:.3g} N a motor, but "
                             f"hovering takes {hover_n:.3g} N: a flight on it would be extrapolation; sweep to "
                             f"at least {hover_n:.3g} N")

    def provenance(self) -> dict[str, Any]:
        """What a report must say of it: origin, source, swept thrusts and how it is applied."""
        return {"name": self.name, "origin": self.origin, "source": self.source, "swept_n": list(self.swept_n),
                "applied": "insertion loss at each motor's thrust" if self.insertion_loss_db is not None
                else f"level, 1/distance^2 from {self.hub_distance_m:g} m"}


class _File(Table):
    """Types of table [noise_model]; the values are checked by NoiseModel itself."""

    name: str = Field(min_length=1)
    description: str
    origin: Origin
    source: str
    hub_distance_m: float
    thrust_n: list[float]
    noise_rms: list[float]
    reference_rms: list[float] | None = None
    insertion_loss_db: list[float] | None = None
    interval_low_db: list[float] | None = None
    interval_high_db: list[float] | None = None


def load_noise_model(path: Path | str) -> NoiseModel:
    """Read and check one file.

    Raises:
        UsageError: missing, malformed, or with a value out of its limits; names file, key, value and limit.
    """
    path = Path(path)
    return model_from_tables(load_toml(path), path)


def model_from_tables(tables: dict[str, Any], path: Path) -> NoiseModel:
    """The model of a parsed file; `path` is for the messages.

    Raises:
        UsageError: as `load_noise_model`.
    """
    extra = sorted(set(tables) - {TABLE})
    if extra or TABLE not in tables:
        raise UsageError(f"{path}: must hold one table [{TABLE}]" + (f", not {extra[0]!r} beside it" if extra else ""))
    held = validate(_File, tables[TABLE], f"{path}: [{TABLE}]")
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value
                              for key, value in dict(held).items()}
    try:
        return NoiseModel(**values)
    except UsageError as error:
        raise UsageError(f"{path}: {error}; correct the file or sweep again") from None


def save_noise_model(model: NoiseModel, path: Path | str) -> Path:
    """Write as TOML, whole or not at all; reads back as the same model. Returns the path.

    Raises:
        UsageError: the file cannot be written.
    """
    path = Path(path)
    lines = [f"# Noise behind a shield against the thrust of one motor ({model.origin}): N, |IQ| / 20000, dB, m.",
             f"[{TABLE}]"]
    for item in fields(model):
        value = getattr(model, item.name)
        if value is not None:
            lines.append(f"{item.name} = {_toml(value)}")
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return part.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}; choose another folder") from error


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(repr(float(v)) for v in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(float(value))


def _check(model: NoiseModel) -> None:
    if not model.name:
        raise UsageError("name is empty: a noise model needs one")
    if model.origin not in get_args(Origin):
        raise UsageError(f"origin is {model.origin!r}: it must be one of {', '.join(get_args(Origin))}")
    thrust = model.thrust_n
    if len(thrust) < 2:
        raise UsageError(f"thrust_n has {len(thrust)} values: a sweep needs at least 2")
    for key in ("thrust_n", "noise_rms", "reference_rms", "insertion_loss_db", "interval_low_db", "interval_high_db"):
        values = getattr(model, key)
        if values is None:
            continue
        if len(values) != len(thrust):
            raise UsageError(f"{key} has {len(values)} values, thrust_n {len(thrust)}: they must be as many")
        for at, value in enumerate(values):
            if not math.isfinite(value):
                raise UsageError(f"{key}[{at}] is {value}: it must be a finite number (leave the point out)")
    for at, (low, high) in enumerate(pairwise(thrust), start=1):
        if high <= low:
            raise UsageError(f"thrust_n[{at}] is {high:g} after {low:g}: it must increase from point to point")
    if thrust[0] <= 0.0:
        raise UsageError(f"thrust_n[0] is {thrust[0]:g} N: it must be over 0 (the background is no point of the sweep)")
    for key in ("noise_rms", "reference_rms"):
        for at, value in enumerate(getattr(model, key) or ()):
            if not 0.0 < value <= LOUDEST_RMS:
                raise UsageError(f"{key}[{at}] is {value:g}: RMS |IQ| / 20000 must be over 0 and at most "
                                 f"{LOUDEST_RMS:g}")
    if not (math.isfinite(model.hub_distance_m) and 0.005 <= model.hub_distance_m <= 2.0):
        raise UsageError(f"hub_distance_m is {model.hub_distance_m:g}: it must be within 0.005..2 m")
    _check_losses(model)


def _check_losses(model: NoiseModel) -> None:
    losses, low, high = model.insertion_loss_db, model.interval_low_db, model.interval_high_db
    if losses is not None and model.reference_rms is None:
        raise UsageError("insertion_loss_db is given without reference_rms: it is the ratio of the two; add "
                         "the reference")
    if (low is None) != (high is None):
        raise UsageError("interval_low_db and interval_high_db belong together: give both or none")
    for at, value in enumerate(losses or ()):
        if not SMALLEST_LOSS_DB <= value <= LARGEST_LOSS_DB:
            raise UsageError(f"insertion_loss_db[{at}] is {value:g}: it must be within {SMALLEST_LOSS_DB:g}.."
                             f"{LARGEST_LOSS_DB:g} dB")
        assert model.reference_rms is not None
        ratio_db = 20.0 * math.log10(model.reference_rms[at] / model.noise_rms[at])
        if abs(value - ratio_db) > 3.0:
            raise UsageError(f"insertion_loss_db[{at}] is {value:g} dB, but reference_rms / noise_rms there is "
                             f"{ratio_db:.1f} dB: they must agree within 3 dB (smoothing)")
    if low is not None and high is not None:
        if losses is None and model.reference_rms is None:
            raise UsageError("interval_low_db is given without reference_rms: there is no insertion loss to bound")
        for at, (a, b) in enumerate(zip(low, high, strict=True)):
            if a > b:
                raise UsageError(f"interval_low_db[{at}] is {a:g}, over interval_high_db, {b:g}: exchange them")
