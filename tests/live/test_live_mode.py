"""Live mode: the stack in its own process, echoes over a pty or TCP, MAVLink over TCP, wall time."""

import psutil
import pytest

from sitl.live import run_live_trial
from sitl.trial_types import TrialRequest


@pytest.mark.wall_time
@pytest.mark.xdist_group("wall_time")
@pytest.mark.parametrize("autopilot,echoes", [
    pytest.param("embedded", "pty"), pytest.param("embedded", "tcp"),
    pytest.param("arducopter", "pty", marks=pytest.mark.real_arducopter)])
def test_a_companion_process_flies_the_course(autopilot: str, echoes: str) -> None:
    result = run_live_trial(TrialRequest("poles", seed=1, autopilot=autopilot), echoes=echoes)
    # Wall time is not repeatable, so the flight must be judged, landed or hit, by the course itself.
    assert result.outcome in {"clean", "obstacle_hit", "net_hit"}, result.cause
    assert result.link_counters["setpoints"] > 5 * result.duration_s, "setpoints must flow at about 16 Hz"
    assert result.link_counters["bad_crc"] == 0 and result.link_counters["bad_cobs"] == 0
    assert result.realtime_factor < 4.0, "the course is flown in wall time"
    assert not [p for p in psutil.Process().children(recursive=True) if p.status() != psutil.STATUS_ZOMBIE]


@pytest.mark.wall_time
@pytest.mark.xdist_group("wall_time")
def test_a_companion_that_cannot_start_is_named() -> None:
    from saranga.errors import DeviceError

    with pytest.raises(DeviceError, match=r"companion process ended \(exit code 2\).*no-such-denoiser"):
        run_live_trial(TrialRequest("open", denoiser="no-such-denoiser"))
