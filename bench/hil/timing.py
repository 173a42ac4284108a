"""When a companion answers, seen from the wire.

Definitions, all in wall time on this computer's monotonic clock:

- A cycle is complete at the moment its last byte was given to the operating system of this computer.
- A setpoint arrives when its bytes can be read here (SET_POSITION_TARGET_LOCAL_NED).
- A setpoint could have used a cycle that was complete when the companion took its echoes. That moment is what the
  companion says in `time_boot_ms`, in its own clock; the clocks are compared by MAVLink TIMESYNC: an answer cannot be
  older than its question, so the latest question answered in time gives the offset, to about the distance between
  questions over many ticks (17.5 ms apart, so that they fall everywhere in a tick: 2.5 ms at the worst).
- Response of a setpoint: its arrival less the moment the echoes for it were taken.
- Latency of a cycle: from complete to the arrival of the first setpoint that could have used it.
- Deadline: one 16 Hz tick, 62.5 ms. A setpoint whose response is longer has missed it: the next tick had begun.

A companion that answers no TIMESYNC, or whose stamps stand still, is judged by arrivals alone: a setpoint that comes
more than 1.1 ticks after the one before it has missed its deadline, and latencies are only lower bounds ("first
setpoint after the cycle"). `basis` says which it was: "stamps" or "arrivals".
"""

import math
import struct
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilot.frames import V2, FrameReader

TICK_MS = 62.5
LATE_INTERVAL = 1.1
ASK_EVERY_S = 0.0175
LEAST_ANSWERS = 16
STAMP_HALF_MS = 0.5
"""`time_boot_ms` is cut to whole milliseconds."""
_TIMESYNC = struct.Struct("<qq")
_VELOCITY = struct.Struct("<16x3f16xf")
"""vx, vy, vz and yaw rate in SET_POSITION_TARGET_LOCAL_NED."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """`at_s` on our clock, `stamp_ms` on the companion's."""

    at_s: float
    stamp_ms: int


@dataclass
class WireTiming:
    """Fed with what passes and when; `figures` at the end. Times are seconds of one monotonic clock."""

    setpoints: list[Setpoint] = field(default_factory=list)
    cycles_s: list[float] = field(default_factory=list)
    cycles_dropped: int = 0
    lost_frames: int = 0
    counts_frames: bool = False
    not_finite: int = 0
    answers: int = 0
    offset_s: float = -math.inf
    """Our clock less the companion's."""
    began_s: float | None = None
    ended_s: float | None = None

    def __post_init__(self) -> None:
        self._reader = FrameReader()
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._asked: dict[int, float] = {}
        self._ask_due_s = 0.0
        self._sequence: dict[tuple[int, int], int] = {}

    # ---- what passes -------------------------------------------------------------------------------
    def question(self, now_s: float) -> bytes:
        """TIMESYNC to send to the companion now, as from its vehicle; b"" when none is due."""
        if now_s < self._ask_due_s:
            return b""
        self._ask_due_s = now_s + ASK_EVERY_S
        number = round(now_s * 1e9)
        self._asked[number] = now_s
        while len(self._asked) > 2000:
            self._asked.pop(next(iter(self._asked)))
        return bytes(mavlink.MAVLink_timesync_message(0, number).pack(self._mav))

    def cycle(self, now_s: float, delivered: bool) -> None:
        """A cycle has been written to the companion, or was dropped because it did not read."""
        if delivered:
            self.cycles_s.append(now_s)
        elif self.measuring:
            self.cycles_dropped += 1

    def hear(self, data: bytes, now_s: float) -> None:
        """Whole MAVLink frames of the companion."""
        for frame in self._reader.feed(data):
            self._count(frame.system, frame.component, frame.raw[4 if frame.raw[0] == V2 else 2])
            if frame.message_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                self.setpoints.append(Setpoint(now_s, int.from_bytes(frame.payload[:4], "little")))
                self.not_finite += self.measuring and not all(map(math.isfinite, _VELOCITY.unpack_from(frame.payload)))
            elif frame.message_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
                theirs_ns, number = _TIMESYNC.unpack_from(frame.payload)
                asked_s = self._asked.pop(number, None)
                if theirs_ns != 0 and asked_s is not None:
                    self.answers += 1
                    self.offset_s = max(self.offset_s, asked_s - theirs_ns * 1e-9)

    def _count(self, system: int, component: int, sequence: int) -> None:
        last = self._sequence.get((system, component))
        self._sequence[system, component] = sequence
        if last is not None and self.measuring:
            self.lost_frames += (sequence - last - 1) & 0xFF
            self.counts_frames |= sequence != last

    @property
    def measuring(self) -> bool:
        return self.began_s is not None and self.ended_s is None

    def begin(self, now_s: float) -> None:
        """The course begins: from now on it counts."""
        self.began_s = now_s

    def end(self, now_s: float) -> None:
        """The course is over."""
        if self.measuring:
            self.ended_s = now_s

    # ---- what it comes to --------------------------------------------------------------------------
    def measured(self) -> list[Setpoint]:
        """The setpoints of the course."""
        if self.began_s is None or self.ended_s is None:
            return []
        return [s for s in self.setpoints if self.began_s <= s.at_s < self.ended_s]

    @property
    def stamped(self) -> bool:
        """Whether the companion's stamps can be used: clocks compared, and stamps that go on."""
        stamps = [s.stamp_ms for s in self.measured()]
        return self.answers >= LEAST_ANSWERS and len(stamps) > 1 and all(
            late > early for early, late in pairwise(stamps))

    def taken_s(self, setpoint: Setpoint) -> float:
        """When the companion took the echoes for this setpoint, on our clock."""
        return (setpoint.stamp_ms + STAMP_HALF_MS) * 1e-3 + self.offset_s

    def responses_ms(self) -> list[float]:
        """Of each setpoint of the course; [] without stamps."""
        return [1e3 * (s.at_s - self.taken_s(s)) for s in self.measured()] if self.stamped else []

    def figures(self) -> dict[str, Any]:
        """Everything, JSON-ready; None for what could not be measured."""
        found = self.measured()
        if self.began_s is None or self.ended_s is None:
            return {"basis": None, "setpoints": 0, "deadline_miss_share": None, "setpoint_rate_hz": None,
                    "longest_gap_ms": None, "latency_ms": None}
        stamped, responses = self.stamped, self.responses_ms()
        edges = np.array([self.began_s, *(s.at_s for s in found), self.ended_s])
        gaps_ms = 1e3 * np.diff(edges)
        between_ms = gaps_ms[1:-1]
        late = int(np.count_nonzero(between_ms > LATE_INTERVAL * TICK_MS))
        misses = sum(r > TICK_MS for r in responses) if stamped else late
        counted = len(found) if stamped else len(between_ms)
        duration_s = self.ended_s - self.began_s
        return {
            "basis": "stamps" if stamped else "arrivals", "course_s": duration_s, "setpoints": len(found),
            "setpoint_rate_hz": len(found) / duration_s if duration_s > 0 else None,
            "deadline_ms": TICK_MS, "deadline_misses": misses if counted else None,
            "deadline_miss_share": misses / counted if counted else None,
            "late_intervals": late, "missed_ticks": int(np.maximum(np.rint(gaps_ms / TICK_MS) - 1, 0).sum()),
            "longest_gap_ms": float(gaps_ms.max()), "interval_ms": _spread(between_ms),
            "response_ms": _spread(responses), "latency_ms": _spread(self._latencies_ms(found, stamped)),
            "latency_is_lower_bound": not stamped, "time_answers": self.answers,
            "lost_mavlink_frames": self.lost_frames if self.counts_frames else None,
            "setpoints_not_finite": self.not_finite,
            "echo_cycles": sum(self.began_s <= c < self.ended_s for c in self.cycles_s),
            "echo_cycles_dropped": self.cycles_dropped,
        }

    def _latencies_ms(self, found: list[Setpoint], stamped: bool) -> list[float]:
        used_s = np.array([self.taken_s(s) if stamped else s.at_s for s in found])
        out = []
        for cycle_s in self.cycles_s:
            if self.began_s is not None and self.began_s <= cycle_s and len(used_s) and cycle_s <= used_s[-1]:
                out.append(1e3 * (found[int(np.searchsorted(used_s, cycle_s))].at_s - cycle_s))
        return out

    def rows(self) -> list[tuple[float, int, float, float | None]]:
        """(arrival after the course began in s, stamp in ms, interval in ms, response in ms) of each setpoint."""
        found, responses = self.measured(), self.responses_ms()
        began = self.began_s or 0.0
        before = [began, *(s.at_s for s in found)]
        return [(s.at_s - began, s.stamp_ms, 1e3 * (s.at_s - b), responses[k] if responses else None)
                for k, (s, b) in enumerate(zip(found, before, strict=False))]


def _spread(values: Any) -> dict[str, float] | None:
    if len(values) == 0:
        return None
    low, middle, high = np.percentile(values, [5, 50, 95])
    return {"p5": float(low), "median": float(middle), "p95": float(high), "max": float(np.max(values))}
