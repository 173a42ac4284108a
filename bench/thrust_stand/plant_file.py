"""Parameters of an emulated motor and propeller: `fixtures/thrust/*.toml`, written by `fitting.py`."""

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from sitl.validation import NotNegative, Positive, Table, _tuple, validate

Numbers = Annotated[tuple[float, ...], BeforeValidator(_tuple), Field(min_length=1, max_length=8)]


class Source(Table):
    """Where it comes from: `files` of the sweeps, how well the fit reproduces them (RMS, relative)."""

    name: str
    description: str
    files: Annotated[tuple[str, ...], BeforeValidator(_tuple)]
    licence: str
    rotation_rms: NotNegative
    thrust_rms_of_max: NotNegative
    power_rms: NotNegative


class Propeller(Table):
    """Thrust and torque over rpm^2."""

    diameter_m: Positive
    blades: Annotated[int, Field(ge=1, le=12)]
    thrust_n_per_rpm2: Positive
    torque_n_m_per_rpm2: Positive


class Motor(Table):
    """`rpm_per_v`: coefficients of f(throttle), constant first. Time constants of the speed, up and down."""

    rpm_per_v: Numbers
    droop_per_rpm: NotNegative
    start_throttle: Annotated[float, Field(ge=0.0, lt=1.0)]
    poles: Annotated[int, Field(ge=2, le=60)]
    rotor_inertia_kg_m2: Positive
    spin_up_s: Annotated[float, Field(ge=0.005, le=5.0)]
    spin_down_s: Annotated[float, Field(ge=0.005, le=5.0)]


class Power(Table):
    """Electrical power: coefficients over (rpm / 10 000), constant first, and with the motor standing."""

    w: Numbers
    idle_w: NotNegative


class Supply(Table):
    """The bench supply of the sweep."""

    voltage_v: Positive
    resistance_ohm: Positive
    current_limit_a: Positive


class Heat(Table):
    """Heat capacities and cooling."""

    motor_j_k: Positive
    motor_still_w_k: Positive
    motor_w_k_per_10000_rpm: NotNegative
    esc_j_k: Positive
    esc_w_k: Positive
    esc_resistance_ohm: NotNegative
    esc_share: NotNegative


class Vibration(Table):
    """RMS acceleration of the stand: floor and what the propeller adds with rpm^2."""

    floor_m_s2: NotNegative
    m_s2_per_10000_rpm_squared: NotNegative


class PlantParameters(Table):
    """All of it."""

    source: Source
    propeller: Propeller
    motor: Motor
    power: Power
    supply: Supply
    heat: Heat
    vibration: Vibration

    @property
    def name(self) -> str:
        return self.source.name


TABLES: dict[str, type[Table]] = {"source": Source, "propeller": Propeller, "motor": Motor, "power": Power,
                                  "supply": Supply, "heat": Heat, "vibration": Vibration}


def load_plant_file(name: str) -> PlantParameters:
    """Read a plant by fixture name or path.

    Raises:
        UsageError: unknown name, malformed file, a missing key, or a value outside its limits.
    """
    path = fixture_path("thrust", name)
    return check_plant(load_toml(path), path)


def check_plant(tables: dict[str, object], path: Path) -> PlantParameters:
    """The parameters, checked table by table so that a fault names its table."""
    for key, model in TABLES.items():
        if key not in tables:
            raise UsageError(f"{path}: table [{key}] is missing; compare with fixtures/thrust/g1.toml")
        validate(model, tables[key], f"{path}: [{key}]")
    return validate(PlantParameters, tables, f"{path}:")
