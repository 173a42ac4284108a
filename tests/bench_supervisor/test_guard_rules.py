"""What must hold whatever happens, in whatever order (hypothesis)."""

import math

import hypothesis.strategies as st
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from bench.supervisor.guard import Guard, Timing
from bench.supervisor.limits import Limits
from bench.thrust_stand.protocol import StandReading

TIMING = Timing()
LIMITS = Limits(thrust_n=5.0, voltage_low_v=13.0, throttle=0.8, slew_per_s=3.0)
EPSILON = 1e-9


class AnyRun(RuleBasedStateMachine):
    """A control loop, a stand, a device and an operator, each as bad as can be."""

    @initialize(confirmed=st.booleans(), readback=st.booleans())
    def begin(self, confirmed: bool, readback: bool) -> None:
        self.guard = Guard(LIMITS, TIMING, confirmed, readback)
        self.now_s = 10.0
        self.command = 0.0
        self.heard_s = self.measured_s = -math.inf
        self.cut_s: float | None = None
        self.trips: set[str] = set()

    @rule(value=st.one_of(st.floats(0, 0.8), st.floats(allow_nan=True, allow_infinity=True)))
    def control_sets(self, value: float) -> None:
        self.guard.set(value, self.now_s)
        if math.isfinite(value) and 0 <= value <= LIMITS.throttle:
            self.heard_s = self.now_s

    @rule()
    def control_refreshes(self) -> None:
        self.guard.refresh(self.now_s)
        self.heard_s = self.now_s

    @rule(thrust_n=st.one_of(st.floats(-1, 4), st.just(math.nan), st.floats(allow_nan=True)),
          voltage_v=st.one_of(st.floats(13.5, 17), st.just(math.nan), st.floats(0, 12)))
    def stand_reads(self, thrust_n: float, voltage_v: float) -> None:
        self.guard.reading(StandReading(self.now_s, thrust_n=thrust_n, voltage_v=voltage_v), self.now_s)
        if abs(thrust_n) > LIMITS.thrust_n and not math.isnan(thrust_n):
            assert self.guard.trips

    @rule(throttle=st.floats(allow_nan=True), token=st.integers(0, 2**32 - 1))
    def device_lies(self, throttle: float, token: int) -> None:
        self.guard.applied(throttle, token, self.now_s)

    @rule()
    def device_obeys(self) -> None:
        self.guard.applied(self.guard.command, self.guard.token, self.now_s)

    @rule()
    def something_trips(self) -> None:
        self.guard.trip("stand-lost", "unplugged", self.now_s)

    @rule()
    def operator_clears(self) -> None:
        allowed = self.guard.command == 0 and self.guard.stopping is None
        assert self.guard.clear(self.now_s) == allowed
        if allowed:
            self.trips = set()
            self.cut_s = None

    @rule()
    def control_ends(self) -> None:
        self.guard.stop("the control process has gone", self.now_s)

    @rule(after_s=st.floats(0.001, 0.4))
    def time_passes(self, after_s: float) -> None:
        guard = self.guard
        self.now_s += after_s
        before = self.command
        self.command = guard.tick(self.now_s)
        assert 0 <= self.command <= LIMITS.throttle
        if self.command > before:
            assert guard.confirmed and not guard.trips and guard.stopping is None
            assert self.now_s - self.heard_s <= TIMING.token_timeout_s + EPSILON
            assert self.command - before <= LIMITS.slew_per_s * min(after_s, 0.03) + EPSILON
            assert guard.target >= self.command
        if self.cut_s is not None and self.now_s - self.cut_s >= TIMING.ramp_down_s + EPSILON and after_s > 0:
            # The first tick after the cut begins the ramp at the tick before it, so this is never late.
            assert self.command == 0
        if self.command > 0 and guard.stopping is None and not guard.trips:
            assert self.now_s - self.heard_s <= TIMING.token_timeout_s + EPSILON

    @rule(ticks=st.integers(5, 60))
    def all_is_well_for_a_while(self, ticks: int) -> None:
        """Without this nothing would ever spin."""
        for _ in range(ticks):
            self.stand_reads(1.0, 16.0)
            self.control_refreshes()
            if not self.guard.trips and self.guard.stopping is None:
                self.guard.set(0.5, self.now_s)
            self.time_passes(0.01)
            self.device_obeys()
            self.note()

    @invariant()
    def note(self) -> None:
        """Trips only ever grow, except by the operator; from the first cut on the clock runs."""
        if not hasattr(self, "guard"):
            return
        assert self.trips <= set(self.guard.trips)
        self.trips = set(self.guard.trips)
        if (self.trips or self.guard.stopping is not None) and self.cut_s is None:
            self.cut_s = self.now_s
        if self.trips or self.guard.stopping is not None:
            assert self.guard.target == 0


TestAnyRun = AnyRun.TestCase
TestAnyRun.settings = settings(max_examples=100, stateful_step_count=40, deadline=None)
