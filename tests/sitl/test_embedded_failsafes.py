"""What the embedded autopilot does when something fails in the air, timed as measured on the real ArduCopter."""

import numpy as np
import pytest
from embedded_bench import Bench

from saranga.vehicle import MODE_GUIDED, MODE_LAND


@pytest.fixture
def flying() -> Bench:
    bench = Bench()
    bench.take_off(1.0)
    return bench


def landed(bench: Bench) -> bool:
    return not bench.vehicle.armed


def test_flow_lost_lands_after_two_seconds(flying: Bench) -> None:
    """Real: EKF variance, LAND after 1.9 s."""
    flying.sensors.flow_enabled = False
    took_s = flying.run(5.0, until=lambda: flying.vehicle.mode == MODE_LAND)
    assert took_s == pytest.approx(1.9, abs=0.2)
    flying.run(10.0, until=lambda: landed(flying))
    assert landed(flying) and flying.physics.state.on_ground
    assert "EKF variance" in flying.texts
    assert flying.speed_m_s() < 0.05


def test_range_lost_lands_after_six_seconds(flying: Bench) -> None:
    """Real: LAND after 6.4 s."""
    flying.sensors.range_enabled = False
    took_s = flying.run(10.0, until=lambda: flying.vehicle.mode == MODE_LAND)
    assert took_s == pytest.approx(6.4, abs=0.3)
    assert flying.height_m == pytest.approx(1.0, abs=0.3), "held by the barometer meanwhile"
    flying.run(12.0, until=lambda: landed(flying))
    assert landed(flying) and flying.physics.state.on_ground


def test_a_short_gap_in_flow_does_no_harm(flying: Bench) -> None:
    flying.sensors.flow_enabled = False
    flying.run(0.6)
    flying.sensors.flow_enabled = True
    flying.run(3.0)
    assert flying.vehicle.mode == MODE_GUIDED and flying.vehicle.armed
    assert flying.speed_m_s() < 0.15


def test_ground_station_lost_lands_after_five_seconds(flying: Bench) -> None:
    flying.heartbeat = False
    took_s = flying.run(10.0, until=lambda: flying.vehicle.mode == MODE_LAND)
    assert 4.0 < took_s <= 5.2
    flying.run(1.0)
    assert "GCS Failsafe" in flying.texts
    flying.run(10.0, until=lambda: landed(flying))
    assert landed(flying)


def test_ground_station_failsafe_can_be_switched_off() -> None:
    bench = Bench(parameters={"FS_GCS_ENABLE": 0.0})
    bench.take_off(1.0)
    bench.heartbeat = False
    bench.run(10.0)
    assert bench.vehicle.mode == MODE_GUIDED and bench.height_m > 0.9


def test_low_battery_lands_and_says_the_voltage() -> None:
    bench = Bench(parameters={"BATT_LOW_VOLT": 16.7, "BATT_LOW_TIMER": 2.0, "BATT_ARM_VOLT": 10.0})
    bench.take_off(1.0)
    took_s = bench.run(6.0, until=lambda: bench.vehicle.mode == MODE_LAND)
    assert took_s < 4.0
    bench.run(1.0)
    assert any(text.startswith("Battery 1 is low 16.") for text in bench.texts)
    bench.run(10.0, until=lambda: landed(bench))
    assert landed(bench)


def test_a_dead_motor_ends_in_a_crash_that_stops_the_others(flying: Bench) -> None:
    flying.physics.motor_scale[0] = 0.0
    flying.run(6.0, until=lambda: landed(flying))
    assert landed(flying), "motors must not run on a crashed vehicle"
    flying.run(1.0)
    assert any("Crash: Disarming" in text for text in flying.texts) or "Landed" in flying.texts
    assert float(np.max(flying.physics.state.thrust_n)) < 0.01


def test_a_weak_motor_is_flown_through(flying: Bench) -> None:
    flying.physics.motor_scale[2] = 0.8
    flying.run(5.0, (0.0, 0.0, 0.0))
    assert flying.height_m == pytest.approx(1.0, abs=0.2)
    assert flying.speed_m_s() < 0.2
