"""What an echo source is, and the part that all of them share: bytes in, cycles out."""

from collections import deque
from typing import Protocol

from saranga.echo import EchoCycle
from saranga.wire import CycleAssembler, CycleCounters, Decoder, Fault, Hello, LinkCounters, Status


class EchoSource(Protocol):
    """Echo cycles from anywhere. `name` is its URL; `exhausted` is True once nothing more can ever come."""

    name: str
    exhausted: bool

    @property
    def hello(self) -> Hello | None: ...

    @property
    def status(self) -> Status | None: ...

    @property
    def counters(self) -> LinkCounters: ...

    @property
    def cycle_counters(self) -> CycleCounters: ...

    def open(self) -> Hello:
        """Connect, start the rig, and return who it says it is. Raises DeviceError or UsageError."""
        ...

    def poll(self, timeout_s: float) -> list[EchoCycle]:
        """Cycles that are complete, waiting at most `timeout_s` for the first; [] when silent.

        Raises:
            DeviceError: the source is broken; names the cause.
        """
        ...

    def close(self) -> None:
        """Stop the rig where it can still be told, and let go. Never raises; may be called twice."""
        ...


class EchoStream:
    """What every source does with bytes: decode, assemble, keep the rig's last status and newest faults."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.exhausted = False
        self.status: Status | None = None
        self.faults: deque[Fault] = deque(maxlen=32)
        self.decoder = Decoder()
        self._assembler = CycleAssembler()
        self._ready: list[EchoCycle] = []

    @property
    def hello(self) -> Hello | None:
        return self._assembler.hello

    @property
    def counters(self) -> LinkCounters:
        return self.decoder.counters

    @property
    def cycle_counters(self) -> CycleCounters:
        return self._assembler.counters

    def _take_bytes(self, data: bytes) -> None:
        for message in self.decoder.feed(data):
            if isinstance(message, Status):
                self.status = message
            elif isinstance(message, Fault):
                self.faults.append(message)
            cycle = self._assembler.add(message)
            if cycle is not None:
                self._ready.append(cycle)

    def _take_ready(self) -> list[EchoCycle]:
        ready, self._ready = self._ready, []
        return ready
