"""What the sensors of an emulated rig hear on the bench: one pole in front, the rig's own sound, and noise."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.rig.faults import DeviceFaults
from saranga.echo import SonarGeometry
from saranga.pulse import pulse_peak_delay_s, pulse_sigma_s
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.receiver import add_echoes, add_noise, add_ring_down, digitise
from sitl.acoustics.rotor_noise import BANK_ROWS, noise_bank
from sitl.acoustics.shield import load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.primitives import Primitives, cylinder_row

POSITION_M = np.array([0.0, 0.0, -1.0])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
STILL = np.zeros(3)
NO_HORN_BAND = 0.6
"""Without its horn's load the transducer rings longer: its band is this much narrower. An assumption."""
NO_HORN_GAIN = 0.5


@dataclass(frozen=True)
class Reflector:
    """A vertical pole, `range_m` from the middle of the sensors, to the right for a positive azimuth."""

    range_m: float = 0.8
    azimuth_deg: float = 30.0
    radius_m: float = 0.03


class BenchAcoustics:
    """Records of one sensor setting. `clean` is the same at every trigger; noise is added to it."""

    def __init__(self, sonar: SonarGeometry, faults: DeviceFaults, reflector: Reflector | None, seed: int,
                 odr: int, samples: int) -> None:
        self.geometry = replace(sonar, odr=odr, samples=samples)
        self._faults = faults
        places = dict(sonar.positions_m)
        if faults.swapped_sensors and "right" in places:
            places["left"], places["right"] = places["right"], places["left"]
        heard = replace(self.geometry, positions_m=places)
        ahead = max(x for x, _, _ in places.values())
        poles = []
        if reflector is not None:
            azimuth = math.radians(reflector.azimuth_deg)
            x, y = ahead + reflector.range_m * math.cos(azimuth), reflector.range_m * math.sin(azimuth)
            poles = [cylinder_row(np.array([x, y, 0.0]), np.array([x, y, -2.0]), reflector.radius_m, 1.0)]
        self._model = AcousticModel(Primitives.of(cylinders=poles), StandardAir(), heard, load_shield("none"), seed)
        self._bank = noise_bank(samples, self.geometry.iq_rate_hz, sonar.bandwidth_hz)
        self._clean = {role: self._clean_record(role, faults.desync_us * 1e-6) for role in sonar.roles}

    @property
    def temperature_c(self) -> float:
        """Of the air on the bench."""
        return float(self._model.weather.temperature_c)

    def record(self, role: str, rotor_rms_counts: float, receive_only: bool,
               rng: np.random.Generator) -> NDArray[np.int16]:
        """int16, shape (samples, 2), Q first: what one sensor gives after one trigger."""
        geometry = self.geometry
        if receive_only:
            record = np.zeros(geometry.samples, dtype=np.complex128)
        elif role == "right" and self._faults.desync_jitter_us > 0.0:
            record = self._clean_record(role, (self._faults.desync_us + rng.normal() * self._faults.desync_jitter_us)
                                        * 1e-6)
        else:
            record = self._clean[role].copy()
        floor = geometry.quiet_floor_counts * (10.0 if self._faults.noisy_sensor == role else 1.0)
        add_noise(record, self._bank[int(rng.integers(BANK_ROWS))], int(rng.integers(geometry.samples)),
                  math.hypot(floor, rotor_rms_counts), float(rng.uniform(0.0, 2.0 * math.pi)))
        out = np.empty((geometry.samples, 2), dtype=np.int16)
        digitise(record, geometry.saturation_counts, out)
        return out

    def _clean_record(self, role: str, late_s: float) -> NDArray[np.complex128]:
        geometry, faults = self.geometry, self._faults
        record = np.zeros(geometry.samples, dtype=np.complex128)
        if faults.dead_transmitter:
            return record
        gain = self._model.gain_counts * (NO_HORN_GAIN if faults.missing_horn else 1.0)
        arrivals = self._model.arrivals(role, POSITION_M, UPRIGHT, STILL)
        if role == "right":
            arrivals[:, 0] -= late_s
        add_echoes(record, arrivals, len(arrivals), gain, geometry.fop_hz, geometry.iq_rate_hz,
                   pulse_sigma_s(geometry.bandwidth_hz), pulse_peak_delay_s(geometry.bandwidth_hz))
        if role == geometry.transmitter:
            band = NO_HORN_BAND if faults.missing_horn else 1.0
            # The geometry's length is in samples of ODR 6.
            ringing = geometry.ring_down_samples / band / 2.0 ** (6 - geometry.odr)
            add_ring_down(record, geometry.quiet_floor_counts, ringing, geometry.iq_rate_hz,
                          geometry.bandwidth_hz * band)
        return record
