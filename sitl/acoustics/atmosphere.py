"""The air: speed of sound, absorption and density.

Absorption is ISO 9613-1:1993, equations 3 to 5 and B.3. Its formulae hold for ultrasound; its tables end at 10 kHz.
Fog, falling snow and light are no inputs: at 53 kHz they change nothing measurable (acoustics.md, "Weather").
"""

import math
from dataclasses import dataclass
from typing import Protocol

from saranga.resample import sound_speed_m_s

REFERENCE_PRESSURE_PA = 101_325.0
REFERENCE_TEMPERATURE_K = 293.15
TRIPLE_POINT_K = 273.16
DRY_AIR_J_KG_K = 287.05


class Air(Protocol):
    """What of the weather matters to sound; `sitl.scene.Weather` is one."""

    @property
    def temperature_c(self) -> float: ...

    @property
    def humidity_percent(self) -> float: ...

    @property
    def pressure_pa(self) -> float: ...


@dataclass(frozen=True)
class StandardAir:
    """The air that calibration figures refer to: 20 C, 50 % relative humidity, sea level."""

    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_pa: float = REFERENCE_PRESSURE_PA


@dataclass(frozen=True)
class Atmosphere:
    """Properties of the air at one frequency."""

    c_m_s: float
    absorption_db_m: float
    density_kg_m3: float

    @property
    def impedance_pa_s_m(self) -> float:
        """rho c."""
        return self.density_kg_m3 * self.c_m_s


def absorption_db_m(frequency_hz: float, air: Air) -> float:
    """Attenuation by the air, dB a metre (ISO 9613-1, equations 3 to 5)."""
    t_k = air.temperature_c + 273.15
    p = air.pressure_pa / REFERENCE_PRESSURE_PA
    t = t_k / REFERENCE_TEMPERATURE_K
    saturation = 10.0 ** (-6.8346 * (TRIPLE_POINT_K / t_k) ** 1.261 + 4.6151)
    h = air.humidity_percent * saturation / p
    oxygen_hz = p * (24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h))
    nitrogen_hz = p * t**-0.5 * (9.0 + 280.0 * h * math.exp(-4.170 * (t ** (-1.0 / 3.0) - 1.0)))
    f2 = frequency_hz**2
    classical = 1.84e-11 / p * math.sqrt(t)
    oxygen = 0.01275 * math.exp(-2239.1 / t_k) / (oxygen_hz + f2 / oxygen_hz)
    nitrogen = 0.1068 * math.exp(-3352.0 / t_k) / (nitrogen_hz + f2 / nitrogen_hz)
    return 8.686 * f2 * (classical + t**-2.5 * (oxygen + nitrogen))


def atmosphere(frequency_hz: float, air: Air) -> Atmosphere:
    """Everything about the air that the acoustics need; the density is that of dry air (0.5 % at 20 C, 50 %)."""
    return Atmosphere(
        c_m_s=sound_speed_m_s(air.temperature_c),
        absorption_db_m=absorption_db_m(frequency_hz, air),
        density_kg_m3=air.pressure_pa / (DRY_AIR_J_KG_K * (air.temperature_c + 273.15)),
    )
