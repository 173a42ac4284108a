"""The meter on made-up traffic, where the truth is known."""

from pathlib import Path

import pytest

from bench.flight_summary import limit_to_dict
from bench.hil.figure import setpoint_figures
from bench.hil.flight import _write_rows
from bench.hil.summary import (
    companion_checks,
    companion_text,
    header_entry,
    load_companion_limits,
    with_companion,
)
from bench.hil.timing import TICK_MS, WireTiming
from bench.verdict import Verdict
from saranga.navigate import VelocityCommand
from saranga.vehicle import VehicleLink

TICK_S = TICK_MS / 1e3
THEIR_CLOCK_S = -1234.5
"""Their time is ours plus this."""


def traffic(step_s: float, seconds: float = 10.0, answers: bool = True, skip: tuple[int, ...] = (),
            lose: tuple[int, ...] = (), still: bool = False) -> WireTiming:
    """A companion that takes echoes at its 16 Hz tick, or as soon as it is done with the tick before."""
    timing, link = WireTiming(), VehicleLink()
    questions = []
    events: list[tuple[float, str, float]] = [(k * 0.0256, "cycle", 0.0) for k in range(int(seconds / 0.0256))]
    events += [(k * 0.0025, "ask", 0.0) for k in range(int(seconds / 0.0025))]
    taken, number = 0.031, 0
    while taken < seconds:
        events += [(taken, "take", taken), (taken + step_s, "sent", taken + number * 1e-9)]
        taken, number = max(taken + TICK_S, taken + step_s), number + 1
    timing.begin(1.0)
    sent = 0
    waiting: list[bytes] = []
    for now, kind, taken in sorted(events):
        theirs_us = round((now + 5000.0 + THEIR_CLOCK_S) * 1e6)
        if kind == "cycle":
            timing.cycle(now, True)
        elif kind == "ask":
            data = timing.question(now)
            if data:
                questions.append(data)
        elif kind == "take" and answers:
            for data in questions:
                link.feed(data, theirs_us)
            questions.clear()
            waiting.append(link.take())
        elif kind == "sent":
            timing.hear(waiting.pop(0) if waiting else b"", now)
            stamp_us = 7_000_000 if still else round((taken + 5000.0 + THEIR_CLOCK_S) * 1e6)
            link.send_velocity(VelocityCommand(1.0, 0.0, 0.0), stamp_us)
            data = link.take()
            sent += 1
            if sent not in skip and sent not in lose:
                timing.hear(data, now)
            elif sent in skip:
                link._mav.seq = (link._mav.seq - 1) & 0xFF
    timing.end(seconds)
    return timing


@pytest.mark.parametrize("step_ms", [0.5, 20.0, 60.0])
def test_a_step_within_the_tick_misses_nothing_and_is_measured(step_ms: float) -> None:
    figures = traffic(step_ms / 1e3).figures()
    assert figures["basis"] == "stamps" and figures["deadline_misses"] == 0 and figures["missed_ticks"] == 0
    assert figures["response_ms"]["median"] == pytest.approx(step_ms, abs=3.2)
    assert figures["setpoint_rate_hz"] == pytest.approx(16.0, abs=0.2)
    # A cycle waits for the tick, on the mean half of one, and then for the step.
    assert figures["latency_ms"]["median"] == pytest.approx(TICK_MS / 2 + step_ms, abs=5.0)
    assert figures["latency_ms"]["max"] < TICK_MS + step_ms + 4.0 and not figures["latency_is_lower_bound"]


@pytest.mark.parametrize("step_ms", [66.5, 100.0])
def test_a_step_longer_than_the_tick_misses_every_deadline(step_ms: float) -> None:
    figures = traffic(step_ms / 1e3).figures()
    assert figures["deadline_miss_share"] == 1.0
    assert figures["setpoint_rate_hz"] == pytest.approx(1000.0 / step_ms, abs=0.3)


@pytest.mark.parametrize(("step_ms", "share"), [(20.0, 0.0), (100.0, 1.0)])
def test_without_answers_the_intervals_tell_and_latency_is_a_lower_bound(step_ms: float, share: float) -> None:
    figures = traffic(step_ms / 1e3, answers=False).figures()
    assert figures["basis"] == "arrivals" and figures["deadline_miss_share"] == share
    assert figures["latency_is_lower_bound"] and figures["response_ms"] is None


def test_stamps_that_stand_still_are_not_believed() -> None:
    assert traffic(0.02, still=True).figures()["basis"] == "arrivals"


def test_gaps_and_lost_frames_are_counted() -> None:
    figures = traffic(0.005, skip=(40, 41), lose=(60,)).figures()
    assert figures["missed_ticks"] == 3 and figures["lost_mavlink_frames"] == 1
    assert figures["longest_gap_ms"] == pytest.approx(3 * TICK_MS, abs=1.0)


def test_silence_at_the_end_of_the_course_is_a_gap() -> None:
    figures = traffic(0.005, skip=tuple(range(100, 1000))).figures()
    assert figures["longest_gap_ms"] > 3000.0


def test_a_dropped_cycle_counts() -> None:
    timing = WireTiming()
    timing.begin(0.0)
    timing.cycle(0.1, False)
    timing.end(1.0)
    assert timing.figures()["echo_cycles_dropped"] == 1


def held(figures: list[dict]) -> dict[str, Verdict]:
    limits = [limit_to_dict(limit) for limit in load_companion_limits("hil")]
    trials = [{"link_counters": {"companion": f}} for f in figures]
    return {c.name: c.verdict for c in companion_checks({"limits": limits}, trials)}


def test_limits_pass_a_good_companion_and_fail_a_late_one() -> None:
    assert set(held([traffic(0.01).figures()]).values()) == {Verdict.PASS}
    assert held([traffic(0.01).figures(), traffic(0.1).figures()]) == {
        "deadline_miss_share": Verdict.FAIL, "setpoint_rate_hz": Verdict.FAIL, "longest_gap_ms": Verdict.PASS,
        "setpoints_not_finite": Verdict.PASS}


@pytest.mark.parametrize("field", ["vx_m_s", "vy_m_s", "vz_m_s", "yaw_rate_rad_s"])
def test_a_setpoint_that_is_not_a_number_fails(field: str) -> None:
    timing, link = traffic(0.01), VehicleLink()
    assert timing.figures()["setpoints_not_finite"] == 0
    timing.ended_s = None
    link.send_velocity(VelocityCommand(**{"vx_m_s": 1.0, "vy_m_s": 0.0, "vz_m_s": 0.0, field: float("nan")}), 0)
    timing.hear(link.take(), 9.99)
    timing.end(10.0)
    assert timing.figures()["setpoints_not_finite"] == 1
    assert held([timing.figures()])["setpoints_not_finite"] is Verdict.FAIL


@pytest.mark.parametrize("figures", [
    [], [WireTiming().figures()], [traffic(0.01).figures(), WireTiming().figures()], [traffic(0.01, 2.0).figures()]],
    ids=["no flight", "never measured", "one not measured", "too few"])
def test_what_was_not_measured_never_passes(figures: list[dict]) -> None:
    assert not [v for v in held(figures).values() if v.accepted]


def test_no_setpoint_at_all_is_no_pass() -> None:
    timing = WireTiming()
    timing.begin(0.0)
    timing.end(10.0)
    figures = timing.figures()
    assert figures["deadline_miss_share"] is None and figures["longest_gap_ms"] == 10_000.0
    assert not [v for v in held([figures]).values() if v.accepted]


def summary_of(figures: dict) -> dict:
    summary = {"trials_planned": 1, "outcomes": [{"seed": 1, "files": {}}],
               "checks": [{"name": "longest_gap_ms", "limit": "<= 1000 ms", "verdict": "PASS", "why": "it is within"}]}
    trial = {"seed": 1, "request": {"scene": "open", "autopilot": "embedded", "shield": "foam", "sonar": "pair",
                                    "faults": {"drop_probability": 0.1}}, "link_counters": {"companion": figures}}
    with_companion(summary, header_entry("tcp://127.0.0.1:1", "tcp://127.0.0.1:2", ["./my stack"], []), [trial])
    return summary


def test_the_table_and_the_line_that_flies_it_again() -> None:
    summary = summary_of(traffic(0.1).figures())
    text = companion_text(summary)
    assert "deadline misses" in text and "(100.0%)" in text and "by its own stamps" in text
    assert "limit longest_gap_ms <= 1000 ms: PASS" in text
    assert summary["outcomes"][0]["replay"] == (
        "saranga-bench hil open --autopilot embedded --shield foam --sonar pair --fault drop_probability=0.1 --seed 1 "
        "--listen tcp://127.0.0.1:1 --mavlink tcp://127.0.0.1:2 -- './my stack'")


def test_a_table_of_nothing_measured_has_no_numbers() -> None:
    text = companion_text(summary_of(WireTiming().figures()))
    assert "not measured" in text and "0.0%" not in text and "16" not in text


def test_every_setpoint_is_drawn_and_the_late_ones_stand_out(tmp_path: Path) -> None:
    timing = traffic(0.1)
    _write_rows(timing, tmp_path)
    drawn = setpoint_figures(tmp_path, [{"seed": 3, "files": {"wire": "setpoints.csv"}}, {"seed": 4, "files": {}},
                                        {"seed": 5, "files": {"wire": "gone.csv"}}])
    assert drawn[0]["svg"].count("<circle") == drawn[0]["svg"].count("--fail") == len(timing.measured())
    assert "no setpoint" in drawn[1]["missing"] and "cannot be read" in drawn[2]["missing"]
