"""A flat shield between propellers and sensor: what goes around it and what goes through it.

Around: Kurze and Anderson (1971), 5 + 20 log10(sqrt(2 pi N) / tanh sqrt(2 pi N)) dB at Fresnel number
N = 2 delta / lambda, at most 24 dB, summed in power over the four edges. Through: the mass law,
10 log10(1 + (pi f m / rho c)^2) dB. Diffraction dominates: height matters, material hardly (paper, Fig. 6).
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from saranga.fixtures import fixture_names, fixture_path, load_toml
from sitl.acoustics.noise_model import TABLE, NoiseModel, load_noise_model, model_from_tables

LARGEST_DB = 24.0
RUN_FILES = "*noise-model*.toml"
"""Noise models in the folder of a bench run, at any depth."""
Limits = dict[str, dict[str, tuple[float, float] | None]]
LIMITS: Limits = {
    "shield": {"name": None, "description": None},
    "panel": {"width_m": (0.0, 1.0), "height_m": (0.0, 1.0), "behind_sensor_m": (0.001, 0.5),
              "rise_m": (-0.5, 0.5)},
    "material": {"thickness_m": (1e-5, 0.1), "density_kg_m3": (1.0, 20_000.0)},
}
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Shield:
    """One flat shield behind every sensor, square to the body's x axis.

    Attributes:
        width_m, height_m: 0 for no shield; centred on the sensor across, and `rise_m` above it.
        behind_sensor_m: distance of its plane from the sensor, towards the propellers.
        thickness_m, density_kg_m3: of the panel, for the sound that goes through.
    """

    name: str
    description: str
    width_m: float
    height_m: float
    behind_sensor_m: float
    rise_m: float
    thickness_m: float
    density_kg_m3: float

    def provenance(self) -> dict[str, Any]:
        """What a report must say of it."""
        return {"name": self.name, "origin": "simulated", "source": self.description,
                "applied": "diffraction and mass law from its geometry"}

    @property
    def areal_mass_kg_m2(self) -> float:
        """Mass of a square metre of the panel."""
        return self.thickness_m * self.density_kg_m3

    def insertion_loss_db(self, source_m: Point, sensor_m: Point, frequency_hz: float, c_m_s: float,
                          impedance_pa_s_m: float) -> float:
        """What the shield takes from the sound of a point source, dB; positions in body FRD.

        0 without a shield, and for a source that lies in front of its plane.
        """
        plane_x = sensor_m[0] - self.behind_sensor_m
        if self.width_m == 0.0 or self.height_m == 0.0 or source_m[0] >= plane_x:
            return 0.0
        wavelength = c_m_s / frequency_hz
        share = self.behind_sensor_m / (sensor_m[0] - source_m[0])
        cross_y = sensor_m[1] + share * (source_m[1] - sensor_m[1])
        cross_z = sensor_m[2] + share * (source_m[2] - sensor_m[2])
        top, bottom = sensor_m[2] - self.rise_m - self.height_m / 2, sensor_m[2] - self.rise_m + self.height_m / 2
        left, right = sensor_m[1] - self.width_m / 2, sensor_m[1] + self.width_m / 2
        losses: list[float] = []
        lit: list[float] = []
        for depth, edge in ((cross_z - top, (plane_x, cross_y, top)), (bottom - cross_z, (plane_x, cross_y, bottom)),
                            (cross_y - left, (plane_x, left, cross_z)), (right - cross_y, (plane_x, right, cross_z))):
            detour = math.dist(source_m, edge) + math.dist(edge, sensor_m) - math.dist(source_m, sensor_m)
            loss = diffraction_loss_db(math.copysign(2.0 * detour / wavelength, depth))
            (losses if depth >= 0.0 else lit).append(loss)
        if lit:
            return min(lit)
        through = transmission_loss_db(self.areal_mass_kg_m2, frequency_hz, impedance_pa_s_m)
        passed = sum(10.0 ** (-loss / 10.0) for loss in [*losses, through])
        return max(0.0, -10.0 * math.log10(passed))


def diffraction_loss_db(fresnel_number: float) -> float:
    """Kurze-Anderson loss over one edge; negative numbers are rays that clear it (5 dB at grazing, down to 0)."""
    x = math.sqrt(2.0 * math.pi * abs(fresnel_number))
    if x < 1e-6:
        return 5.0
    if fresnel_number >= 0.0:
        return min(LARGEST_DB, 5.0 + 20.0 * math.log10(x / math.tanh(x)))
    if x >= math.pi / 2.0:
        return 0.0
    return max(0.0, 5.0 + 20.0 * math.log10(x / math.tan(x)))


def transmission_loss_db(areal_mass_kg_m2: float, frequency_hz: float, impedance_pa_s_m: float) -> float:
    """Mass law at normal incidence: 10 log10(1 + x^2), x = pi f m / (rho c)."""
    x = math.pi * frequency_hz * areal_mass_kg_m2 / impedance_pa_s_m
    return 10.0 * math.log10(1.0 + x * x)


def shielded_weights(shield: Shield, weights: NDArray[np.float64], hubs_m: tuple[Point, ...], sensor_m: Point,
                     frequency_hz: float, c_m_s: float, impedance_pa_s_m: float) -> NDArray[np.float64]:
    """Noise shares (4,) of the motors behind the shield: `weights` less each motor's insertion loss."""
    losses = [shield.insertion_loss_db(hub, sensor_m, frequency_hz, c_m_s, impedance_pa_s_m) for hub in hubs_m]
    return weights * 10.0 ** (-np.array(losses) / 10.0)


def load_shield(name: str) -> Shield:
    """A shield by its geometry: a name in fixtures/shields, or a path.

    Raises:
        UsageError: as `load_shielding`, and for a file that holds a measurement and no geometry.
    """
    shield = load_shielding(name)
    if not isinstance(shield, Shield):
        raise UsageError(f"shield {name!r} is a {shield.origin} noise model: here the geometry of a shield is needed; "
                         "give a file with [shield], [panel] and [material], or one of "
                         f"{', '.join(fixture_names('shields'))}")
    return shield


def load_shielding(name: str) -> Shield | NoiseModel:
    """Read a shield: its geometry ([shield], [panel], [material]), or a bench's measurement of it ([noise_model]).

    Args:
        name: in fixtures/shields ("none", "foam"), a path of a .toml file, the folder of a bench run with one noise
            model, or RUN:NAME where it holds several.

    Raises:
        UsageError: unknown name (lists the known ones), malformed file, a value out of its limits, a run folder without
            a noise model, or with several of which none was chosen.
    """
    path = shield_path(name)
    tables = load_toml(path)
    return model_from_tables(tables, path) if TABLE in tables else _shield_from_tables(tables, path)


def shield_path(name: str) -> Path:
    """The file that `load_shielding` reads.

    Raises:
        UsageError: as `load_shielding`, as far as finding goes.
    """
    if name in fixture_names("shields"):
        return fixture_path("shields", name)
    whole = Path(name).expanduser()
    if whole.is_dir():
        return _of_run(whole, None)
    folder, colon, chosen = name.rpartition(":")
    if colon and Path(folder).expanduser().is_dir():
        return _of_run(Path(folder).expanduser(), chosen)
    return fixture_path("shields", name)


def _of_run(folder: Path, chosen: str | None) -> Path:
    found = sorted(folder.rglob(RUN_FILES))
    if not found:
        raise UsageError(f"shield {folder}: the folder holds no noise model ({RUN_FILES}): name the folder of a "
                         "finished sweep, or a file")
    if chosen is None and len(found) == 1:
        return found[0]
    names = {load_noise_model(path).name: path for path in found}
    if chosen is None:
        raise UsageError(f"shield {folder}: the run holds {len(found)} noise models: choose one of "
                         f"{', '.join(f'{folder}:{name}' for name in names)}")
    if chosen not in names:
        raise UsageError(f"shield {folder}: the run holds no noise model {chosen!r}: known are {', '.join(names)}")
    return names[chosen]


def _shield_from_tables(tables: dict[str, Any], path: Path) -> Shield:
    values: dict[str, Any] = {}
    for table, keys in LIMITS.items():
        held = tables.get(table)
        if not isinstance(held, dict):
            raise UsageError(f"{path}: table [{table}] is missing: compare with fixtures/shields/foam.toml")
        for key in held:
            if key not in keys:
                raise UsageError(f"{path}: unknown key {table}.{key}: known are {', '.join(keys)}")
        for key, limits in keys.items():
            values[key] = _value(f"{path}: {table}.{key}", held.get(key), limits)
    for table in tables:
        if table not in LIMITS:
            raise UsageError(f"{path}: unknown table [{table}]: known are {', '.join(LIMITS)} or {TABLE}")
    return Shield(**values)


def _value(where: str, value: Any, limits: tuple[float, float] | None) -> str | float:
    if limits is None:
        if not isinstance(value, str):
            raise UsageError(f"{where} is {value!r}: it must be a text; add it")
        return value
    low, high = limits
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise UsageError(f"{where} is {value!r}: it must be a number in {low:g}..{high:g}")
    return float(value)
