"""Plans: what a bench procedure does, as a TOML file checked before anything moves.

`procedure` picks the kind: "noise" (motor, sensor in receive-only mode, conditions to compare), "beam" (a pole at
places), "echo" (one obstacle, propellers off).
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from sitl.validation import NotNegative, Positive, Table, known_key, validate


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Numbers = Annotated[tuple[float, ...], BeforeValidator(_tuple)]
Role = Literal["left", "right", "down"]
Metadata = dict[str, str | int | float | bool]
Short = Annotated[str, Field(min_length=1, max_length=80)]


class Condition(Table):
    """One way the bench stands: what is mounted where. `reference`: the unshielded one that losses are taken from."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,39}$")]
    shield: Short = "none"
    reference: bool = False
    mount: str = ""
    propeller: str = ""
    hub_distance_m: Positive | None = None
    height_m: Positive | None = None
    width_m: Positive | None = None
    material: str = ""


class Levels(Table):
    """Where to measure: throttles (0..1) or thrusts of one motor, which the sweep then seeks by the throttle."""

    throttles: Numbers = ()
    thrusts_n: Numbers = ()

    @model_validator(mode="after")
    def _one_kind(self) -> "Levels":
        if bool(self.throttles) == bool(self.thrusts_n):
            raise ValueError("give throttles or thrusts_n, one of them and not empty: an empty sweep measures nothing")
        values = self.values
        if any(v <= 0.0 for v in values) or len(set(values)) < len(values):
            raise ValueError("levels must be over 0 and all different (the motor-off background is measured anyway)")
        if self.throttles and max(values) > 1.0:
            raise ValueError("throttles go from 0 to 1")
        return self

    @property
    def values(self) -> tuple[float, ...]:
        """Whichever was given."""
        return self.throttles or self.thrusts_n

    @property
    def by_thrust(self) -> bool:
        """Whether the levels are thrusts."""
        return bool(self.thrusts_n)


class RigSettings(Table):
    """How the sensors listen. `sensor`: the one that the headline figures are of."""

    sensor: Role = "left"
    frames: Annotated[int, Field(ge=10, le=100_000)] = 100
    rate_hz: Annotated[float, Field(gt=0, le=200)] = 60.0
    odr: Annotated[int, Field(ge=2, le=6)] = 6
    samples: Annotated[int, Field(ge=32, le=680)] = 256
    skip_samples: Annotated[int, Field(ge=1, le=600)] = 20

    @model_validator(mode="after")
    def _something_left(self) -> "RigSettings":
        if self.samples - self.skip_samples < 16:
            raise ValueError("samples less skip_samples must leave at least 16")
        return self


class Settle(Table):
    """When a step may begin: see `bench.procedures.settling`."""

    least_s: NotNegative = 1.0
    most_s: Positive = 8.0
    window_s: Positive = 1.0
    per_second: Positive = 0.02
    floor_n: Positive = 0.03

    @model_validator(mode="after")
    def _ordered(self) -> "Settle":
        if self.most_s <= max(self.least_s, self.window_s):
            raise ValueError("most_s must exceed least_s and window_s")
        return self


class PlanLimits(Table):
    """What the supervisor trips at. A quantity that the stand claims to measure and that has a limit trips on NaN."""

    throttle: Annotated[float, Field(gt=0, le=1)]
    thrust_n: Positive
    slew_per_s: Positive = 1.0
    current_a: Positive | None = None
    voltage_low_v: Positive | None = None
    rpm: Positive | None = None
    esc_temperature_c: Positive | None = None
    motor_temperature_c: Positive | None = None
    vibration_m_s2: Positive | None = None


class WarmUp(Table):
    """Spinning before the first block."""

    throttle: Annotated[float, Field(ge=0, le=1)] = 0.0
    duration_s: NotNegative = 0.0


class NoisePlan(Table):
    """Noise against thrust under one or more conditions, in blocks."""

    name: Short
    description: str = ""
    procedure: Literal["noise"] = "noise"
    blocks: Annotated[int, Field(ge=1, le=100)] = 3
    seed: Annotated[int, Field(ge=0)] = 1
    order: Literal["mounting", "full"] = "mounting"
    drift_check: bool = True
    mount_s: NotNegative = 60.0
    levels: Levels
    rig: RigSettings = RigSettings()
    settle: Settle = Settle()
    limits: PlanLimits
    warm_up: WarmUp = WarmUp()
    hub_distance_m: Positive = 0.0701
    conditions: Annotated[tuple[Condition, ...], BeforeValidator(_tuple), Field(min_length=1)]
    metadata: Metadata = Field(default_factory=dict)

    @model_validator(mode="after")
    def _sound(self) -> "NoisePlan":
        names = [c.name for c in self.conditions]
        if len(set(names)) < len(names):
            raise ValueError("conditions must have different names")
        if sum(c.reference for c in self.conditions) > 1:
            raise ValueError("at most one condition may be the reference")
        bad = [c.name for c in self.conditions if c.reference and c.shield != "none"]
        if bad:
            raise ValueError(f"the reference {bad[0]!r} must be unshielded: losses are taken from it")
        most = self.limits.thrust_n if self.levels.by_thrust else self.limits.throttle
        over = [v for v in self.levels.values if v > most]
        if over:
            what = "thrust_n" if self.levels.by_thrust else "throttle"
            raise ValueError(f"level {max(over):g} is beyond limits.{what} = {most:g}: lower the level, or raise the "
                             "limit if the motor, stand and guard are made for it")
        if self.warm_up.throttle > self.limits.throttle:
            raise ValueError(f"warm_up.throttle {self.warm_up.throttle:g} is beyond limits.throttle = "
                             f"{self.limits.throttle:g}")
        return self

    @property
    def reference(self) -> Condition | None:
        """The unshielded condition, None where the plan has none."""
        return next((c for c in self.conditions if c.reference), None)

    def condition(self, name: str) -> Condition:
        """By name."""
        return next(c for c in self.conditions if c.name == name)


class BeamPlan(Table):
    """Echo of a pole at distances and azimuths: the paper's Fig. S3."""

    name: Short
    description: str = ""
    procedure: Literal["beam"] = "beam"
    distances_m: Annotated[Numbers, Field(min_length=1)]
    azimuths_deg: Annotated[Numbers, Field(min_length=1)]
    pole_diameter_m: Positive = 0.060
    window_m: Positive = 0.10
    repeats: Annotated[int, Field(ge=1, le=20)] = 1
    seed: Annotated[int, Field(ge=0)] = 1
    mount_s: NotNegative = 20.0
    rig: RigSettings = RigSettings()
    metadata: Metadata = Field(default_factory=dict)

    @model_validator(mode="after")
    def _in_front(self) -> "BeamPlan":
        if min(self.distances_m) <= 0.15:
            raise ValueError("distances_m must exceed 0.15 m, where the transmitter still rings")
        if max(abs(a) for a in self.azimuths_deg) > 90.0:
            raise ValueError("azimuths_deg must lie within -90..90")
        return self


class EchoPlan(Table):
    """A recorded echo R of one object, propellers off, for `python -m saranga synthesise`."""

    name: Short
    description: str = ""
    procedure: Literal["echo"] = "echo"
    object: Short
    distance_m: Annotated[float, Field(gt=0.2, le=5.0)] = 1.0
    tolerance_m: Positive = 0.10
    mount_s: NotNegative = 20.0
    rig: RigSettings = RigSettings()
    metadata: Metadata = Field(default_factory=dict)


Plan = NoisePlan | BeamPlan | EchoPlan
KINDS: dict[str, type[NoisePlan] | type[BeamPlan] | type[EchoPlan]] = {
    "noise": NoisePlan, "beam": BeamPlan, "echo": EchoPlan}
PARTS: dict[str, type[Table]] = {"levels": Levels, "rig": RigSettings, "settle": Settle, "limits": PlanLimits,
                                 "warm_up": WarmUp}


def load_plan(name_or_path: str) -> Plan:
    """A plan by its name in fixtures/plans, or by path.

    Raises:
        UsageError: unknown name, malformed file, unknown key, or a value out of its limits; names key, value and limit.
    """
    path = fixture_path("plans", name_or_path)
    return plan_from_tables(load_toml(path), str(path))


def load_noise_plan(name_or_path: str) -> NoisePlan:
    """A plan of a noise sweep.

    Raises:
        UsageError: as `load_plan`, or a plan of another kind.
    """
    plan = load_plan(name_or_path)
    if not isinstance(plan, NoisePlan):
        command = {"beam": "saranga-bench beam", "echo": "saranga-bench reference-echo"}[plan.procedure]
        raise UsageError(f"plan {name_or_path!r} is of procedure {plan.procedure!r}: run it with {command}")
    return plan


def plan_from_tables(tables: dict[str, Any], where: str) -> Plan:
    """A plan from parsed TOML (or from a journal's header)."""
    kind = tables.get("procedure", "noise")
    if not isinstance(kind, str):
        raise UsageError(f"{where}: procedure = {kind!r} must be a text; correct the file")
    known_key(kind, list(KINDS), f"{where}: procedure")
    _check_parts(tables, KINDS[kind], where)
    return validate(KINDS[kind], _checked_numbers(tables, where), f"{where}:")


def plan_file(name_or_path: str) -> Path:
    """Where a plan lies."""
    return fixture_path("plans", name_or_path)


def _check_parts(tables: dict[str, Any], model: type[Table], where: str) -> None:
    """Each table by itself first, so that a fault names its table."""
    for key, part in PARTS.items():
        if key in tables and key in model.model_fields:
            validate(part, tables[key], f"{where}: [{key}]")
    conditions = tables.get("conditions")
    if isinstance(conditions, list):
        for number, table in enumerate(conditions, start=1):
            validate(Condition, table, f"{where}: [[conditions]] {number}:")


def _checked_numbers(tables: dict[str, Any], where: str) -> dict[str, Any]:
    """Metadata goes through a journal as JSON: NaN would stop it there."""
    for key, value in (tables.get("metadata") or {}).items() if isinstance(tables.get("metadata"), dict) else ():
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"{where}: metadata.{key} = {value}: must be a finite number; leave out what is not known")
    return tables
