"""The quadrotor's motion against closed forms and conservation."""

import math
from pathlib import Path

import numpy as np
import pytest

from saranga.errors import UsageError
from sitl.airframe import GRAVITY_M_S2, load_airframe
from sitl.physics import Physics, SteadyWind

AIRFRAME = load_airframe("pearbat160")
TICK_US = 2500


def throttle_of(fraction: float) -> np.ndarray:
    return np.full(4, AIRFRAME.throttle_for(fraction))


def run(physics: Physics, seconds: float, throttle: np.ndarray) -> None:
    for _ in range(round(seconds * 1e6 / TICK_US)):
        physics.step(TICK_US, throttle)


def hover_fraction(physics: Physics) -> float:
    strength = (physics.state.voltage_v / AIRFRAME.battery.reference_voltage_v) ** 1.5
    return AIRFRAME.hover_throttle / strength


def rotation_of(physics: Physics) -> np.ndarray:
    """Body to world."""
    w, x, y, z = physics.state.quat
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def tilt_rad(physics: Physics) -> float:
    _, x, y, _ = physics.state.quat
    return math.acos(1 - 2 * (x * x + y * y))


def test_free_fall_follows_gravity_with_quadratic_drag() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -100.0))
    run(physics, 1.5, np.zeros(4))
    k = AIRFRAME.body_drag_n_s2_m2[2]
    terminal = math.sqrt(AIRFRAME.mass_kg * GRAVITY_M_S2 / k)
    expected = terminal * math.tanh(GRAVITY_M_S2 * 1.5 / terminal)
    assert physics.state.vel_m_s[2] == pytest.approx(expected, rel=2e-3)
    fallen = terminal**2 / GRAVITY_M_S2 * math.log(math.cosh(GRAVITY_M_S2 * 1.5 / terminal))
    assert physics.state.pos_m[2] == pytest.approx(-100.0 + fallen, abs=0.02)
    assert not physics.state.on_ground


def test_terminal_speed() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -400.0))
    run(physics, 12.0, np.zeros(4))
    terminal = math.sqrt(AIRFRAME.mass_kg * GRAVITY_M_S2 / AIRFRAME.body_drag_n_s2_m2[2])
    assert physics.state.vel_m_s[2] == pytest.approx(terminal, rel=5e-3)
    assert physics.state.accel_body_m_s2[2] == pytest.approx(-GRAVITY_M_S2, rel=1e-2)


def test_hover_thrust_balances_weight() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -2.0))
    for _ in range(800):
        physics.step(TICK_US, throttle_of(hover_fraction(physics)))
    # Rotors spin up from rest (falling meanwhile); then the forces balance but for the vertical rotor drag.
    state = physics.state
    assert state.thrust_n.sum() == pytest.approx(AIRFRAME.mass_kg * GRAVITY_M_S2, rel=2e-3)
    assert abs(state.accel_body_m_s2[2] + GRAVITY_M_S2) < 0.2
    assert np.allclose(state.pos_m[:2], 0.0, atol=1e-9) and np.allclose(state.rates_rad_s, 0.0, atol=1e-9)


def test_expo_linearises_thrust() -> None:
    for fraction in (0.05, 0.3, 0.6, 1.0):
        assert AIRFRAME.thrust_fraction(AIRFRAME.throttle_for(fraction)) == pytest.approx(fraction, abs=1e-12)
    # MOT_SPIN_MIN + 0.8 x with 0.45 x + 0.55 x^2 = 0.3
    assert AIRFRAME.throttle_for(0.3) == pytest.approx(0.498, abs=0.001)


def test_rotor_lag_is_the_time_constant() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -50.0))
    physics.step(25_000, throttle_of(1.0))
    speed = physics.state.rpm / AIRFRAME.full_speed_rpm
    assert speed == pytest.approx(np.full(4, 1 - math.exp(-1.0)), rel=1e-6)


def test_steady_tilt_at_5_m_s_is_that_of_a_palm_sized_frame() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -30.0))
    angle = math.radians(12.6)
    for _ in range(16_000):  # held at a tilt with the height thrust: attitude is forced, translation is free
        physics.state.quat[:] = (math.cos(-angle / 2), 0.0, math.sin(-angle / 2), 0.0)
        physics.state.rates_rad_s[:] = 0.0
        physics.step(TICK_US, throttle_of(hover_fraction(physics) / math.cos(angle)))
        physics.state.vel_m_s[2] = 0.0
    assert physics.state.vel_m_s[0] == pytest.approx(5.0, abs=0.15)
    assert physics.state.vel_m_s[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("raised", "axis", "sign"), [
    ((0, 2), 1, +1),  # front pair: nose up
    ((1, 2), 0, +1),  # left pair: right side down
    ((0, 1), 2, +1),  # counter-clockwise pair: nose to the right
])
def test_motor_order_and_signs(raised: tuple[int, int], axis: int, sign: int) -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -30.0))
    throttle = throttle_of(0.3)
    throttle[list(raised)] = AIRFRAME.throttle_for(0.35)
    run(physics, 0.1, throttle)
    rates = physics.state.rates_rad_s
    assert rates[axis] * sign > 0.1
    assert all(abs(rates[other]) < 1e-6 for other in range(3) if other != axis)


def test_angular_acceleration_matches_torque_over_inertia() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -30.0))
    throttle = throttle_of(0.3)
    throttle[[1, 2]] = AIRFRAME.throttle_for(0.31)
    run(physics, 0.15, throttle)
    before = physics.state.rates_rad_s[0]
    physics.step(TICK_US, throttle)
    thrust = physics.state.thrust_n
    lever = AIRFRAME.arm_m * (thrust[1] + thrust[2] - thrust[0] - thrust[3])
    torque = lever - AIRFRAME.rotation_drag_nm_s[0] * before
    gained = physics.state.rates_rad_s[0] - before
    assert gained == pytest.approx(torque / AIRFRAME.inertia_kg_m2[0] * 2.5e-3, rel=0.02)


def test_rests_on_ground_without_drift_or_jitter() -> None:
    physics = Physics(AIRFRAME, (1.0, 2.0, 0.0), wind=SteadyWind(mean_m_s=4.0, direction_deg=30.0))
    run(physics, 1.0, np.zeros(4))
    start = physics.state.pos_m.copy()
    for _ in range(2000):
        physics.step(TICK_US, np.zeros(4))
        assert np.linalg.norm(physics.state.vel_m_s) < 1e-3
    assert np.linalg.norm(physics.state.pos_m - start) < 1e-6
    assert physics.state.on_ground
    assert physics.state.accel_body_m_s2 == pytest.approx([0.0, 0.0, -GRAVITY_M_S2], abs=0.01)
    assert -physics.state.pos_m[2] == pytest.approx(AIRFRAME.foot_height_m, abs=1e-3)


def test_start_on_ground_reads_gravity_at_once() -> None:
    physics = Physics(AIRFRAME)
    assert physics.state.accel_body_m_s2 == pytest.approx([0.0, 0.0, -GRAVITY_M_S2])
    physics.step(TICK_US, np.zeros(4))
    assert physics.state.accel_body_m_s2 == pytest.approx([0.0, 0.0, -GRAVITY_M_S2], abs=0.02)


@pytest.mark.parametrize("roll_rad", [0.0, 0.3])
def test_drop_settles_within_a_second(roll_rad: float) -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -0.33))
    physics.state.quat[:] = (math.cos(roll_rad / 2), math.sin(roll_rad / 2), 0.0, 0.0)
    run(physics, 0.25 + 1.0, np.zeros(4))
    assert np.linalg.norm(physics.state.vel_m_s) < 1e-3
    assert np.linalg.norm(physics.state.rates_rad_s) < 1e-2
    assert tilt_rad(physics) < 0.02


def test_contact_never_adds_energy() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -0.5))
    physics.state.quat[:] = (math.cos(0.2), math.sin(0.2), 0.0, 0.0)
    physics.state.vel_m_s[:] = (1.0, -0.5, 0.0)
    inertia = np.array(AIRFRAME.inertia_kg_m2)
    peak_after_contact, before = 0.0, math.inf
    for _ in range(800):
        state = physics.step(TICK_US, np.zeros(4))
        energy = (0.5 * AIRFRAME.mass_kg * float(state.vel_m_s @ state.vel_m_s)
                  + 0.5 * float(inertia @ state.rates_rad_s**2)
                  - AIRFRAME.mass_kg * GRAVITY_M_S2 * float(state.pos_m[2]))
        if not state.on_ground:  # the springs hold energy while a foot touches: compare in the air only
            assert energy <= before + 2e-3
            before = energy
        else:
            peak_after_contact = max(peak_after_contact, -float(state.pos_m[2]))
    assert 0.0 < peak_after_contact < 0.5


def test_angular_momentum_is_kept_without_torque() -> None:
    spinning = (3.0, 0.2, 1.0)
    free = type(AIRFRAME)(**{**AIRFRAME.__dict__, "rotation_drag_nm_s": (0.0, 0.0, 0.0)})
    physics = Physics(free, (0.0, 0.0, -100.0))
    physics.state.rates_rad_s[:] = spinning
    inertia = np.array(AIRFRAME.inertia_kg_m2)

    def momentum() -> np.ndarray:
        return rotation_of(physics) @ (inertia * physics.state.rates_rad_s)

    start = momentum()
    run(physics, 1.0, np.zeros(4))
    assert np.linalg.norm(momentum() - start) < 0.01 * np.linalg.norm(start)


def test_specific_force_is_consistent_with_motion() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -30.0), wind=SteadyWind(mean_m_s=3.0))
    throttle = throttle_of(0.32)
    throttle[[0, 2]] *= 1.01
    for _ in range(200):
        before = physics.state.vel_m_s.copy()
        physics.step(TICK_US, throttle)
        specific = rotation_of(physics) @ physics.state.accel_body_m_s2
        gained = (specific + np.array([0.0, 0.0, GRAVITY_M_S2])) * 2.5e-3
        assert physics.state.vel_m_s - before == pytest.approx(gained, abs=1e-9)


def test_same_inputs_are_bit_equal_and_gusts_follow_the_seed() -> None:
    def fly(seed: int, tick_us: int = TICK_US) -> bytes:
        physics = Physics(AIRFRAME, (0.0, 0.0, -5.0), SteadyWind(2.0, 45.0, 1.0, 1.0), seed=seed)
        for _ in range(2_000_000 // tick_us):
            physics.step(tick_us, throttle_of(0.3))
        return physics.state.flat.tobytes() + physics.state.rpm.tobytes() + physics.wind_m_s.tobytes()

    assert fly(7) == fly(7)
    assert fly(7) != fly(8)


def test_gusts_are_the_same_whatever_the_step() -> None:
    wind = SteadyWind(2.0, 0.0, 1.0, 1.0)
    slow, fast = (Physics(AIRFRAME, (0.0, 0.0, -5.0), wind, seed=3) for _ in range(2))
    for _ in range(4000):
        slow.step(2500, np.zeros(4))
        fast.step(1250, np.zeros(4))
        assert fast.wind_m_s == pytest.approx(slow.wind_m_s, abs=1e-12)
        fast.step(1250, np.zeros(4))


def test_gust_statistics() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -5.0), SteadyWind(3.0, 90.0, 1.2, 0.5), seed=11)
    samples = []
    for _ in range(30_000):  # 300 s: about 300 independent samples
        samples.append(physics._gusts.at(len(samples) * 10_000))
    wind = np.array(samples)
    assert wind.mean(axis=0) == pytest.approx([0.0, 3.0, 0.0], abs=0.25)
    assert wind.std(axis=0) == pytest.approx([1.2, 1.2, 0.6], rel=0.15)
    step = np.mean((wind[50:, 0] - wind[:-50, 0]) ** 2) / 2 / 1.2**2  # one time constant apart: 1 - 1/e
    assert step == pytest.approx(1 - math.exp(-1.0), rel=0.15)


def test_wind_pushes_downwind() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -30.0), SteadyWind(mean_m_s=2.0, direction_deg=90.0))
    for _ in range(400):
        physics.step(TICK_US, throttle_of(hover_fraction(physics)))
    assert 0.1 < physics.state.vel_m_s[1] < 2.0
    assert abs(physics.state.vel_m_s[0]) < 1e-9


def test_symmetric_left_and_right() -> None:
    left, right = (Physics(AIRFRAME, (0.0, 0.0, -30.0), SteadyWind(2.0, d)) for d in (-90.0, 90.0))
    run(left, 1.0, throttle_of(0.3))
    run(right, 1.0, throttle_of(0.3))
    assert left.state.vel_m_s * [1, -1, 1] == pytest.approx(right.state.vel_m_s, abs=1e-12)


def test_motor_fault_tilts_towards_it_and_yaws() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -30.0))
    run(physics, 0.2, throttle_of(0.3))
    physics.motor_scale[0] = 0.5  # front right, counter-clockwise
    run(physics, 0.05, throttle_of(0.3))
    rolled, pitched, yawed = physics.state.rates_rad_s
    assert rolled > 0.5 and pitched < -0.5  # right side and nose go down
    assert yawed < -0.01  # less of its clockwise reaction


def test_battery_sags_and_drains_in_about_five_minutes() -> None:
    physics = Physics(AIRFRAME, (0.0, 0.0, -2.0))
    full = physics.state.voltage_v
    assert full == pytest.approx(16.8)
    for _ in range(400):
        physics.step(TICK_US, throttle_of(hover_fraction(physics)))
        physics.state.vel_m_s[:] = 0.0
    state = physics.state
    assert state.voltage_v * state.current_a == pytest.approx(103.0, rel=0.03)
    assert full - state.voltage_v == pytest.approx(state.current_a * 0.032, abs=0.05)
    minutes = 0.8 * AIRFRAME.battery.capacity_ah / state.current_a * 60
    assert 4.5 < minutes < 7.0
    drained = Physics(AIRFRAME, (0.0, 0.0, -2.0), charge=0.1)
    run(drained, 0.3, throttle_of(1.0))
    fresh = Physics(AIRFRAME, (0.0, 0.0, -2.0))
    run(fresh, 0.3, throttle_of(1.0))
    assert 0.6 < drained.state.thrust_n[0] / fresh.state.thrust_n[0] < 0.95


def test_throttle_outside_its_range_is_held_to_it() -> None:
    a, b = (Physics(AIRFRAME, (0.0, 0.0, -5.0)) for _ in range(2))
    run(a, 0.1, np.array([math.nan, -3.0, 7.0, 1.0]))
    run(b, 0.1, np.array([0.0, 0.0, 1.0, 1.0]))
    assert a.state.flat.tobytes() == b.state.flat.tobytes()


def test_bad_airframe_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"unknown airframe 'pearbat161'.*did you mean 'pearbat160'"):
        load_airframe("pearbat161")
    from saranga.fixtures import fixture_path

    text = fixture_path("airframes", "pearbat160").read_text()
    for old, new, complaint in [
        ("mass_kg = 0.46", "mass_kg = -1.0", r"body.mass_kg = -1 must be within"),
        ("mass_kg = 0.46", "", r"key 'mass_kg' is missing"),
        ("inertia_kg_m2 = [5.5e-4, 6.5e-4, 9.5e-4]", "inertia_kg_m2 = [1.0]",
         r"inertia_kg_m2 = \[1.0\] must be three"),
        ("friction = 0.7", "friction = 'much'", r"could not convert string to float"),
    ]:
        assert old in text
        bad = tmp_path / "bad.toml"
        bad.write_text(text.replace(old, new))
        with pytest.raises(UsageError, match=complaint):
            load_airframe(str(bad))
