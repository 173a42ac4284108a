"""The worker's loop on devices in memory, with the control process at the other end of a real channel."""

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bench.journal import read_journal
from bench.supervisor.channel import Channel
from bench.supervisor.devices import Devices
from bench.supervisor.guard import Trip
from bench.supervisor.latches import Latches
from bench.supervisor.limits import Limits
from bench.supervisor.plan import Confirmation, StopReport, SupervisorPlan
from bench.supervisor.worker import Worker
from bench.thrust_stand.protocol import Origin, StandReading
from saranga.errors import DeviceError


class MemoryThrottle:
    """Does what it is told, or not."""

    url = "memory:"
    readback = True

    def __init__(self) -> None:
        self.commands: list[tuple[float, float, float]] = []
        self.value = (0.0, 0)
        self.broken = False
        self.deaf = False

    def open(self) -> None: ...

    def command(self, value: float, token: int, deadline_s: float) -> None:
        if self.broken:
            raise DeviceError("memory: unplugged")
        self.commands.append((time.monotonic(), value, deadline_s))
        if not self.deaf:
            self.value = (value, token)

    def applied(self) -> tuple[float, int] | None:
        return self.value

    def close(self) -> None: ...


class MemoryStand:
    """A sample every 20 ms."""

    url = "memory:"

    def __init__(self) -> None:
        self.sample: dict[str, float] = {"thrust_n": 1.0}
        self.broken = False
        self._last_s = 0.0

    def open(self) -> None: ...

    def read(self, timeout_s: float) -> list[StandReading]:
        if self.broken:
            raise DeviceError("memory: unplugged")
        now_s = time.monotonic()
        if now_s - self._last_s < 0.02:
            return []
        self._last_s = now_s
        return [StandReading(now_s, **self.sample)]

    def tare(self) -> float:
        return 0.25

    def close(self) -> None: ...


class Running:
    """A worker in a thread and its control process."""

    def __init__(self, tmp_path: Path, origin: Origin = "emulated", word: str = "SPIN") -> None:
        # Generous times: this is about the loop, and the machine may be busy.
        self.plan = SupervisorPlan("memory:", "memory:", Limits(thrust_n=5.0, slew_per_s=20.0), token_timeout_s=1.0,
                                   stale_s=1.0, readback_s=1.0, log_folder=tmp_path, latch_folder=tmp_path / "latch")
        self.throttle, self.stand = MemoryThrottle(), MemoryStand()
        ours, theirs = socket.socketpair()
        self.channel = Channel(ours)
        devices = Devices(self.throttle, origin, self.stand)  # type: ignore[arg-type]
        self.worker = Worker(Channel(theirs), self.plan, Confirmation.typed(word), devices)
        self.messages: list[dict[str, object]] = []
        self.report: StopReport | None = None
        self.thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        self.report = self.worker.run()

    def say(self, **message: object) -> None:
        self.channel.send(message, 1.0)

    def until(self, done: Callable[[], bool], keep_alive: bool = True) -> None:
        end_s = time.monotonic() + 10.0
        while not done():
            assert time.monotonic() < end_s, (self.worker.guard.state, self.worker.guard.why())
            if keep_alive:
                self.say(refresh=1)
            self.messages += self.channel.receive()
            time.sleep(0.01)

    def spin(self, value: float = 0.5) -> None:
        self.until(lambda: "thrust_n" in self.worker.guard._measured)
        self.say(set=value)
        self.until(lambda: self.throttle.value[0] == value)

    def answer(self, name: str) -> dict[str, object]:
        self.until(lambda: any(name in m for m in self.messages))
        return next(m for m in self.messages if name in m)


@contextmanager
def running(tmp_path: Path, **what: object) -> Iterator[Running]:
    run = Running(tmp_path, **what)  # type: ignore[arg-type]
    run.thread.start()
    try:
        yield run
    finally:
        run.channel.close()
        run.thread.join(10.0)
        assert not run.thread.is_alive()


def test_the_end_of_the_channel_is_idle_and_the_log_says_so(tmp_path: Path) -> None:
    with running(tmp_path) as run:
        run.spin()
        run.channel.close()
        run.thread.join(5.0)
        assert run.throttle.value[0] == 0.0
    assert run.report is not None and run.report.confirmed and not run.report.trips
    records = read_journal(tmp_path / "supervisor.jsonl")
    assert records.end is not None and records.end["confirmed"] and "gone" in records.end["why"]
    assert [r["text"] for r in records.of("state")][:2] == ["ramp", "hold"]


def test_a_stop_is_reported_with_the_time_the_device_took(tmp_path: Path) -> None:
    with running(tmp_path) as run:
        run.spin()
        run.say(stop="done")
        stopped = run.answer("stopped")["stopped"]
    assert stopped["confirmed"] and 0 <= stopped["seconds"] < 5.0


def test_every_command_carries_a_short_deadline(tmp_path: Path) -> None:
    with running(tmp_path) as run:
        run.spin()
    assert run.throttle.commands and all(d <= 0.15 for _, _, d in run.throttle.commands)


def test_a_lost_stand_takes_the_throttle_away(tmp_path: Path) -> None:
    with running(tmp_path) as run:
        run.spin()
        run.stand.broken = True
        run.until(lambda: run.throttle.value[0] == 0.0)
        run.until(lambda: bool(run.worker._latches.load()))
        assert run.worker.guard.state == "tripped" and "unplugged" in run.worker.guard.why()
    assert Latches(tmp_path / "latch", "memory:").load()[0].name == "stand-lost"


def test_a_lost_throttle_is_an_unconfirmed_stop(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with running(tmp_path) as run:
        run.spin()
        run.throttle.broken = True
        run.until(lambda: "throttle-lost" in run.worker.guard.trips)
        run.say(stop="done")
        assert not run.answer("stopped")["stopped"]["confirmed"]
    assert "STOP NOT CONFIRMED" in capfd.readouterr().err


def test_a_deaf_device_is_said_loudly(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with running(tmp_path) as run:
        run.spin()
        run.throttle.deaf = True
        run.say(stop="done")
        stopped = run.answer("stopped")["stopped"]
        assert not stopped["confirmed"] and math.isnan(stopped["seconds"])
    said = capfd.readouterr().err
    assert "STOP NOT CONFIRMED" in said and "thrust 1 N" in said


def test_trips_outlive_the_supervisor_and_only_the_operator_clears_them(tmp_path: Path) -> None:
    with running(tmp_path) as run:
        run.spin()
        run.stand.sample = {"thrust_n": 9.0}
        run.until(lambda: run.throttle.value[0] == 0.0)
        run.until(lambda: bool(run.worker._latches.load()))
    with running(tmp_path) as run:  # connecting again clears nothing
        run.until(lambda: "thrust_n" in run.worker.guard._measured)
        run.say(set=0.5)
        run.until(lambda: any(e.kind == "refused" for e in run.worker.guard.events) or run.worker.guard.trips)
        assert run.worker.guard.state == "tripped" and run.throttle.value[0] == 0.0
        run.say(clear="please")
        assert not run.answer("cleared")["cleared"] and run.worker.guard.trips
        run.messages.clear()
        run.say(clear="CLEAR")
        assert run.answer("cleared")["cleared"]
        run.spin()
    with running(tmp_path) as run:
        assert not run.worker.guard.trips


def test_a_measured_device_needs_the_typed_word(tmp_path: Path) -> None:
    for origin, confirmation, may in (("measured", Confirmation.flag(), False), ("emulated", Confirmation.flag(), True),
                                      ("measured", Confirmation.typed("spin"), False), ("recorded", Confirmation.flag(),
                                      False), ("measured", Confirmation.flag("SPIN"), True),
                                      ("emulated", Confirmation.none(), False)):
        assert confirmation.allows_spinning(origin) == may, (origin, confirmation)
    with running(tmp_path, word="yes") as run:
        run.until(lambda: "thrust_n" in run.worker.guard._measured)
        run.say(set=0.5)
        run.until(lambda: any("status" in m for m in run.messages))
        time.sleep(0.1)
        assert run.throttle.value[0] == 0.0 and all(v == 0 for _, v, _ in run.throttle.commands)


def test_taring_is_for_idle_only(tmp_path: Path) -> None:
    with running(tmp_path) as run:
        run.say(tare=1)
        assert run.answer("tare")["tare"] == 0.25
        run.spin()
        run.messages.clear()
        run.say(tare=1)
        assert run.answer("tare")["tare"] is None


def test_an_unreadable_latch_counts_as_a_trip(tmp_path: Path) -> None:
    latches = Latches(tmp_path, "memory:")
    latches.save([Trip("x", "y")])
    [path] = tmp_path.glob("trips-*.json")
    path.write_text("{")
    assert [t.name for t in latches.load()] == ["latch"]
    latches.remove()
    assert latches.load() == []
