"""Things that break in flight: each ends as ERROR or judged, its cause named; never a pass, never a hang."""

import psutil
import pytest

from bench.flight_summary import trial_verdict
from bench.verdict import Verdict
from saranga.errors import UsageError
from sitl.live import run_live_trial
from sitl.trial import run_trial
from sitl.trial_types import Faults, TrialRequest

AUTOPILOTS = ["embedded", pytest.param("arducopter", marks=pytest.mark.real_arducopter)]

# (fault, outcomes it may end in, words the cause must contain)
CASES = {
    "autopilot killed": (Faults(kill_autopilot_at_s=2.0), {"infrastructure"}, "kill"),
    "echo source silent": (Faults(echo_silent_at_s=2.0), {"infrastructure"}, "echo source silent"),
    "right sensor dead": (Faults(dead_sensor="right", dead_sensor_at_s=2.0), {"infrastructure"}, "sensor right silent"),
    "left sensor dead": (Faults(dead_sensor="left", dead_sensor_at_s=2.0), {"infrastructure"}, "sensor left silent"),
    "every frame corrupted": (Faults(corrupt_probability=1.0), {"infrastructure"}, "silent"),
    "policy returns NaN": (Faults(nan_policy_at_s=2.0), {"infrastructure"}, "not finite"),
}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("case", CASES)
def test_a_fault_ends_the_flight_with_its_cause(case: str, autopilot: str) -> None:
    faults, outcomes, words = CASES[case]
    result = run_trial(TrialRequest("open", seed=3, autopilot=autopilot, faults=faults, keep_log=False))
    assert result.outcome in outcomes, result.cause
    assert words in result.cause.lower() or words in result.cause
    assert not result.success_strict and not result.success_lenient
    assert trial_verdict(result.to_dict()) is Verdict.ERROR
    assert not [p for p in psutil.Process().children(recursive=True) if "arducopter" in p.name()]


@pytest.mark.real_arducopter
def test_a_lost_physics_socket_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.autopilot.arducopter.ANSWER_DEADLINE_S", 1.0)
    result = run_trial(TrialRequest("open", seed=3, autopilot="arducopter", keep_log=False,
                                    faults=Faults(physics_socket_lost_at_s=2.0)))
    assert result.outcome == "infrastructure" and "physics socket lost" in result.cause


def test_a_little_corruption_is_counted_and_survived() -> None:
    result = run_trial(TrialRequest("open", seed=3, faults=Faults(corrupt_probability=0.05), keep_log=False))
    bad = result.link_counters["bad_crc"] + result.link_counters["bad_cobs"]
    assert bad > 10 and result.link_counters["sequence_gaps"] > 10
    assert result.outcome == "clean", result.cause


def test_late_setpoints_change_the_flight_but_stay_judged() -> None:
    prompt = run_trial(TrialRequest("poles", seed=1, keep_log=False))
    late = run_trial(TrialRequest("poles", seed=1, keep_log=False, faults=Faults(setpoint_delay_ms=400)))
    assert late.determinism_hash != prompt.determinism_hash
    assert late.outcome in {"clean", "obstacle_hit", "net_hit", "timeout", "stuck"} and late.cause


@pytest.mark.parametrize("faults,says", [
    (Faults(dead_sensor="down"), "has only left, right"), (Faults(physics_socket_lost_at_s=1.0), "no physics socket")])
def test_a_fault_that_cannot_happen_is_refused(faults: Faults, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        run_trial(TrialRequest("open", faults=faults))


def test_a_fault_that_came_too_late_is_no_pass() -> None:
    result = run_trial(TrialRequest("open", seed=3, faults=Faults(echo_silent_at_s=60.0), keep_log=False))
    assert result.outcome == "infrastructure" and "never happened" in result.cause and not result.success_strict


def test_faults_inside_the_stack_are_refused_in_live_mode() -> None:
    with pytest.raises(UsageError, match="nan_policy_at_s acts inside the stack"):
        run_live_trial(TrialRequest("open", faults=Faults(nan_policy_at_s=1.0)))
