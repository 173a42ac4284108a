"""The companion as its own process over TCP: what the bench measures from outside is what was planted inside."""

from pathlib import Path
from statistics import median

import pytest
from hil_helpers import fly, own_steps_ms, plant_delay, saranga_run, wire_rows

from bench.hil.timing import TICK_MS

# The wire, the two clocks and the operating system may add or take this much.
TOLERANCE_MS = 4.0
ALL = [pytest.param(autopilot, delay_ms, marks=[pytest.mark.slow, *marks])
       for autopilot, marks in (("embedded", []), ("arducopter", [pytest.mark.real_arducopter]))
       for delay_ms in (0.0, 20.0, 60.0, 100.0)]


def check_flight(folder: Path, monkeypatch: pytest.MonkeyPatch, autopilot: str, delay_ms: float) -> None:
    plant_delay(monkeypatch, delay_ms)
    log = folder / "companion.jsonl"
    result, figures = fly(folder, saranga_run(log, "--stack", "delayed_stack:Delayed"), autopilot)
    assert result.outcome == "clean" and result.landed, result.cause
    assert figures["basis"] == "stamps" and figures["lost_mavlink_frames"] == 0
    assert figures["echo_cycles"] > 100 and figures["echo_cycles_dropped"] == 0

    own = own_steps_ms(log)
    pairs = [(own[stamp], response) for stamp, response in wire_rows(result) if stamp in own]
    assert len(pairs) == figures["setpoints"] > 30
    extra = median(response - step for step, response in pairs)
    print(f"{autopilot} planted {delay_ms:g} ms: own median {median(s for s, _ in pairs):.1f} ms, measured "
          f"{figures['response_ms']['median']:.1f} ms, misses own {sum(s > TICK_MS for s, _ in pairs)}, measured "
          f"{figures['deadline_misses']} of {figures['setpoints']}, {figures['setpoint_rate_hz']:.1f} Hz")
    assert 0.0 <= extra < TOLERANCE_MS, "outside and inside are the same but for the wire"
    surely = sum(step > TICK_MS for step, _ in pairs)
    perhaps = sum(response > TICK_MS - TOLERANCE_MS for _, response in pairs)
    assert surely <= figures["deadline_misses"] <= perhaps
    if delay_ms > TICK_MS:
        assert figures["deadline_miss_share"] == 1.0 and figures["setpoint_rate_hz"] < 1000.0 / delay_ms + 0.5
    elif delay_ms < TICK_MS / 2:
        assert figures["deadline_miss_share"] < 0.2, "this machine was busy, yet not that busy"
    assert figures["latency_ms"]["median"] > delay_ms and not figures["latency_is_lower_bound"]


@pytest.mark.wall_time
@pytest.mark.xdist_group("wall_time")
def test_a_companion_that_is_100_ms_late_misses_every_deadline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_flight(tmp_path, monkeypatch, "embedded", 100.0)


@pytest.mark.wall_time
@pytest.mark.xdist_group("wall_time")
@pytest.mark.parametrize(("autopilot", "delay_ms"), ALL)
def test_measured_misses_agree_with_the_delay_planted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, autopilot: str, delay_ms: float
) -> None:
    check_flight(tmp_path, monkeypatch, autopilot, delay_ms)
