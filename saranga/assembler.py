"""From ECHO messages to cycles: the frames of one trigger, roles from HELLO, device time unwrapped."""

from dataclasses import dataclass

from saranga.echo import EchoCycle, EchoFrame
from saranga.messages import FLAG_BOOT, Echo, Hello, Message

RESTART_TRIGGERS = 64
"""A trigger this far behind is no late frame: the rig has restarted."""


@dataclass
class CycleCounters:
    """What became of the frames.

    `incomplete`: cycles released without all sensors; `missing`: triggers of which nothing came; `late`: frames
    of a cycle already released; `repeated`: second frames of a sensor in a cycle; `unknown`: frames of sensors
    without a role, or before HELLO.
    """

    cycles: int = 0
    incomplete: int = 0
    missing: int = 0
    late: int = 0
    repeated: int = 0
    unknown: int = 0


class CycleAssembler:
    """Groups ECHO messages by trigger.

    A cycle is released when every role of HELLO has come, else by the first frame of a later trigger, so a
    dead sensor costs one cycle of delay and never more, and is back with its first frame. Cycles come out in
    trigger order.
    """

    def __init__(self) -> None:
        self.counters = CycleCounters()
        self.hello: Hello | None = None
        self._roles: dict[int, str] = {}
        self._pending: EchoCycle | None = None
        self._released: int | None = None
        self._raw_us: int | None = None
        self._time_us = 0

    def add(self, message: Message) -> EchoCycle | None:
        """Take any message; returns the cycle that it completes or supersedes, if any."""
        if isinstance(message, Echo):
            return self._add_echo(message)
        if isinstance(message, Hello):
            return self._add_hello(message)
        return None

    def flush(self) -> EchoCycle | None:
        """Release what is pending, at the end of a stream."""
        cycle, self._pending = self._pending, None
        if cycle is not None:
            self._count_release(cycle)
        return cycle

    def _add_hello(self, hello: Hello) -> EchoCycle | None:
        cycle = None
        if hello.flags & FLAG_BOOT:
            cycle = self.flush()
            self._released = self._raw_us = None
        self.hello = hello
        self._roles = {s.sensor: s.role for s in hello.sensors if s.role}
        return cycle

    def _add_echo(self, echo: Echo) -> EchoCycle | None:
        role = self._roles.get(echo.sensor)
        if role is None:
            self.counters.unknown += 1
            return None
        done = None
        if self._pending is None or echo.trigger != self._pending.trigger:
            last = self._pending.trigger if self._pending is not None else self._released
            if last is not None:
                step = (echo.trigger - last) & 0xFFFFFFFF
                behind = -step & 0xFFFFFFFF
                if behind < RESTART_TRIGGERS:
                    self.counters.late += 1
                    return None
                done = self.flush()
                if step < 0x80000000:
                    self.counters.missing += step - 1
                else:
                    self._raw_us = None
            self._pending = EchoCycle(echo.trigger, self._unwrap(echo.device_time_us), {})
        pending = self._pending
        if role in pending.frames:
            self.counters.repeated += 1
            return done
        time_us = self._unwrap(echo.device_time_us)
        pending.frames[role] = EchoFrame(role, echo.sensor, echo.sequence, echo.trigger, time_us, echo.fop_hz,
                                         echo.odr, echo.mode, echo.iq)
        # A rig of one sensor completes at once, but then nothing was pending: at most one cycle is released.
        return self.flush() if done is None and len(pending.frames) == len(self._roles) else done

    def _count_release(self, cycle: EchoCycle) -> None:
        self._released = cycle.trigger
        self.counters.cycles += 1
        self.counters.incomplete += len(cycle.frames) < len(self._roles)

    def _unwrap(self, raw_us: int) -> int:
        """The rig's u32 clock wraps at 71.6 min; steps of less than half that, either way, are followed."""
        if self._raw_us is None:
            self._time_us = raw_us
        else:
            step = (raw_us - self._raw_us) & 0xFFFFFFFF
            self._time_us += step - 0x100000000 if step >= 0x80000000 else step
        self._raw_us = raw_us
        return self._time_us
