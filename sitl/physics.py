"""Six-degree-of-freedom quadrotor over flat ground, with wind, battery and motor faults.

Rigid body, NED world, FRD body, integrated semi-implicitly in sub-steps of at most 0.625 ms. Rotor speed
follows the throttle with a first-order lag; thrust goes with its square. Drag is linear from the rotors
(blade flapping; Mahony, Kumar and Corke 2012, "Multirotor Aerial Vehicles", aerodynamic effects) plus
quadratic from the body, both against the air, not the ground. Feet are spring-dampers with Coulomb friction,
whose sticking part is a spring to where the foot touched (Cundall & Strack 1979): a parked vehicle stays put.

Left out: ground effect, rotor gyroscopic torque (two and two cancel), propeller wash, body lift.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sitl import rigid_body as body
from sitl.airframe import GRAVITY_M_S2, Airframe

SUBSTEP_US = 625
GUST_KNOT_US = 10_000
GUST_BLOCK = 512
VERTICAL_GUST_RATIO = 0.5


class WindLike(Protocol):
    """A mean wind with gusts, as scenes carry it.

    `direction_deg` is where the air goes TO, from world x (0) towards y (90); `gust_m_s` is the standard
    deviation of each horizontal component (half of it vertically), `gust_s` the time constant.
    """

    @property
    def mean_m_s(self) -> float: ...
    @property
    def direction_deg(self) -> float: ...
    @property
    def gust_m_s(self) -> float: ...
    @property
    def gust_s(self) -> float: ...


@dataclass(frozen=True)
class SteadyWind:
    """The simplest `WindLike`: still air unless told otherwise."""

    mean_m_s: float = 0.0
    direction_deg: float = 0.0
    gust_m_s: float = 0.0
    gust_s: float = 1.5


@dataclass
class VehicleState:
    """Truth at one instant. Arrays are views into the physics' memory: copy what is to be kept.

    pos_m, vel_m_s (3,) NED; quat (4,) w,x,y,z body to world; rates_rad_s (3,) body; accel_body_m_s2 (3,)
    specific force averaged over the last step, (0, 0, -9.81) at rest; thrust_n, rpm (4,) motors 1..4.
    """

    t_us: int
    pos_m: NDArray[np.float64]
    vel_m_s: NDArray[np.float64]
    quat: NDArray[np.float64]
    rates_rad_s: NDArray[np.float64]
    accel_body_m_s2: NDArray[np.float64]
    thrust_n: NDArray[np.float64]
    rpm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(4))
    on_ground: bool = True
    voltage_v: float = 0.0
    current_a: float = 0.0
    flat: NDArray[np.float64] = field(default_factory=lambda: np.zeros(body.SIZE), repr=False)


class Physics:
    """One vehicle in the air of one scene.

    Args:
        airframe: its figures.
        start_m: (3,) NED start of the reference point; lifted so that the feet are not below the ground.
        wind: mean and gusts; None is still air.
        seed: of the gusts. The same seed gives the same wind whatever the step.
        yaw_rad: heading at the start.
        charge: of the battery at the start, 0..1.

    Attributes:
        state: truth now, updated in place by `step`.
        motor_scale: (4,) thrust of each motor over what it should be; write to it to make a fault.
        wind_m_s: (3,) NED velocity of the air over the last step.
    """

    def __init__(self, airframe: Airframe,
                 start_m: tuple[float, float, float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
                 wind: WindLike | None = None, seed: int = 0, yaw_rad: float = 0.0,
                 charge: float = 1.0) -> None:
        self.airframe = airframe
        self.motor_scale = np.ones(4)
        self.wind_m_s = np.zeros(3)
        self._parameters = _pack(airframe)
        self._charge_curve = np.array([airframe.battery.charge, airframe.battery.cell_voltage_v])
        self._wind, self._seed = wind if wind is not None else SteadyWind(), seed
        self._gusts = _Gusts(self._wind, seed)
        self.wind_m_s[:] = self._gusts.at(0)
        flat = np.zeros(body.SIZE)
        weight_n = airframe.mass_kg * GRAVITY_M_S2
        rest_m = airframe.foot_height_m - weight_n / (4.0 * airframe.contact_stiffness_n_m)
        flat[body.POS:body.POS + 3] = start_m
        flat[body.POS + 2] = min(flat[body.POS + 2], -rest_m)
        flat[body.QUAT], flat[body.QUAT + 3] = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
        on_ground = bool(flat[body.POS + 2] >= -rest_m - 1e-9)
        flat[body.ACCEL + 2] = -GRAVITY_M_S2 if on_ground else 0.0
        flat[body.CHARGE] = charge
        flat[body.GROUND] = float(on_ground)
        volts = float(np.interp(charge, *self._charge_curve)) * airframe.battery.cells
        flat[body.VOLTAGE] = volts
        self.state = VehicleState(
            t_us=0, pos_m=flat[body.POS:body.POS + 3], vel_m_s=flat[body.VEL:body.VEL + 3],
            quat=flat[body.QUAT:body.QUAT + 4], rates_rad_s=flat[body.RATES:body.RATES + 3],
            accel_body_m_s2=flat[body.ACCEL:body.ACCEL + 3],
            thrust_n=flat[body.THRUST:body.THRUST + 4], on_ground=on_ground, voltage_v=volts, flat=flat)

    @property
    def charge(self) -> float:
        """State of charge of the battery, 0..1."""
        return float(self.state.flat[body.CHARGE])

    def set_gusts(self, gust_m_s: float) -> None:
        """Other gusts on the same mean wind from now on (fault campaigns)."""
        wind = self._wind
        self._gusts = _Gusts(SteadyWind(wind.mean_m_s, wind.direction_deg, gust_m_s, wind.gust_s), self._seed)

    def step(self, dt_us: int, throttle: NDArray[np.float64]) -> VehicleState:
        """Advance by `dt_us` with motor outputs `throttle` (4,) in 0..1 (PWM 1000..2000); returns `state`.

        A throttle that is not a number counts as 0, as an ESC without a signal stops.
        """
        state = self.state
        wind = self._gusts.at(state.t_us)
        self.wind_m_s[:] = wind
        body.advance(state.flat, self._parameters, self._charge_curve, throttle, self.motor_scale,
                     self.wind_m_s, state.rpm, dt_us, SUBSTEP_US)
        state.t_us += dt_us
        flat = state.flat
        state.on_ground = bool(flat[body.GROUND] > 0.0)
        state.voltage_v = float(flat[body.VOLTAGE])
        state.current_a = float(flat[body.CURRENT])
        return state


class _Gusts:
    """First-order (Ornstein-Uhlenbeck) gusts on a fixed grid of knots, linear between them."""

    def __init__(self, wind: WindLike, seed: int) -> None:
        direction = math.radians(wind.direction_deg)
        self._mean = (wind.mean_m_s * math.cos(direction), wind.mean_m_s * math.sin(direction), 0.0)
        self._still = wind.gust_m_s <= 0.0
        if self._still:
            return
        self._rng = np.random.default_rng(np.random.SeedSequence([seed, 0x617E]))
        self._keep = math.exp(-GUST_KNOT_US * 1e-6 / max(wind.gust_s, 0.05))
        self._sigma = wind.gust_m_s * np.array([1.0, 1.0, VERTICAL_GUST_RATIO])
        self._last = self._sigma * self._rng.standard_normal(3)
        self._first_knot = 0
        self._fill()

    def _fill(self) -> None:
        noise = self._rng.standard_normal((GUST_BLOCK, 3)) * (self._sigma * math.sqrt(1.0 - self._keep**2))
        knots = np.empty((GUST_BLOCK + 1, 3))
        knots[0] = self._last
        for k in range(GUST_BLOCK):
            knots[k + 1] = self._keep * knots[k] + noise[k]
        self._last = knots[-1]
        self._knots: list[list[float]] = knots.tolist()

    def at(self, t_us: int) -> tuple[float, float, float]:
        """Wind (north, east, down) m/s at a time that never goes back."""
        if self._still:
            return self._mean
        knot, rest_us = divmod(t_us, GUST_KNOT_US)
        while knot >= self._first_knot + GUST_BLOCK:
            self._first_knot += GUST_BLOCK
            self._fill()
        a, b = self._knots[knot - self._first_knot], self._knots[knot - self._first_knot + 1]
        f = rest_us / GUST_KNOT_US
        north, east, down = self._mean
        return (north + a[0] + f * (b[0] - a[0]), east + a[1] + f * (b[1] - a[1]),
                down + a[2] + f * (b[2] - a[2]))


def _pack(a: Airframe) -> NDArray[np.float64]:
    """The airframe's figures as the jitted step reads them."""
    battery = a.battery
    hover_speed = math.sqrt(a.hover_throttle)
    critical_damping = 2.0 * math.sqrt(4.0 * a.contact_stiffness_n_m * a.mass_kg) / 4.0  # a foot
    # Electrical power grows with thrust^1.5 (actuator disc); scaled to the hover power less the avionics.
    hover_thrust_n = a.max_thrust_n * a.hover_throttle
    rotor_power = (battery.hover_power_w - battery.avionics_power_w) / (4.0 * hover_thrust_n**1.5)
    return np.array([
        a.mass_kg, *a.inertia_kg_m2, a.arm_m, a.max_thrust_n, a.thrust_expo, a.spin_min, a.spin_max,
        a.idle_speed, a.motor_time_constant_s, a.torque_per_thrust_m, a.rotor_inertia_kg_m2,
        a.full_speed_rpm * 2.0 * math.pi / 60.0, *a.rotor_drag_n_s_m, hover_speed, *a.body_drag_n_s2_m2,
        *a.rotation_drag_nm_s, a.foot_span_m[0] / 2.0, a.foot_span_m[1] / 2.0, a.foot_height_m,
        a.contact_stiffness_n_m, a.contact_damping_ratio * critical_damping, a.friction,
        float(battery.cells), battery.capacity_ah, battery.resistance_ohm, rotor_power,
        battery.avionics_power_w, battery.reference_voltage_v,
        battery.thrust_voltage_exponent])
