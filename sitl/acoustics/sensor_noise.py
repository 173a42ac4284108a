"""Rotor noise at one sensor behind one shield, a share of the power for each motor, in counts squared."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saranga.echo import FULL_SCALE, SonarGeometry
from sitl.acoustics.atmosphere import Atmosphere
from sitl.acoustics.noise_model import NoiseModel
from sitl.acoustics.rotor_noise import (
    THRUST_EXPONENT,
    anchor_rms_counts,
    anchor_thrust_n,
    hub_distances_m,
    motor_weights,
)
from sitl.acoustics.shield import Shield, shielded_weights
from sitl.airframe import Airframe

Floats = NDArray[np.float64]


class SensorNoise(Protocol):
    """What the propellers make at one sensor."""

    def motor_power(self, thrust_n: Floats) -> Floats:
        """Mean |IQ|^2 (4,) in counts^2 that each motor adds at these thrusts (4,)."""


@dataclass(frozen=True)
class ComputedNoise:
    """The anchor's law with what the shield leaves of each motor: `power_at_hover` (4,) counts^2 at the anchor."""

    power_at_hover: Floats

    def motor_power(self, thrust_n: Floats) -> Floats:
        return self.power_at_hover * (np.maximum(thrust_n, 0.0) / anchor_thrust_n()) ** (2.0 * THRUST_EXPONENT)


@dataclass(frozen=True)
class MeasuredLoss:
    """The bare propellers, each less the insertion loss that the bench measured at its thrust."""

    bare: ComputedNoise
    model: NoiseModel

    def motor_power(self, thrust_n: Floats) -> Floats:
        return self.bare.motor_power(thrust_n) * 10.0 ** (-self.model.loss_at_db(thrust_n) / 10.0)


@dataclass(frozen=True)
class MeasuredLevel:
    """The level that the bench measured at `hub_distance_m`, at each motor's distance (4,): 1 / distance^2."""

    model: NoiseModel
    distance_m: Floats

    def motor_power(self, thrust_n: Floats) -> Floats:
        return (FULL_SCALE * self.model.rms_at(thrust_n) * self.model.hub_distance_m / self.distance_m) ** 2


def sensor_noise(shield: Shield | NoiseModel, airframe: Airframe, geometry: SonarGeometry, role: str,
                 air: Atmosphere) -> SensorNoise:
    """Noise at the sensor `role`.

    Raises:
        UsageError: a noise model whose sweep misses the airframe's hover thrust.
    """
    sensor_m = geometry.positions_m[role]
    weights = motor_weights(airframe, sensor_m)
    power = anchor_rms_counts(geometry.counts_at_1m) ** 2
    if isinstance(shield, Shield):
        return ComputedNoise(power * shielded_weights(shield, weights, airframe.motor_positions_m, sensor_m,
                                                      geometry.fop_hz, air.c_m_s, air.impedance_pa_s_m))
    shield.check_covers(airframe.max_thrust_n * airframe.hover_throttle)
    if shield.insertion_loss_db is not None:
        return MeasuredLoss(ComputedNoise(power * weights), shield)
    return MeasuredLevel(shield, hub_distances_m(airframe, sensor_m))


def bare_noise(airframe: Airframe, geometry: SonarGeometry, role: str) -> SensorNoise:
    """The same without any shield: what an insertion loss is counted from."""
    weights = motor_weights(airframe, geometry.positions_m[role])
    return ComputedNoise(anchor_rms_counts(geometry.counts_at_1m) ** 2 * weights)


class SweptShare:
    """How often a flight asked a noise model for thrusts that its sweep never saw. Idling on the ground is not counted:
    only cycles with at least half the hover thrust."""

    def __init__(self) -> None:
        self.cycles = self.above = self.below = 0
        self.largest_n = 0.0

    def count(self, model: NoiseModel, thrust_n: Floats, hover_n: float) -> None:
        """One cycle at these thrusts (4,)."""
        if float(thrust_n.sum()) < 2.0 * hover_n:
            return
        low, high = model.swept_n
        most = float(thrust_n.max())
        self.cycles += 1
        self.above += most > high
        self.below += float(thrust_n.min()) < low
        self.largest_n = max(self.largest_n, most)

    def to_dict(self) -> dict[str, float]:
        """Shares of the cycles in flight in which a motor was above or below the sweep, and the largest thrust."""
        cycles = max(self.cycles, 1)
        return {"cycles": self.cycles, "above_sweep_share": self.above / cycles,
                "below_sweep_share": self.below / cycles, "largest_thrust_n": self.largest_n}
