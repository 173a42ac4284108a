"""What the emulated device itself did with the throttle, from its truth file: the clock is the host's monotonic one."""

import bisect
import itertools
import json
from dataclasses import dataclass, field
from pathlib import Path

IDLE = 0.0


@dataclass
class DeviceLog:
    """Applied throttle over time; `read` goes on where it was. `dead_man_s` are the times at which it idled itself."""

    path: Path
    times_s: list[float] = field(default_factory=list)
    applied: list[float] = field(default_factory=list)
    dead_man_s: list[float] = field(default_factory=list)
    _offset: int = 0

    def read(self) -> None:
        """Take in the lines that are new. A line that is still being written waits for the next time."""
        if not self.path.exists():
            return
        with self.path.open("rb") as file:
            file.seek(self._offset)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._offset += len(whole)
        for line in whole.splitlines():
            event = json.loads(line)
            if "applied" not in event:
                continue
            self.times_s.append(event["t_s"])
            self.applied.append(event["applied"])
            if event["event"] == "dead_man":
                self.dead_man_s.append(event["t_s"])

    def at(self, time_s: float) -> float:
        """Throttle applied at that time."""
        k = bisect.bisect_right(self.times_s, time_s)
        return self.applied[k - 1] if k else IDLE

    def now(self) -> float:
        """The last that is known."""
        return self.applied[-1] if self.applied else IDLE

    def idle_since_s(self) -> float | None:
        """From when on the throttle has stayed at idle, None: it has not."""
        if self.now() != IDLE:
            return None
        k = len(self.applied)
        while k and self.applied[k - 1] == IDLE:
            k -= 1
        return self.times_s[k] if k < len(self.times_s) else -float("inf")

    def last_command_before(self, time_s: float) -> float:
        """When the last word about the throttle before `time_s` came."""
        k = bisect.bisect_left(self.times_s, time_s)
        return self.times_s[k - 1] if k else -float("inf")


def phase(log: DeviceLog, full: float) -> str:
    """Where in a step the device is: idle, ramp, hold, ramp-down, or "" in between (nothing is fired there).

    Idle counts once it has spun: the idle before the first ramp may end any moment.
    """
    recent = log.applied[-6:]
    if len(recent) < 6:
        return ""
    if all(v == IDLE for v in recent):
        return "idle" if max(log.applied) > IDLE else ""
    if all(abs(v - full) < 1e-6 for v in recent):
        return "hold"
    rising = all(b >= a for a, b in itertools.pairwise(recent)) and recent[-1] > recent[0]
    falling = all(b <= a for a, b in itertools.pairwise(recent)) and recent[-1] < recent[0]
    middle = 0.3 * full < recent[-1] < 0.7 * full
    return "ramp" if middle and rising else "ramp-down" if middle and falling else ""
