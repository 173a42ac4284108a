"""One scene, one suite of sensors, one shield: what every sensor records after a trigger."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.echo import SonarGeometry
from saranga.pulse import pulse_peak_delay_s, pulse_sigma_s
from sitl.acoustics.arrival import ARRIVAL_COLUMNS
from sitl.acoustics.atmosphere import Air, Atmosphere, StandardAir, atmosphere
from sitl.acoustics.beam import piston_grid
from sitl.acoustics.edges import ready_edges
from sitl.acoustics.flutter import MODES, films_of, flutter, mode_phases
from sitl.acoustics.hearing import hear
from sitl.acoustics.noise_model import NoiseModel
from sitl.acoustics.philox import philox
from sitl.acoustics.receiver import TURN_RAD, gain_counts, record_of
from sitl.acoustics.rotor_noise import blade_pass_hz, noise_bank
from sitl.acoustics.scatter import ready_scatterers
from sitl.acoustics.sensor_noise import SweptShare, bare_noise, sensor_noise
from sitl.acoustics.shield import Shield
from sitl.airframe import Airframe, load_airframe
from sitl.primitives import Primitives

DB_PER_NEPER = 8.685889638
WEAKEST_COUNTS = 0.25
"""Echoes below this, half a step of the converter, are left out."""
NOISE_STREAM = 0x5A7A


class AcousticModel:
    """The records of every sensor of a suite, a pure function of pose, thrusts, time and seed.

    Args:
        primitives: of the scene, world NED.
        weather: temperature, humidity and pressure count; fog, snow and light do not.
        geometry: the suite.
        shield: between propellers and sensors, by its geometry or as a bench measured it.
        seed: of the noise; the noise of a cycle depends on seed, role and `t_us` alone.
        airframe: where the motors are; the default airframe if left out.
        noise_bandwidth_hz: band of the rotor noise; what the suite says if left out (`rotor_noise.py`).
    """

    def __init__(self, primitives: Primitives, weather: Air, geometry: SonarGeometry, shield: Shield | NoiseModel,
                 seed: int, *, airframe: Airframe | None = None, noise_bandwidth_hz: float | None = None) -> None:
        self.primitives = primitives
        self.weather = weather
        self.geometry = geometry
        self.shield = shield
        self.seed = seed
        self._airframe = airframe or load_airframe()
        self._noise_bandwidth_hz = noise_bandwidth_hz
        fop = geometry.fop_hz
        self.air: Atmosphere = atmosphere(fop, weather)
        self.gain_counts = gain_counts(geometry.counts_at_1m, atmosphere(fop, StandardAir()).absorption_db_m)
        self._facets = np.array(primitives.facets, dtype=np.float64)
        self._cylinders = np.ascontiguousarray(primitives.cylinders, dtype=np.float64)
        self._edges = np.ascontiguousarray(ready_edges(primitives))
        self._spheres = np.ascontiguousarray(primitives.spheres, dtype=np.float64)
        self._scatterers = ready_scatterers(primitives)
        self._films = films_of(self._facets)
        self._still = self._facets.copy()
        self._film_phases = np.array([mode_phases(self._facets[film]) for film in self._films]).reshape(-1, len(MODES))
        c = self.air.c_m_s
        self._setting = np.array([fop, c, self.air.absorption_db_m / DB_PER_NEPER, geometry.bandwidth_hz,
                                  c * geometry.samples / geometry.iq_rate_hz])
        self._grid = piston_grid(2.0 * math.pi * fop / c, geometry.a_h_m, geometry.a_v_m)
        self._positions = {role: np.array(at) for role, at in geometry.positions_m.items()}
        self._receiver = tuple(float(value) for value in (
            self.gain_counts, fop, geometry.iq_rate_hz, pulse_sigma_s(geometry.bandwidth_hz),
            pulse_peak_delay_s(geometry.bandwidth_hz), geometry.quiet_floor_counts, geometry.ring_down_samples,
            geometry.bandwidth_hz, geometry.saturation_counts, self._airframe.blade_pass_modulation))
        self._bank = noise_bank(geometry.samples, geometry.iq_rate_hz,
                                noise_bandwidth_hz or geometry.noise_bandwidth_hz or geometry.bandwidth_hz)
        self._hover_n = self._airframe.max_thrust_n * self._airframe.hover_throttle
        self._noise = {role: sensor_noise(shield, self._airframe, geometry, role, self.air) for role in geometry.roles}
        self.swept = SweptShare()
        self._floor = WEAKEST_COUNTS / self.gain_counts
        mirrors = len(self._facets) * (len(self._facets) + len(self._cylinders))
        rows = len(primitives) + 1 + len(self._scatterers.points) + 2 * mirrors
        self._arrivals = np.empty((rows, ARRIVAL_COLUMNS))
        self._record = np.empty(geometry.samples, dtype=np.complex128)
        self._key = np.uint64(seed & 0xFFFFFFFFFFFFFFFF)
        self._counter = np.array([0, NOISE_STREAM, 0, 0], dtype=np.uint64)
        self._draws = np.empty(13, dtype=np.uint64)

    def with_geometry(self, **changes: Any) -> "AcousticModel":
        """The same world heard with other sensor settings, such as `odr=4, samples=128`."""
        other = AcousticModel(self.primitives, self.weather, replace(self.geometry, **changes), self.shield, self.seed,
                              airframe=self._airframe, noise_bandwidth_hz=self._noise_bandwidth_hz)
        other.swept = self.swept
        return other

    def insertion_loss_db(self, role: str, thrust_n: NDArray[np.float64] | None = None) -> float:
        """What the shield takes from the noise at one sensor, at these motor thrusts (4,) or hovering."""
        thrust_n = np.full(4, self._hover_n) if thrust_n is None else thrust_n
        bare = bare_noise(self._airframe, self.geometry, role).motor_power(thrust_n).sum()
        return 10.0 * math.log10(float(bare / self._noise[role].motor_power(thrust_n).sum()))

    def noise_rms_counts(self, role: str, thrust_n: NDArray[np.float64]) -> float:
        """RMS |IQ| of rotor noise and quiet floor at these motor thrusts (4,)."""
        rotor = float(self._noise[role].motor_power(thrust_n).sum())
        return math.sqrt(rotor + self.geometry.quiet_floor_counts**2)

    def noise_provenance(self) -> dict[str, Any]:
        """Where the noise behind the shield comes from, and how far a flight went beyond what was measured."""
        said = self.shield.provenance()
        return said | self.swept.to_dict() if isinstance(self.shield, NoiseModel) else said

    def arrivals(self, role: str, pos_m: NDArray[np.float64], quat: NDArray[np.float64],
                 vel_m_s: NDArray[np.float64], *, t_us: int = 0,
                 thrust_n: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Echoes and direct sound at one sensor, rows of `arrival.ARRIVAL_COLUMNS`; a copy.

        `t_us` and `thrust_n` (hovering if left out) matter to film under the wash alone.
        """
        thrust_n = np.full(4, self._hover_n) if thrust_n is None else thrust_n
        count = self._trace(role, pos_m, rotation_matrix(quat), vel_m_s, t_us, thrust_n)
        return self._arrivals[:count].copy()

    def _trace(self, role: str, pos_m: NDArray[np.float64], rotation: NDArray[np.float64],
               vel_m_s: NDArray[np.float64], t_us: int, thrust_n: NDArray[np.float64]) -> int:
        """Fill the first rows of `_arrivals`; returns how many."""
        tx = pos_m + rotation @ self._positions[self.geometry.transmitter]
        rx = pos_m + rotation @ self._positions[role]
        if len(self._films):
            wash = float(thrust_n.sum()) / (4.0 * self._hover_n)
            flutter(self._facets, self._still, self._films, self._film_phases, tx, t_us * 1e-6, wash)
        return int(hear(self._facets, self._cylinders, self._spheres, self._edges, *self._scatterers, tx, rx, rotation,
                        vel_m_s, self._setting, self._grid, self._floor, self._arrivals))

    def cycle(self, pos_m: NDArray[np.float64], quat: NDArray[np.float64], vel_m_s: NDArray[np.float64],
              thrust_n: NDArray[np.float64], t_us: int, *, receive_only: bool = False) -> dict[str, NDArray[np.int16]]:
        """The record of every sensor, by role.

        Args:
            pos_m, vel_m_s: (3,) of the vehicle, world NED; quat: [w, x, y, z] body to world.
            thrust_n: (4,), sets the noise.
            t_us: time of the trigger, picks the noise and how film stands.
            receive_only: nothing is transmitted: noise alone.

        Returns:
            int16, shape (samples, 2), Q first.
        """
        geometry = self.geometry
        if isinstance(self.shield, NoiseModel):
            self.swept.count(self.shield, thrust_n, self._hover_n)
        rotation = rotation_matrix(quat)
        self._counter[3] = t_us
        philox(self._key, self._counter, self._draws)
        turn_rad = blade_pass_hz(self._airframe, thrust_n) * (2.0 * math.pi / geometry.iq_rate_hz)
        swing_phase_rad = self._draws[9:] * TURN_RAD
        records = {}
        for k, role in enumerate(geometry.roles):
            count = 0 if receive_only else self._trace(role, pos_m, rotation, vel_m_s, t_us, thrust_n)
            rings = not receive_only and role == geometry.transmitter
            out = np.empty((geometry.samples, 2), dtype=np.int16)
            record_of(self._arrivals, count, rings, self._receiver, self._bank, self._draws, 3 * k,
                      self._noise[role].motor_power(thrust_n), turn_rad, swing_phase_rad, self._record, out)
            records[role] = out
        return records


def rotation_matrix(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) body to world of a unit quaternion [w, x, y, z]."""
    w, x, y, z = (float(q) for q in quat)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
