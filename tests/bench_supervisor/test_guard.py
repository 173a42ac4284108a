"""The supervisor's decisions, one rule a test."""

import math

import pytest

from bench.supervisor.guard import Guard, Timing, Trip
from bench.supervisor.limits import Limits
from bench.thrust_stand.protocol import StandReading
from saranga.errors import UsageError

TICK_S = 0.01
GOOD = StandReading(0.0, thrust_n=1.0, current_a=3.0, voltage_v=16.0, rpm=9000.0, vibration_m_s2=2.0,
                    esc_temperature_c=40.0, motor_temperature_c=45.0)
LIMITS = Limits(thrust_n=5.0, current_a=10.0, voltage_low_v=13.0, rpm=20_000.0, esc_temperature_c=80.0,
                motor_temperature_c=90.0, vibration_m_s2=50.0, throttle=0.9, slew_per_s=2.0)


class Bench:
    """A guard, a device that does what it is told, and a control loop, on one clock."""

    def __init__(self, limits: Limits = LIMITS, confirmed: bool = True, readback: bool = True,
                 latched: tuple[Trip, ...] = ()) -> None:
        self.guard = Guard(limits, Timing(), confirmed, readback, latched)
        self.now_s = 100.0
        self.reading: StandReading | None = GOOD
        self.obeys = True
        self.alive = True
        self.commands: list[tuple[float, float]] = []

    def tick(self) -> float:
        self.now_s += TICK_S
        if self.alive:
            self.guard.refresh(self.now_s)
        if self.reading is not None:
            self.guard.reading(self.reading, self.now_s)
        value = self.guard.tick(self.now_s)
        if self.obeys and self.guard.readback:
            self.guard.applied(value, self.guard.token, self.now_s)
        self.commands.append((self.now_s, value))
        return value

    def run(self, seconds: float) -> float:
        for _ in range(round(seconds / TICK_S)):
            value = self.tick()
        return value

    def spin(self, value: float = 0.5) -> None:
        self.run(0.05)
        self.guard.set(value, self.now_s)
        assert self.run(1.0) == value and self.guard.state == "hold"

    def ms_to_idle(self) -> float:
        """Runs until the command is zero; how long that took."""
        begin_s = self.now_s
        while self.tick() > 0:
            assert self.now_s - begin_s < 2.0
        return (self.now_s - begin_s) * 1e3


def test_a_run_goes_through_its_states() -> None:
    bench = Bench()
    seen = []
    for target, seconds in ((0.0, 0.1), (0.5, 0.6), (0.2, 0.5), (0.0, 0.5)):
        bench.guard.set(target, bench.now_s)
        bench.run(seconds)
        seen += [e.text for e in bench.guard.events if e.kind == "state"]
        bench.guard.events.clear()
    assert seen == ["ramp", "hold", "ramp-down", "hold", "ramp-down", "idle"]
    bench.guard.stop("done", bench.now_s)
    bench.run(0.1)
    assert bench.guard.state == "stopped" and not bench.guard.trips


def test_the_throttle_rises_and_falls_no_faster_than_its_slew() -> None:
    bench = Bench()
    bench.run(0.05)
    bench.guard.set(0.8, bench.now_s)
    bench.run(1.0)
    bench.guard.set(0.1, bench.now_s)
    bench.run(1.0)
    steps = [b - a for (_, a), (_, b) in zip(bench.commands, bench.commands[1:], strict=False)]
    assert max(map(abs, steps)) <= LIMITS.slew_per_s * TICK_S + 1e-9


@pytest.mark.parametrize("change", [
    {"thrust_n": 5.1}, {"thrust_n": -5.1}, {"current_a": 10.5}, {"voltage_v": 12.9}, {"rpm": 20_100.0},
    {"esc_temperature_c": 80.5}, {"motor_temperature_c": 91.0}, {"vibration_m_s2": 51.0}])
def test_each_limit_takes_the_throttle_away_at_once_and_latches(change: dict[str, float]) -> None:
    bench = Bench()
    bench.spin()
    bench.reading = StandReading(**{**vars(GOOD), **change})
    assert bench.ms_to_idle() <= 60.0
    bench.reading = GOOD
    bench.guard.set(0.5, bench.now_s)
    assert bench.run(1.0) == 0.0 and bench.guard.state == "tripped" and len(bench.guard.trips) == 1
    assert "beyond" in bench.guard.why() or "below" in bench.guard.why()


@pytest.mark.parametrize("quantity", ["thrust_n", "current_a", "voltage_v", "rpm", "esc_temperature_c",
                                      "motor_temperature_c", "vibration_m_s2"])
def test_a_limited_quantity_that_turns_nan_trips(quantity: str) -> None:
    bench = Bench()
    bench.spin()
    bench.reading = StandReading(**{**vars(GOOD), quantity: math.nan})
    assert bench.ms_to_idle() <= 220.0
    assert [name for name in bench.guard.trips if name.startswith("silent-")] and quantity in bench.guard.why()


def test_one_nan_among_good_samples_is_a_glitch() -> None:
    bench = Bench()
    bench.spin()
    bench.reading = StandReading(0.0)
    bench.tick()
    bench.reading = GOOD
    assert bench.run(0.5) == 0.5


def test_a_silent_stand_trips_while_spinning() -> None:
    bench = Bench()
    bench.spin()
    bench.reading = None
    assert bench.ms_to_idle() <= 220.0 and bench.guard.state == "tripped"


def test_nothing_spins_before_every_limited_quantity_has_been_measured() -> None:
    bench = Bench()
    bench.reading = StandReading(**{**vars(GOOD), "rpm": math.nan})
    bench.run(0.1)
    bench.guard.set(0.3, bench.now_s)
    assert bench.run(0.5) == 0.0 and "silent-rpm" in bench.guard.trips


def test_nothing_spins_on_an_empty_battery_though_idle_does_not_trip_on_it() -> None:
    bench = Bench()
    bench.reading = StandReading(**{**vars(GOOD), "voltage_v": 0.0})
    bench.run(0.2)
    assert not bench.guard.trips
    bench.guard.set(0.3, bench.now_s)
    assert "voltage_low_v" in bench.guard.trips, "not by the next sample only"
    assert bench.run(0.5) == 0.0


def test_a_silent_control_loop_ramps_to_idle_within_its_time_out() -> None:
    bench = Bench()
    bench.spin()
    bench.alive = False
    assert bench.ms_to_idle() <= 1e3 * (Timing().token_timeout_s + Timing().ramp_down_s) + 25.0
    assert "control" in bench.guard.trips


def test_a_silent_control_loop_may_be_silent_at_idle() -> None:
    bench = Bench()
    bench.alive = False
    bench.run(5.0)
    assert bench.guard.state == "idle"


def test_unconfirmed_nothing_spins() -> None:
    bench = Bench(confirmed=False)
    bench.run(0.05)
    bench.guard.set(0.5, bench.now_s)
    assert bench.run(1.0) == 0.0
    assert [e for e in bench.guard.events if e.kind == "refused"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1, 0.91, 2.0])
def test_a_throttle_that_must_not_be_asked_for_trips(value: float) -> None:
    bench = Bench()
    bench.spin()
    bench.guard.set(value, bench.now_s)
    assert bench.ms_to_idle() <= 60.0 and "request" in bench.guard.trips


def test_trips_of_an_earlier_run_stay_latched_until_they_are_cleared() -> None:
    bench = Bench(latched=(Trip("vibration_m_s2", "it shook"),))
    bench.run(0.1)
    bench.guard.set(0.5, bench.now_s)
    assert bench.run(0.5) == 0.0 and bench.guard.state == "tripped"
    assert bench.guard.clear(bench.now_s)
    bench.guard.set(0.5, bench.now_s)
    assert bench.run(0.5) == 0.5


def test_trips_cannot_be_cleared_while_the_throttle_is_up_nor_after_a_stop() -> None:
    bench = Bench()
    bench.spin()
    bench.guard.trip("vibration_m_s2", "it shook", bench.now_s)
    assert not bench.guard.clear(bench.now_s) and bench.guard.trips
    bench.run(0.2)
    bench.guard.stop("done", bench.now_s)
    assert not bench.guard.clear(bench.now_s) and bench.guard.trips


def test_a_target_from_before_the_trip_does_not_come_back_when_it_is_cleared() -> None:
    bench = Bench()
    bench.spin()
    bench.guard.trip("vibration_m_s2", "it shook", bench.now_s)
    bench.run(0.2)
    assert bench.guard.clear(bench.now_s)
    assert bench.run(1.0) == 0.0 and bench.guard.state == "idle"


def test_after_a_stop_nothing_can_be_asked_for() -> None:
    bench = Bench()
    bench.spin()
    bench.guard.stop("done", bench.now_s)
    bench.guard.set(0.5, bench.now_s)
    assert bench.guard.target == 0 and bench.run(0.5) == 0.0


def test_a_stop_is_confirmed_by_the_device_with_its_time() -> None:
    bench = Bench()
    bench.spin()
    bench.guard.stop("done", bench.now_s)
    bench.run(0.2)
    took_s = bench.guard.idle_confirmed_s - bench.guard.cut_asked_s
    assert 0.02 <= took_s <= Timing().ramp_down_s + 0.02 and not bench.guard.unconfirmed


def test_an_old_readback_of_zero_does_not_confirm_a_stop() -> None:
    bench = Bench()
    bench.run(0.2)
    old = bench.guard.token
    bench.guard.stop("done", bench.now_s)
    bench.obeys = False
    bench.run(0.1)
    bench.guard.applied(0.0, old, bench.now_s)
    assert math.isnan(bench.guard.idle_confirmed_s)
    bench.guard.applied(0.0, bench.guard.token, bench.now_s)
    assert bench.guard.idle_confirmed_s == bench.now_s


@pytest.mark.parametrize("readback", [True, False])
def test_a_stop_that_nobody_confirms_is_said_loudly(readback: bool) -> None:
    bench = Bench(readback=readback)
    bench.spin()
    bench.obeys = False
    bench.guard.stop("done", bench.now_s)
    bench.run(1.0)
    assert bench.guard.unconfirmed and math.isnan(bench.guard.idle_confirmed_s)
    assert [e for e in bench.guard.events if e.kind == "unconfirmed" and "STOP NOT CONFIRMED" in e.text]
    assert ("unconfirmed" in bench.guard.trips) == readback


def test_a_device_that_applies_more_than_it_was_told_trips() -> None:
    bench = Bench()
    bench.run(0.1)
    bench.guard.applied(0.4, bench.guard.token, bench.now_s)
    assert "readback" in bench.guard.trips


def test_a_device_that_idles_by_itself_is_not_sent_back_up_in_one_step() -> None:
    bench = Bench()
    bench.spin()
    bench.guard.applied(0.0, 0, bench.now_s)
    assert bench.ms_to_idle() <= 60.0 and "readback" in bench.guard.trips


def test_a_device_that_confirms_nothing_trips() -> None:
    bench = Bench()
    bench.spin()
    bench.obeys = False
    assert bench.ms_to_idle() <= 1e3 * (Timing().readback_s + Timing().ramp_down_s) + 25.0
    assert "readback" in bench.guard.trips


def test_held_up_beyond_the_devices_deadline_it_does_not_go_on() -> None:
    bench = Bench()
    bench.spin()
    bench.now_s += 0.3
    assert bench.tick() == 0.0 and "held-up" in bench.guard.trips


def test_a_short_hiccup_is_no_jump_upwards() -> None:
    bench = Bench()
    bench.run(0.05)
    bench.guard.set(0.8, bench.now_s)
    before = bench.tick()
    bench.now_s += 0.08
    assert bench.tick() - before <= LIMITS.slew_per_s * 0.03 + 1e-9 and not bench.guard.trips


@pytest.mark.parametrize("name,value", [("deadline_s", 0.2), ("deadline_s", 0.0), ("token_timeout_s", math.nan),
                                        ("ramp_down_s", -1.0), ("stale_s", 3.0), ("confirm_s", math.inf)])
def test_timing_out_of_bounds_is_refused(name: str, value: float) -> None:
    with pytest.raises(UsageError, match=name):
        Timing(**{name: value})


@pytest.mark.parametrize("name,value", [("thrust_n", math.nan), ("thrust_n", 0), ("rpm", -1.0), ("throttle", 1.5),
                                        ("slew_per_s", math.inf), ("current_a", "5"), ("current_a", True)])
def test_a_limit_that_is_none_is_refused(name: str, value: object) -> None:
    with pytest.raises(UsageError, match=name):
        Limits.from_dict({name: value})


def test_an_unknown_limit_is_refused_with_the_nearest() -> None:
    with pytest.raises(UsageError, match=r"did you mean 'thrust_n'"):
        Limits.from_dict({"trust_n": 5.0})
