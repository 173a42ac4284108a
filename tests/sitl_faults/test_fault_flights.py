"""Faults in flight: each does what it says, its cause is named, and how the vehicle came down is seen to its end."""

import pytest

from bench.campaign.behaviour import behaviour_of
from sitl.trial import run_trial
from sitl.trial_types import Faults, TrialRequest, TrialResult

AUTOPILOTS = ["embedded", pytest.param("arducopter", marks=[pytest.mark.real_arducopter, pytest.mark.slow])]


def fly(*faults: str, autopilot: str = "embedded", scene: str = "open") -> TrialResult:
    return run_trial(TrialRequest(scene, seed=3, autopilot=autopilot, denoiser="gaussian", faults=Faults.parse(faults)))


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_lost_flow_ends_in_a_failsafe_that_lands(autopilot: str) -> None:
    result = fly("flow_lost=1@2", autopilot=autopilot)
    assert result.outcome == "estimator_failure" and "EKF" in result.cause and "landed after" in result.cause
    assert behaviour_of(result.to_dict()) == "failsafe" and not result.success_strict


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_lost_setpoints_stop_the_vehicle_within_its_time_out(autopilot: str) -> None:
    result = fly("setpoints_lost=1@2", autopilot=autopilot)
    assert behaviour_of(result.to_dict()) == "stopped" and result.measures["end_speed_m_s"] < 0.2
    assert result.log is not None
    assert 5.0 < float(result.log.pos_m[-1, 0]) < 7.5, "GUID_TIMEOUT is 3 s at 1 m/s, then it brakes"


def test_what_the_stack_sees_by_itself_it_names_and_holds() -> None:
    result = fly("cycles_dropped=1@2")
    assert "echo source silent" in result.cause and behaviour_of(result.to_dict()) == "held"
    assert result.measures["end_speed_m_s"] < 0.5


def test_an_empty_battery_is_no_failsafe() -> None:
    assert behaviour_of(fly("battery_charge=0@2").to_dict()) == "lost"


def test_late_setpoints_are_measured() -> None:
    prompt, late = fly(), fly("setpoint_delay_ms=100")
    apart = late.measures["echo_to_setpoint_ms"] - prompt.measures["echo_to_setpoint_ms"]
    assert apart == pytest.approx(100.0, abs=1.0)


def test_a_planted_fault_that_never_came_is_no_pass() -> None:
    result = fly("flow_lost=1@60")
    assert result.outcome == "infrastructure" and "flow_lost=1@60 never happened" in result.cause
    assert behaviour_of(result.to_dict()) == "broken"
