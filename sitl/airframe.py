"""The vehicle's fixed figures, read from `fixtures/airframes/*.toml`."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml

GRAVITY_M_S2 = 9.80665
DEFAULT_AIRFRAME = "pearbat160"

# ArduCopter QUAD X: 1 front right, 2 rear left, 3 front left, 4 rear right. Propellers 1 and 2 turn
# counter-clockwise seen from above, so their reaction torque is +z (clockwise, nose to the right) in FRD.
MOTOR_SIGN_X = (1.0, -1.0, 1.0, -1.0)
MOTOR_SIGN_Y = (1.0, -1.0, -1.0, 1.0)
MOTOR_YAW_SIGN = (1.0, 1.0, -1.0, -1.0)


@dataclass(frozen=True)
class Battery:
    """A pack of `cells` in series; `charge` (0..1) against `cell_voltage_v` is the open-circuit curve."""

    cells: int
    capacity_ah: float
    resistance_ohm: float
    hover_power_w: float
    avionics_power_w: float
    reference_voltage_v: float
    thrust_voltage_exponent: float
    charge: tuple[float, ...]
    cell_voltage_v: tuple[float, ...]


@dataclass(frozen=True)
class Airframe:
    """An X quad. Lengths, inertia and drag along body FRD x, y, z.

    `blade_pass_modulation` is the depth by which the power of a propeller's noise swings as its blades pass.
    `rotor_drag_n_s_m` is the linear drag at hover rotor speed, `body_drag_n_s2_m2` the quadratic one.
    """

    name: str
    description: str
    mass_kg: float
    wheelbase_m: float
    inertia_kg_m2: tuple[float, float, float]
    body_size_m: tuple[float, float, float]
    foot_span_m: tuple[float, float]
    foot_height_m: float
    propeller_height_m: float
    propeller_diameter_m: float
    hover_throttle: float
    thrust_expo: float
    spin_min: float
    spin_max: float
    idle_speed: float
    motor_time_constant_s: float
    torque_per_thrust_m: float
    rotor_inertia_kg_m2: float
    full_speed_rpm: float
    rotor_drag_n_s_m: tuple[float, float, float]
    body_drag_n_s2_m2: tuple[float, float, float]
    rotation_drag_nm_s: tuple[float, float, float]
    contact_stiffness_n_m: float
    contact_damping_ratio: float
    friction: float
    battery: Battery
    propeller_blades: int = 2
    blade_pass_modulation: float = 0.0

    @property
    def arm_m(self) -> float:
        """Distance of a motor from the x and from the y axis."""
        return self.wheelbase_m / 2.0 / math.sqrt(2.0)

    @property
    def max_thrust_n(self) -> float:
        """Full thrust of one motor at the reference voltage: hovering takes `hover_throttle` of it."""
        return self.mass_kg * GRAVITY_M_S2 / 4.0 / self.hover_throttle

    @property
    def motor_positions_m(self) -> tuple[tuple[float, float, float], ...]:
        """Centres of the four propeller discs in body FRD, ArduCopter's motor order."""
        return tuple((sx * self.arm_m, sy * self.arm_m, -self.propeller_height_m)
                     for sx, sy in zip(MOTOR_SIGN_X, MOTOR_SIGN_Y, strict=True))

    def thrust_fraction(self, throttle: float) -> float:
        """Steady thrust over the maximum for a motor output `throttle` in 0..1 (PWM 1000..2000)."""
        x = min(max((throttle - self.spin_min) / (self.spin_max - self.spin_min), 0.0), 1.0)
        idle = self.idle_speed * min(max(throttle / self.spin_min, 0.0), 1.0)
        return max((1.0 - self.thrust_expo) * x + self.thrust_expo * x * x, idle * idle)

    def throttle_for(self, thrust_fraction: float) -> float:
        """Motor output 0..1 that gives this part of the maximum thrust: the inverse of `thrust_fraction`."""
        e = self.thrust_expo
        f = min(max(thrust_fraction, 0.0), 1.0)
        x = f if e == 0.0 else (math.sqrt((1.0 - e) ** 2 + 4.0 * e * f) - (1.0 - e)) / (2.0 * e)
        return self.spin_min + (self.spin_max - self.spin_min) * x


def load_airframe(name: str = DEFAULT_AIRFRAME) -> Airframe:
    """Read an airframe by fixture name or path.

    Raises:
        UsageError: unknown name, malformed file, a missing key, or a value outside its limits.
    """
    path = fixture_path("airframes", name)
    table = load_toml(path)
    advice = f"compare with fixtures/airframes/{DEFAULT_AIRFRAME}.toml"
    try:
        airframe = _from_table(table)
    except KeyError as error:
        raise UsageError(f"{path}: key {error} is missing; {advice}") from error
    except (TypeError, ValueError) as error:
        raise UsageError(f"{path}: {error}; {advice}") from error
    _check(airframe, str(path))
    return airframe


def _from_table(table: Mapping[str, Any]) -> Airframe:
    body, motors, drag, contact, pack = (table[k] for k in ("body", "motors", "drag", "contact", "battery"))
    noise = table.get("noise", {})
    return Airframe(
        name=str(table["airframe"]["name"]), description=str(table["airframe"]["description"]),
        mass_kg=float(body["mass_kg"]), wheelbase_m=float(body["wheelbase_m"]),
        inertia_kg_m2=_three(body, "inertia_kg_m2"), body_size_m=_three(body, "size_m"),
        foot_span_m=(float(body["foot_span_m"][0]), float(body["foot_span_m"][1])),
        foot_height_m=float(body["foot_height_m"]), propeller_height_m=float(body["propeller_height_m"]),
        propeller_diameter_m=float(motors["propeller_diameter_m"]),
        hover_throttle=float(motors["hover_throttle"]),
        thrust_expo=float(motors["thrust_expo"]), spin_min=float(motors["spin_min"]),
        spin_max=float(motors["spin_max"]), idle_speed=float(motors["idle_speed"]),
        motor_time_constant_s=float(motors["time_constant_s"]),
        torque_per_thrust_m=float(motors["torque_per_thrust_m"]),
        rotor_inertia_kg_m2=float(motors["rotor_inertia_kg_m2"]),
        full_speed_rpm=float(motors["full_speed_rpm"]),
        rotor_drag_n_s_m=_three(drag, "rotor_n_s_m"), body_drag_n_s2_m2=_three(drag, "body_n_s2_m2"),
        rotation_drag_nm_s=_three(drag, "rotation_nm_s"),
        contact_stiffness_n_m=float(contact["stiffness_n_m"]),
        contact_damping_ratio=float(contact["damping_ratio"]), friction=float(contact["friction"]),
        battery=Battery(
            cells=int(pack["cells"]), capacity_ah=float(pack["capacity_ah"]),
            resistance_ohm=float(pack["resistance_ohm"]), hover_power_w=float(pack["hover_power_w"]),
            avionics_power_w=float(pack["avionics_power_w"]),
            reference_voltage_v=float(pack["reference_voltage_v"]),
            thrust_voltage_exponent=float(pack["thrust_voltage_exponent"]),
            charge=tuple(map(float, pack["charge"])),
            cell_voltage_v=tuple(map(float, pack["cell_voltage_v"]))),
        propeller_blades=int(noise.get("propeller_blades", 2)),
        blade_pass_modulation=float(noise.get("blade_pass_modulation", 0.0)))


def _three(table: Mapping[str, Any], key: str) -> tuple[float, float, float]:
    values = table[key]
    if not isinstance(values, list) or len(values) != 3:
        raise ValueError(f"{key} = {values!r} must be three numbers (body x, y, z)")
    return float(values[0]), float(values[1]), float(values[2])


def _check(a: Airframe, where: str) -> None:
    """Limits outside of which the equations or their integration make no sense."""
    limits: list[tuple[str, float, float, float]] = [
        ("body.mass_kg", a.mass_kg, 0.02, 20.0),
        ("body.wheelbase_m", a.wheelbase_m, 0.03, 2.0),
        ("body.inertia_kg_m2 (smallest)", min(a.inertia_kg_m2), 1e-6, 10.0),
        ("body.foot_height_m", a.foot_height_m, 0.005, 1.0),
        ("motors.hover_throttle", a.hover_throttle, 0.05, 0.9),
        ("motors.thrust_expo", a.thrust_expo, 0.0, 1.0),
        ("motors.spin_min", a.spin_min, 0.001, 0.5),
        ("motors.spin_max", a.spin_max, 0.6, 1.0),
        ("motors.idle_speed", a.idle_speed, 0.0, 0.3),
        ("motors.time_constant_s", a.motor_time_constant_s, 0.003, 1.0),
        ("motors.full_speed_rpm", a.full_speed_rpm, 100.0, 200_000.0),
        ("contact.stiffness_n_m", a.contact_stiffness_n_m, 10.0, 1e5),
        ("contact.damping_ratio", a.contact_damping_ratio, 0.05, 2.0),
        ("contact.friction", a.friction, 0.0, 3.0),
        ("noise.propeller_blades", a.propeller_blades, 1, 12),
        ("noise.blade_pass_modulation", a.blade_pass_modulation, 0.0, 1.0),
        ("battery.cells", a.battery.cells, 1, 14),
        ("battery.capacity_ah", a.battery.capacity_ah, 0.05, 100.0),
        ("battery.resistance_ohm", a.battery.resistance_ohm, 0.0, 1.0),
        ("battery.reference_voltage_v", a.battery.reference_voltage_v, 1.0, 70.0),
    ]
    for key, value, low, high in limits:
        if not low <= value <= high:
            raise UsageError(f"{where}: {key} = {value:g} must be within {low:g} .. {high:g}; correct it")
    charge, volts = a.battery.charge, a.battery.cell_voltage_v
    rising = all(low < high for low, high in itertools.pairwise(charge))
    if len(charge) != len(volts) or len(charge) < 2 or not rising:
        raise UsageError(f"{where}: battery.charge must rise and be as long as battery.cell_voltage_v; "
                         "correct it")
