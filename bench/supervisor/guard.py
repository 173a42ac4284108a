"""The supervisor's decisions: time and events in, throttle out. No I/O, no clock of its own.

The throttle leaves zero only while all of this holds: confirmed by the operator, no trip latched, no stop asked for,
the control loop's last word younger than `token_timeout_s`, every limited quantity measured lately and in its limit.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from bench.supervisor.limits import QUANTITIES, Limits, exceeded, quantity_of
from bench.thrust_stand.protocol import StandReading
from saranga.errors import UsageError

State = Literal["idle", "ramp", "hold", "ramp-down", "tripped", "stopped"]
READBACK_TOLERANCE = 0.02
TOKENS = 1 << 32
MAX_UP_STEP_S = 0.03
"""However long a tick took, the throttle rises by no more than this much time's worth."""


@dataclass(frozen=True)
class Timing:
    """Seconds. `deadline_s` goes out with every command: the device idles by itself after it."""

    token_timeout_s: float = 0.1
    ramp_down_s: float = 0.05
    stale_s: float = 0.15
    deadline_s: float = 0.15
    readback_s: float = 0.3
    confirm_s: float = 0.5

    def __post_init__(self) -> None:
        for name, most in (("token_timeout_s", 1.0), ("ramp_down_s", 1.0), ("stale_s", 2.0), ("deadline_s", 0.15),
                           ("readback_s", 2.0), ("confirm_s", 5.0)):
            value = getattr(self, name)
            if not math.isfinite(value) or not 0 < value <= most:
                raise UsageError(f"{name} = {value!r}: must be above 0 and at most {most:g} s")


@dataclass(frozen=True)
class Trip:
    """Why the throttle was taken away. Latched until the operator clears it."""

    name: str
    text: str


@dataclass(frozen=True)
class Event:
    """For the log: `kind` is state, target, refused, trip, stop, clear, idle (confirmed) or unconfirmed."""

    kind: str
    time_s: float
    text: str
    values: dict[str, float | str] = field(default_factory=dict)


class Guard:
    """One motor's throttle.

    Args:
        limits: what must not be exceeded; every watched quantity has to come in by `reading`.
        timing: see Timing.
        confirmed: whether the operator has confirmed that something will spin.
        readback: whether the device says what it applies.
        latched: trips of an earlier run that nobody has cleared.
    """

    def __init__(self, limits: Limits, timing: Timing, confirmed: bool, readback: bool,
                 latched: Iterable[Trip] = ()) -> None:
        self.limits = limits
        self.timing = timing
        self.confirmed = confirmed
        self.readback = readback
        self.trips: dict[str, Trip] = {t.name: t for t in latched}
        self.target = 0.0
        self.command = 0.0
        self.token = 0
        self.stopping: str | None = None
        self.applied_throttle = math.nan
        self.events: list[Event] = []
        self.cut_asked_s = math.nan
        self.unconfirmed = False
        self._confirmed_s = math.nan
        self._state: State = "tripped" if self.trips else "idle"
        self._heard_s = -math.inf
        self._measured: dict[str, tuple[float, float]] = {}  # limit -> when and what, the last that was a number
        self._spinning_since_s = math.nan
        self._last_tick_s = math.nan
        self._cut_rate = 0.0
        self._zero_from: tuple[float, int] | None = None
        self._sent: deque[tuple[float, int, float]] = deque()
        self._applied_token_sent_s = math.nan

    # ---- events ------------------------------------------------------------------------------------
    def set(self, value: float, now_s: float) -> None:
        """The control loop wants `value`; counts as a sign of life. What must not be is a trip, not a clamp."""
        if not math.isfinite(value) or not 0 <= value <= self.limits.throttle:
            self.trip("request", f"throttle {value!r} asked for: allowed are 0 to {self.limits.throttle:g}", now_s)
            return
        self._heard_s = now_s
        if value > 0 and not self.confirmed:
            self._event("refused", now_s, "nobody has confirmed that something will spin")
            return
        if value > 0 and (self.trips or self.stopping is not None):
            self._event("refused", now_s, "tripped: clear it first" if self.trips else "stopped")
            return
        if value > 0 and not self.spinning:
            self._spinning_since_s = now_s
            if not self._ready_to_spin(now_s):
                return
        if value != self.target:
            self._event("target", now_s, f"target {value:.4g}", value=value)
        self.target = value

    def refresh(self, now_s: float) -> None:
        """The control loop is alive and wants what it wanted."""
        self._heard_s = now_s

    def reading(self, reading: StandReading, now_s: float) -> None:
        """A sample of the stand has come."""
        for limit in self.limits.watched():
            value = quantity_of(limit, reading)
            if math.isnan(value):
                continue
            self._measured[limit] = (now_s, value)
            if limit == "voltage_low_v" and not self.spinning:
                continue  # No battery connected yet is no reason to trip; set() looks at it again.
            why = exceeded(self.limits, limit, value)
            if why is not None:
                self.trip(limit, why, now_s)

    def applied(self, throttle: float, token: int, now_s: float) -> None:
        """The device says what it applies, and which command that is."""
        self.applied_throttle = throttle
        for sent_s, sent_token, _ in self._sent:
            if sent_token == token:
                self._applied_token_sent_s = sent_s
        most = max((v for _, _, v in self._sent), default=0.0)
        if not math.isfinite(throttle) or throttle > most + READBACK_TOLERANCE:
            self.trip("readback", f"the device applies throttle {throttle:.4g}, at most {most:.4g} was asked of it",
                      now_s)
        least = min((v for _, _, v in self._sent), default=0.0)
        if throttle < least - READBACK_TOLERANCE:
            # Its dead-man, or a motor guard of its own: going on from here would be a step, not a ramp.
            self.trip("readback", f"the device applies throttle {throttle:.4g}, at least {least:.4g} was asked of it",
                      now_s)
        if self._zero_from is not None and throttle == 0 and (token - self._zero_from[1]) % TOKENS < TOKENS // 2:
            if math.isnan(self._confirmed_s):
                self._confirmed_s = now_s
                self._say_confirmed(now_s)
        else:
            self._confirmed_s = math.nan

    def trip(self, name: str, text: str, now_s: float) -> None:
        """Take the throttle away and latch."""
        first = not self.trips and self.stopping is None
        if name not in self.trips:
            self.trips[name] = Trip(name, text)
            self._event("trip", now_s, text, name=name)
        self._cut(now_s, first)

    def stop(self, why: str, now_s: float) -> None:
        """Idle for good; not latched for the next run. The first reason counts."""
        if self.stopping is None:
            self.stopping = why
            self._event("stop", now_s, why)
            self._cut(now_s, first=True)

    def clear(self, now_s: float) -> bool:
        """The operator clears the latched trips; only at idle. Returns whether they are gone."""
        if self.command > 0 or self.stopping is not None:
            return False
        self._event("clear", now_s, "cleared by the operator: " + (", ".join(self.trips) or "nothing"))
        self.trips.clear()
        self.target = 0.0
        self.cut_asked_s = math.nan
        self.unconfirmed = False
        return True

    # ---- time --------------------------------------------------------------------------------------
    def tick(self, now_s: float) -> float:
        """The throttle to send now, with `token` and the deadline; call it at 100 Hz."""
        gap_s = 0.0 if math.isnan(self._last_tick_s) else max(0.0, now_s - self._last_tick_s)
        self._last_tick_s = now_s
        if self.spinning and gap_s > self.timing.deadline_s:
            # The device has idled on its own: going on from here would be a step, not a ramp.
            self.trip("held-up", f"the supervisor was held up for {gap_s * 1e3:.0f} ms; the device idles after "
                                 f"{self.timing.deadline_s * 1e3:.0f} ms", now_s)
            self.command = 0.0
        if self.spinning:
            self._watch(now_s)
        late = now_s - self.cut_asked_s > self.timing.confirm_s
        if late and math.isnan(self._confirmed_s) and not self.unconfirmed:
            self._say_unconfirmed(now_s)
        self._move(gap_s)
        self.token = (self.token + 1) % TOKENS
        self._remember(now_s)
        self._settle_state(now_s)
        return self.command

    @property
    def spinning(self) -> bool:
        """Whether the throttle is, or is about to be, above idle."""
        return self.command > 0 or self.target > 0

    @property
    def state(self) -> State:
        """idle, ramp, hold, ramp-down, tripped or stopped."""
        return self._state

    @property
    def measured_all(self) -> bool:
        """Whether every limited quantity has been measured at least once."""
        return set(self.limits.watched()) <= set(self._measured)

    @property
    def idle_confirmed_s(self) -> float:
        """Since when the device itself has said that it applies zero, by the zero command or a later one. NaN: not."""
        return self._confirmed_s

    def why(self) -> str:
        """One line for people."""
        if self.trips:
            return "; ".join(f"{t.name}: {t.text}" for t in self.trips.values())
        return self.stopping or ""

    # ---- inside ------------------------------------------------------------------------------------
    def _ready_to_spin(self, now_s: float) -> bool:
        """Whether every limited quantity is known and good; trips when not."""
        for limit in self.limits.watched():
            measured_s, value = self._measured.get(limit, (-math.inf, math.nan))
            why = exceeded(self.limits, limit, value)
            if now_s - measured_s > self.timing.stale_s:
                self._silent(limit, now_s)
            elif why is not None:
                self.trip(limit, why, now_s)
        return not self.trips

    def _watch(self, now_s: float) -> None:
        age_s = now_s - self._heard_s
        if age_s > self.timing.token_timeout_s and not self.trips and self.stopping is None:
            self.trip("control", f"the control loop has been silent for {age_s * 1e3:.0f} ms, allowed are "
                                 f"{self.timing.token_timeout_s * 1e3:.0f} ms", now_s)
        for limit in self.limits.watched():
            if now_s - self._measured.get(limit, (-math.inf, 0.0))[0] > self.timing.stale_s:
                self._silent(limit, now_s)
        if self.readback and not self.trips:
            last = self._applied_token_sent_s
            begun = self._spinning_since_s if math.isnan(last) else max(last, self._spinning_since_s)
            if now_s - begun > self.timing.readback_s:
                self.trip("readback", "the device has not confirmed a throttle command for "
                                      f"{(now_s - begun) * 1e3:.0f} ms", now_s)

    def _silent(self, limit: str, now_s: float) -> None:
        last = self._measured.get(limit)
        ago = "never" if last is None else f"last {(now_s - last[0]) * 1e3:.0f} ms ago"
        self.trip(f"silent-{limit}", f"{QUANTITIES[limit][0]} has a limit and is not measured ({ago}; allowed are "
                                     f"{self.timing.stale_s * 1e3:.0f} ms): NaN or silence of the stand", now_s)

    def _say_confirmed(self, now_s: float) -> None:
        if not math.isnan(self.cut_asked_s):
            took_s = now_s - self.cut_asked_s
            self._event("idle", now_s, f"the device says that it idles, {took_s * 1e3:.0f} ms after it was to",
                        seconds=took_s)

    def _say_unconfirmed(self, now_s: float) -> None:
        self.unconfirmed = True
        if self.readback:
            text = f"the device has not confirmed idle within {self.timing.confirm_s * 1e3:.0f} ms"
            self.trip("unconfirmed", text, now_s)
        else:
            text = "this throttle cannot say what it applies"
        self._event("unconfirmed", now_s, f"STOP NOT CONFIRMED: {text}: keep away, cut the power")

    def _cut(self, now_s: float, first: bool) -> None:
        """`first`: from here the time to idle is measured, by a command that is sent after this."""
        if first:
            self.cut_asked_s = now_s
            self._zero_from = None
            self._confirmed_s = math.nan
        self.target = 0.0
        if self._cut_rate == 0.0:
            self._cut_rate = self.command / self.timing.ramp_down_s

    def _move(self, gap_s: float) -> None:
        if self.trips or self.stopping is not None:
            goal, down = 0.0, max(self._cut_rate, self.limits.slew_per_s)
        else:
            goal, down = self.target, self.limits.slew_per_s
            self._cut_rate = 0.0
        if self.command < goal:
            self.command = min(goal, self.command + self.limits.slew_per_s * min(gap_s, MAX_UP_STEP_S))
        else:
            self.command = max(goal, self.command - down * gap_s)

    def _remember(self, now_s: float) -> None:
        self._sent.append((now_s, self.token, self.command))
        horizon = now_s - self.timing.readback_s
        while len(self._sent) > 1 and self._sent[1][0] <= horizon:
            self._sent.popleft()
        if self.command > 0:
            self._zero_from = None
            self._confirmed_s = math.nan
        elif self._zero_from is None:
            self._zero_from = (now_s, self.token)

    def _settle_state(self, now_s: float) -> None:
        if self.trips:
            state: State = "tripped"
        elif self.stopping is not None:
            state = "stopped"
        elif self.command < self.target:
            state = "ramp"
        elif self.command > self.target:
            state = "ramp-down"
        else:
            state = "hold" if self.command > 0 else "idle"
        if state != self._state:
            self._state = state
            self._event("state", now_s, state, command=self.command, target=self.target)

    def _event(self, kind: str, now_s: float, text: str, **values: float | str) -> None:
        self.events.append(Event(kind, now_s, text, values))
