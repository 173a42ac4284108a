"""What surfaces send back at 53 kHz, from `fixtures/materials/*.toml`."""

import math
from functools import cache
from typing import Self

from pydantic import Field, model_validator

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from sitl.validation import NotNegative, Positive, Table, validate

WAVENUMBER_RAD_M = 971.0
"""k of 53 kHz in air at 20 C."""
FREQUENCY_HZ = 53_000.0
AIR_IMPEDANCE_PA_S_M = 413.0
"""rho c of air at 20 C."""


class Material(Table):
    """One surface.

    Attributes:
        name, description, source: for people.
        areal_mass_kg_m2: of a thin sheet, which then reflects by the mass law; None for a thick body.
        absorbed: part of the pressure amplitude lost at the surface beyond that.
        roughness_m: standard deviation of the surface height.
        albedo: part of the arriving power that a rough surface scatters in all directions (Lambert,
            `sitl.acoustics.scatter`); what is absorbed or mirrored cannot be scattered as well.
        flutter_m: how far a film swings at 1 m from a hovering vehicle (`sitl.acoustics.flutter`).
    """

    name: str
    description: str
    source: str
    areal_mass_kg_m2: Positive | None = None
    absorbed: float = Field(default=0.0, ge=0.0, le=1.0)
    roughness_m: NotNegative = 0.0
    albedo: float = Field(default=0.0, ge=0.0, le=1.0)
    flutter_m: float = Field(default=0.0, ge=0.0, le=0.05)

    @model_validator(mode="after")
    def _keeps_energy(self) -> Self:
        left = self._returned**2 * (1.0 - self._coherent**2)
        if self.albedo > left + 1e-9:
            raise ValueError(f"albedo = {self.albedo:g}, but roughness and absorption leave {left:.3g} of the power to "
                             "scatter")
        return self

    @property
    def _returned(self) -> float:
        """Amplitude that neither passes nor is absorbed: mass law |R| = x / sqrt(1 + x^2), x = pi f m / (rho c)."""
        sheet = 1.0
        if self.areal_mass_kg_m2 is not None:
            x = math.pi * FREQUENCY_HZ * self.areal_mass_kg_m2 / AIR_IMPEDANCE_PA_S_M
            sheet = x / math.hypot(1.0, x)
        return sheet * (1.0 - self.absorbed)

    @property
    def _coherent(self) -> float:
        """Part of the amplitude that a rough surface mirrors at normal incidence: exp(-2 k^2 s^2) (Eckart)."""
        return math.exp(-2.0 * (WAVENUMBER_RAD_M * self.roughness_m) ** 2)

    @property
    def reflectivity(self) -> float:
        """Pressure amplitude mirrored at normal incidence, 0..1."""
        return self._returned * self._coherent


@cache
def load_material(name: str) -> Material:
    """A material by its name in fixtures/materials, or by path.

    Raises:
        UsageError: unknown name (lists the known ones) or malformed file.
    """
    path = fixture_path("materials", name)
    table = load_toml(path)
    extra = sorted(set(table) - {"material"})
    if extra or "material" not in table:
        raise UsageError(f"{path}: must hold one table [material]" + (f", not {extra[0]!r}" if extra else ""))
    return validate(Material, table["material"], f"{path}: [material]")
