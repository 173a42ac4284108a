"""Propeller, motor, ESC, supply, heat and vibration of one motor on a stand: what an emulated stand measures.

Static behaviour is fitted to real sweeps (`fitting.py`, `fixtures/thrust/*.toml`); what such sweeps cannot tell
(inertia, heat, vibration) is estimated and marked so in those files. Nothing of this is a measurement.

    rotation   V f(u) = n + b n^2, f a cubic of the throttle u: speed constant, ESC and winding in one; first-order lag
    thrust     T = k n^2, torque Q = q n^2
    power      P = sum p_i (n / 10 000)^i + J w dw/dt; supply V = V0 - R I, I = P / V, and never above its limit
    heat       C dT/dt = loss - h (T - ambient), h of the motor grows with n
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.thrust_stand.plant_file import PlantParameters, load_plant_file
from bench.thrust_stand.protocol import StandReading
from saranga.errors import UsageError
from sitl.airframe import load_airframe

SUBSTEP_S = 0.004
STILL_RPM = 1.0
RAD_S_PER_RPM = 2.0 * math.pi / 60.0
PLANT_STREAM = 0x57A4D


@dataclass(frozen=True)
class PlantNoise:
    """Standard deviations of what is measured; temperatures come in whole degrees, as ESCs send them."""

    thrust_n: float = 0.004
    torque_n_m: float = 2e-4
    rpm: float = 12.0
    voltage_v: float = 0.004
    current_a: float = 0.02
    vibration_share: float = 0.05


class Plant:
    """One motor with its propeller. Deterministic: the same parameters, seed and steps give the same readings.

    Args:
        file: parameters, see `plant_file.py`.
        seed: of the measurement noise.
        noise: None is a perfect instrument.
        ambient_c: air, and temperature of everything at the start.
        cells, capacity_ah: a lithium polymer pack in place of the sweep's bench supply; both or neither.
        charge: of that pack at the start, 0..1.
        imbalance: factor on the propeller's vibration.
        load_cell_drift_n_s: how fast the load cell's zero moves.

    Raises:
        UsageError: a value outside its limits.
    """

    def __init__(self, file: PlantParameters, seed: int = 0, noise: PlantNoise | None = PlantNoise(), *,
                 ambient_c: float = 20.0, cells: int = 0, capacity_ah: float = 0.0, charge: float = 1.0,
                 imbalance: float = 1.0, load_cell_drift_n_s: float = 0.0) -> None:
        for name, value, low, high in (("ambient_c", ambient_c, -40.0, 60.0), ("cells", cells, 0, 14),
                                       ("capacity_ah", capacity_ah, 0.0, 100.0), ("charge", charge, 0.0, 1.0),
                                       ("imbalance", imbalance, 0.0, 1000.0),
                                       ("load_cell_drift_n_s", load_cell_drift_n_s, -1.0, 1.0)):
            if not low <= value <= high:
                raise UsageError(f"emulated stand: {name} is {value!r}: it must be {low:g}..{high:g}")
        if (cells > 0) != (capacity_ah > 0.0):
            raise UsageError("emulated stand: a battery needs cells and capacity_ah; leave both out for the bench "
                             "supply")
        self.file = file
        self.name = file.name
        self._noise = noise
        self._random = np.random.default_rng([PLANT_STREAM, seed])
        self._ambient_c = ambient_c
        self._cells, self._capacity_as = cells, capacity_ah * 3600.0
        self._imbalance = imbalance
        self._drift_n_s = load_cell_drift_n_s
        self._used_as = (1.0 - charge) * self._capacity_as
        self._curve = load_airframe().battery
        self._time_s = 0.0
        self._rpm = 0.0
        self._motor_c = self._esc_c = ambient_c
        self._voltage_v = self._open_v()
        self._current_a = self.file.power.idle_w / self._voltage_v
        self._throttle = 0.0
        self._steady_key: tuple[float, float] | None = None
        self._steady_value = (0.0, 0.0)

    # ---- what an experimenter sees ----------------------------------------------------------------
    @property
    def truth(self) -> StandReading:
        """The present state without measurement noise."""
        thrust_n = self.file.propeller.thrust_n_per_rpm2 * self._rpm**2
        vibration = self.file.vibration
        return StandReading(
            time_s=self._time_s, thrust_n=thrust_n,
            torque_n_m=self.file.propeller.torque_n_m_per_rpm2 * self._rpm**2, rpm=self._rpm,
            voltage_v=self._voltage_v, current_a=self._current_a, esc_temperature_c=self._esc_c,
            motor_temperature_c=self._motor_c,
            vibration_m_s2=vibration.floor_m_s2
            + self._imbalance * vibration.m_s2_per_10000_rpm_squared * (self._rpm / 1e4) ** 2,
            throttle=self._throttle)

    def step(self, dt_s: float, throttle: float) -> StandReading:
        """Hold `throttle` (0..1) for `dt_s` seconds; what the instruments then read.

        Raises:
            UsageError: a throttle outside 0..1 or NaN, or a step that is not 0..10 s.
        """
        if not 0.0 <= throttle <= 1.0:
            raise UsageError(f"throttle is {throttle!r}: it must be 0..1")
        if not 0.0 <= dt_s <= 10.0:
            raise UsageError(f"time step is {dt_s!r} s: it must be 0..10")
        self._throttle = throttle
        count = math.ceil(dt_s / SUBSTEP_S - 1e-9)
        for _ in range(count):
            self._advance(dt_s / count, throttle)
        return self._measured()

    def steady(self, throttle: float) -> StandReading:
        """The state after a long time at `throttle`, cold, with the supply as it is now; nothing is changed."""
        rpm, voltage_v = self._steady(throttle)
        thrust_n = self.file.propeller.thrust_n_per_rpm2 * rpm**2
        return StandReading(time_s=self._time_s, thrust_n=thrust_n,
                            torque_n_m=self.file.propeller.torque_n_m_per_rpm2 * rpm**2, rpm=rpm, voltage_v=voltage_v,
                            current_a=self._power_w(rpm) / voltage_v, throttle=throttle)

    # ---- laws -------------------------------------------------------------------------------------
    def _advance(self, dt_s: float, throttle: float) -> None:
        motor = self.file.motor
        before = self._rpm
        target = self._rpm_at(throttle, self._voltage_v)
        lag_s = motor.spin_up_s if target > before else motor.spin_down_s
        self._rpm = target + (before - target) * math.exp(-dt_s / lag_s)
        if target == 0.0 and self._rpm < STILL_RPM:
            self._rpm = 0.0
        rise = max(self._rpm - before, 0.0) / dt_s * RAD_S_PER_RPM
        power_w = self._power_w(self._rpm) + motor.rotor_inertia_kg_m2 * self._rpm * RAD_S_PER_RPM * rise
        self._voltage_v = min(self._sagged_v(power_w), self._steady(throttle)[1])
        self._current_a = min(power_w / self._voltage_v, self.file.supply.current_limit_a)
        self._used_as = min(self._used_as + self._current_a * dt_s, self._capacity_as) if self._cells else 0.0
        self._heat(dt_s)
        self._time_s += dt_s

    def _heat(self, dt_s: float) -> None:
        heat = self.file.heat
        watts = self._voltage_v * self._current_a
        shaft_w = self.file.propeller.torque_n_m_per_rpm2 * self._rpm**3 * RAD_S_PER_RPM
        esc_w = heat.esc_resistance_ohm * self._current_a**2 + heat.esc_share * watts
        motor_w = max(watts - shaft_w - esc_w, 0.0) if self._rpm > 0.0 else 0.0
        cooling_w_k = heat.motor_still_w_k + heat.motor_w_k_per_10000_rpm * self._rpm / 1e4
        self._motor_c += dt_s / heat.motor_j_k * (motor_w - cooling_w_k * (self._motor_c - self._ambient_c))
        self._esc_c += dt_s / heat.esc_j_k * (esc_w - heat.esc_w_k * (self._esc_c - self._ambient_c))

    def _rpm_at(self, throttle: float, voltage_v: float) -> float:
        """Steady speed at this voltage: the positive root of b n^2 + n = V f(u)."""
        motor = self.file.motor
        if throttle < motor.start_throttle:
            return 0.0
        drive = voltage_v * max(_polynomial(motor.rpm_per_v, throttle), 0.0)
        b = motor.droop_per_rpm
        return drive if b == 0.0 else (math.sqrt(1.0 + 4.0 * b * drive) - 1.0) / (2.0 * b)

    def _power_w(self, rpm: float) -> float:
        return self.file.power.idle_w if rpm < STILL_RPM else _polynomial(self.file.power.w, rpm / 1e4)

    def _open_v(self) -> float:
        """Voltage of the supply, or of the pack at its charge, without load."""
        if not self._cells:
            return self.file.supply.voltage_v
        charge = 1.0 - self._used_as / self._capacity_as
        return self._cells * float(np.interp(charge, self._curve.charge, self._curve.cell_voltage_v))

    def _sagged_v(self, power_w: float) -> float:
        """V = V0 - R P / V; where the supply cannot give the power, half its voltage, where it gives most."""
        open_v = self._open_v()
        root = open_v**2 - 4.0 * self.file.supply.resistance_ohm * power_w
        return 0.5 * (open_v + math.sqrt(max(root, 0.0)))

    def _steady(self, throttle: float) -> tuple[float, float]:
        """Speed and voltage where supply and motor agree: the current grows with the voltage, so one root."""
        supply, open_v = self.file.supply, self._open_v()

        def excess_a(voltage_v: float) -> float:
            """Current the motor draws over what the supply gives at this voltage."""
            gives = min((open_v - voltage_v) / supply.resistance_ohm, supply.current_limit_a)
            return self._power_w(self._rpm_at(throttle, voltage_v)) / voltage_v - gives

        key = (throttle, round(open_v, 3))
        if self._steady_key != key:
            low, high = 0.05 * open_v, open_v
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if excess_a(middle) > 0.0 else (middle, high)
            self._steady_key = key
            self._steady_value = (self._rpm_at(throttle, low), low)
        return self._steady_value

    def _measured(self) -> StandReading:
        truth = replace(self.truth, thrust_n=self.truth.thrust_n + self._drift_n_s * self._time_s)
        noise = self._noise
        if noise is None:
            return truth
        thrust, torque, rpm, voltage, current, vibration = self._random.standard_normal(6).tolist()
        return replace(
            truth, thrust_n=truth.thrust_n + noise.thrust_n * thrust,
            torque_n_m=truth.torque_n_m + noise.torque_n_m * torque,
            rpm=max(truth.rpm + noise.rpm * rpm, 0.0) if truth.rpm > 100.0 else 0.0,
            voltage_v=truth.voltage_v + noise.voltage_v * voltage,
            current_a=truth.current_a + noise.current_a * current,
            esc_temperature_c=float(round(truth.esc_temperature_c)),
            motor_temperature_c=float(round(truth.motor_temperature_c)),
            vibration_m_s2=truth.vibration_m_s2 * max(1.0 + noise.vibration_share * vibration, 0.0))


def _polynomial(coefficients: tuple[float, ...], x: float) -> float:
    value = 0.0
    for c in reversed(coefficients):
        value = value * x + c
    return value


def load_plant(name: str, seed: int = 0, **options: Any) -> Plant:
    """A plant by the name of its file in fixtures/thrust, or by a path to a .toml file.

    Args:
        options: of `Plant`.

    Raises:
        UsageError: an unknown name, a malformed file, or a value outside its limits.
    """
    return Plant(load_plant_file(name), seed, **options)
