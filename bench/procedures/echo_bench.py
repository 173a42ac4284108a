"""Procedures in which nothing spins: a rig that transmits, and an object put in front of it, place by place."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bench.procedures.bench import Hands
from bench.procedures.plan import RigSettings
from saranga.echo import EchoCycle
from saranga.errors import DeviceError
from saranga.wire import Config, HelloRequest, Start


@dataclass(frozen=True)
class Place:
    """Where an object stands: distance of its nearest surface from the sensor, azimuth to the right."""

    distance_m: float
    azimuth_deg: float = 0.0
    diameter_m: float = 0.06


class EchoBench(Protocol):
    """Asked for cycles with an object at a place."""

    origin: str
    name: str

    def cycles(self, place: Place, count: int) -> list[EchoCycle]:
        """`count` cycles with the object there. Raises DeviceError when they do not come."""
        ...

    def close(self) -> None: ...


class EmulatedEchoBench:
    """The emulated device in this process, its pole moved by the procedure. Keeps its bytes in `record`."""

    origin = "emulated"
    name = "emulated:"

    def __init__(self, rig: RigSettings, seed: int = 1, record: Path | None = None, sonar: str = "pair") -> None:
        from saranga.recording import FrameWriter

        self._rig = rig
        self._seed = seed
        self._sonar = sonar
        self._writer = FrameWriter(record, {"source": "emulated"}) if record is not None else None
        self._t_us = 0
        self._visits = 0
        self.hello: Any = None

    def cycles(self, place: Place, count: int) -> list[EchoCycle]:
        from bench.rig.bench_acoustics import Reflector
        from bench.rig.emulator import EmulatedDevice
        from saranga.echo import load_sonar
        from saranga.wire import CycleAssembler, Decoder, encode

        self._visits += 1
        # Distances are to the surface, the reflector's is that of its axis.
        radius = place.diameter_m / 2.0
        reflector = Reflector(place.distance_m + radius, place.azimuth_deg, radius)
        device = EmulatedDevice(load_sonar(self._sonar), reflector=reflector, seed=self._seed + 1000 * self._visits)
        decoder, assembler = Decoder(), CycleAssembler()
        found: list[EchoCycle] = []
        now_us = 0

        def take(data: bytes) -> None:
            if self._writer is not None and data:
                self._writer.write(data, self._t_us + now_us)
            for message in decoder.feed(data):
                cycle = assembler.add(message)
                if cycle is not None:
                    found.append(cycle)

        take(device.advance(0))
        for message in (HelloRequest(), Config(odr=self._rig.odr, samples=self._rig.samples),
                        Start(mode=0, rate_hz=self._rig.rate_hz)):
            take(device.receive(encode(message), now_us))
        self.hello = assembler.hello
        while len(found) < count:
            now_us += round(1e6 / self._rig.rate_hz)
            take(device.advance(now_us))
            if now_us > 4e6 * count / self._rig.rate_hz + 5e6:
                raise DeviceError(f"emulated rig: only {len(found)} of {count} cycles came")
        self._t_us += now_us
        return found[:count]

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


class RigEchoBench:
    """A real rig; a person puts the object where it is asked for. The rig is read all the while."""

    def __init__(self, url: str, rig: RigSettings, hands: Hands, what: str, record: Path | None,
                 asked_to_stop: Callable[[], bool]) -> None:
        from bench.rig.driver import Rig
        from saranga.sources import rig_link

        self.name = url
        self._hands = hands
        self._what = what
        self._asked_to_stop = asked_to_stop
        self._source = Rig(rig_link(url), record=record, reconnect_s=0.0)
        self.hello = self._source.open()
        self.origin = self._source.origin
        try:
            self._source.configure(rig.odr, rig.samples)
            self._source.start(rate_hz=rig.rate_hz)
        except BaseException:
            self._source.close()
            raise

    def cycles(self, place: Place, count: int) -> list[EchoCycle]:
        from bench.procedures.runner import Interrupted

        text = (f"put the {self._what} {place.distance_m:g} m from the sensor"
                + (f", {abs(place.azimuth_deg):g} degrees to the {'right' if place.azimuth_deg > 0 else 'left'}"
                   if place.azimuth_deg else ", straight ahead"))
        failed: list[BaseException] = []

        def ask() -> None:
            try:
                self._hands(text)
            except BaseException as error:
                failed.append(error)

        person = threading.Thread(target=ask, daemon=True)
        person.start()
        while person.is_alive():
            if self._asked_to_stop():
                raise Interrupted
            self._source.poll(0.05)
        if failed:
            raise DeviceError(f"nobody is at the terminal to {text}") from failed[0]
        found: list[EchoCycle] = []
        silent_s = 0.0
        while len(found) < count:
            if self._asked_to_stop():
                raise Interrupted
            new = [c for c in self._source.poll(0.1) if all(f.mode == 0 for f in c.frames.values())]
            silent_s = 0.0 if new else silent_s + 0.1
            found += new
            if silent_s > 5.0:
                raise DeviceError(f"{self.name}: only {len(found)} of {count} cycles came, then nothing for 5 s: check "
                                  "it with `saranga-bench rig check`")
        return found[:count]

    def close(self) -> None:
        self._source.close()


def echo_bench(url: str, rig: RigSettings, what: str, hands: Hands, record: Path | None,
               asked_to_stop: Callable[[], bool]) -> EchoBench:
    """The bench that a rig URL names; `emulated:` is one in this process."""
    from bench.emulated import is_emulated
    from bench.procedures.emulated_device import parse_emulated

    if is_emulated(url):
        spec = parse_emulated(url)
        return EmulatedEchoBench(rig, spec.seed, record, spec.sonar)
    return RigEchoBench(url, rig, hands, what, record, asked_to_stop)


def mean_record(cycles: list[EchoCycle], role: str) -> tuple[NDArray[np.complex128], float]:
    """Coherent mean of a sensor's records in counts, and the IQ rate; each record is turned so that the sample that is
    strongest on average beyond the first eighth is real.

    Raises:
        DeviceError: no record of that sensor.
    """
    frames = [c.frames[role] for c in cycles if role in c.frames]
    if not frames:
        raise DeviceError(f"no record of sensor {role!r} came: is it alive? `saranga-bench rig check` tells")
    rows = np.stack([f.iq[:, 1].astype(np.float64) + 1j * f.iq[:, 0] for f in frames])
    blank = rows.shape[1] // 8
    peak = blank + int(np.argmax(np.abs(rows[:, blank:]).mean(axis=0)))
    rows = rows * np.exp(-1j * np.angle(rows[:, peak]))[:, None]
    return rows.mean(axis=0), frames[0].iq_rate_hz


def mean_size(cycles: list[EchoCycle], role: str) -> NDArray[np.float64]:
    """Mean |IQ| of a sensor's records, counts. Noise has no peak here; in `mean_record` the sample whose phase all
    records are turned to stands out of mere noise, the more so the more records there are."""
    return np.mean([np.hypot(f.iq[:, 0].astype(np.float64), f.iq[:, 1]) for c in cycles
                    if (f := c.frames.get(role)) is not None], axis=0)


def range_of_sample(index: float, iq_rate_hz: float, c_m_s: float) -> float:
    """Range of a sample, m."""
    return 0.5 * c_m_s * index / iq_rate_hz


def sample_of_range(range_m: float, iq_rate_hz: float, c_m_s: float) -> int:
    """Nearest sample of a range."""
    return math.floor(2.0 * range_m * iq_rate_hz / c_m_s + 0.5)
