"""Flow and range as MAVLink: signs, scale, and no bias from the coarse counts."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.airframe import load_airframe
from sitl.physics import Physics, SteadyWind
from sitl.sensors import FLOW_COUNT_RAD_S, FlightSensors


def messages(velocity: tuple[float, float, float], height_m: float, seconds: float = 10.0,
             rates: tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 1) -> dict[str, list[object]]:
    """Messages of a vehicle held level at `height_m` with a velocity in body axes."""
    state = Physics(load_airframe(), np.zeros(3), SteadyWind(), 1).state
    state.pos_m[2] = -height_m
    state.vel_m_s[:] = velocity
    state.rates_rad_s[:] = rates
    sensors, parser = FlightSensors(seed), mavlink.MAVLink(None)
    out: dict[str, list[object]] = {}
    for tick in range(int(seconds * 400)):
        state.t_us = tick * 2500
        for message in parser.parse_buffer(sensors.step(state)) or []:
            out.setdefault(message.get_type(), []).append(message)
    return out


@pytest.mark.parametrize("velocity,rates,expected_x,expected_y", [
    ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 1.0 / 1.25),
    ((0.0, 0.5, 0.0), (0.0, 0.0, 0.0), -0.5 / 1.25, 0.0),
    ((0.0, 0.0, 0.0), (0.3, -0.2, 0.0), 0.3, -0.2),
])
def test_mean_flow_has_ardupilots_sign_and_no_rounding_bias(
    velocity: tuple[float, float, float], rates: tuple[float, float, float], expected_x: float, expected_y: float
) -> None:
    flow = messages(velocity, 1.25, rates=rates)["OPTICAL_FLOW"]
    assert len(flow) == 500
    mean_x = FLOW_COUNT_RAD_S * float(np.mean([m.flow_x for m in flow]))  # type: ignore[attr-defined]
    mean_y = FLOW_COUNT_RAD_S * float(np.mean([m.flow_y for m in flow]))  # type: ignore[attr-defined]
    # 500 samples of 0.02 rad/s noise: the mean is good to 0.003 at three sigma; one count is 0.02.
    assert mean_x == pytest.approx(expected_x, abs=0.003)
    assert mean_y == pytest.approx(expected_y, abs=0.003)


def test_range_is_the_height_and_never_below_what_the_autopilot_accepts() -> None:
    air = messages((0, 0, 0), 1.25, 2.0)["DISTANCE_SENSOR"]
    assert len(air) == 40
    assert np.mean([m.current_distance for m in air]) == pytest.approx(125, abs=0.5)  # type: ignore[attr-defined]
    ground = messages((0, 0, 0), 0.0, 2.0)["DISTANCE_SENSOR"]
    assert min(m.current_distance for m in ground) >= 2  # type: ignore[attr-defined]


def test_same_seed_same_bytes_other_seed_other_bytes() -> None:
    def flow(seed: int) -> list[tuple[int, int]]:
        return [(m.flow_x, m.flow_y) for m in messages((1, 0, 0), 1.0, 1.0, seed=seed)["OPTICAL_FLOW"]]  # type: ignore

    assert flow(3) == flow(3) and flow(3) != flow(4)


def test_a_lost_sensor_is_silent_and_the_other_goes_on() -> None:
    state = Physics(load_airframe(), np.zeros(3), SteadyWind(), 1).state
    sensors = FlightSensors(1)
    sensors.flow_enabled = False
    kinds = set()
    for tick in range(400):
        state.t_us = tick * 2500
        kinds |= {m.get_type() for m in mavlink.MAVLink(None).parse_buffer(sensors.step(state)) or []}
    assert kinds == {"DISTANCE_SENSOR"}
