"""A bench in simulated time: the emulated device in this process, on a clock that runs as fast as it is computed.

For rehearsals and for statistics over many seeds. It speaks the same wire bytes, but there is no supervisor process:
there is nothing to keep safe. The real chain, emulated or not, is in `hardware_bench.py`.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.procedures.bench import BenchInfo, Heard
from bench.procedures.plan import Condition, PlanLimits, RigSettings
from bench.thrust_stand.plant import load_plant
from bench.thrust_stand.protocol import StandReading
from saranga.echo import EchoCycle
from saranga.errors import DeviceError
from saranga.recording import FrameWriter
from saranga.wire import (
    MODE_RECEIVE_ONLY,
    Config,
    CycleAssembler,
    Decoder,
    Hello,
    HelloRequest,
    Message,
    Stand,
    Start,
    Throttle,
    encode,
)

if TYPE_CHECKING:
    from bench.rig.emulator import EmulatedDevice
from bench.rig.noise_law import HUB_DISTANCE_M

TICK_S = 0.02
DEADLINE_MS = 200


class SimulatedBench:
    """The device, turned by `poll`.

    Args:
        device: with a plant, so that there is something to spin.
        record: new MCAP file for the bytes; None keeps none.
        tick_s: longest stretch between two looks.
    """

    by_hand = False
    real_time = False

    def __init__(self, device: "EmulatedDevice", rig: RigSettings, limits: PlanLimits, record: Path | None = None,
                 tick_s: float = TICK_S) -> None:
        self._device = device
        self._noise = device.noise
        self._rig = rig
        self._limits = limits
        self._record = record
        self._tick_s = tick_s
        self._writer: FrameWriter | None = None
        self._t_us = 0
        self._wanted = self._sent = 0.0
        self._token = 0
        self._decoder = Decoder()
        self._assembler = CycleAssembler()
        self._readings: list[StandReading] = []
        self._cycles: list[EchoCycle] = []

    def open(self) -> BenchInfo:
        """Raises DeviceError when the device does not say HELLO or has no stand."""
        if self._record is not None:
            self._writer = FrameWriter(self._record, {"source": "emulated, simulated time"})
        self._take(self._device.advance(0))
        self._tell(HelloRequest())
        hello = self._assembler.hello
        if hello is None or not hello.has_stand:
            raise DeviceError("the emulated device has no stand: give it a plant")
        self._tell(Config(odr=self._rig.odr, samples=self._rig.samples, ring_down_samples=0))
        self._tell(Start(mode=MODE_RECEIVE_ONLY, rate_hz=self._rig.rate_hz))
        return BenchInfo("emulated", hello_dict(hello), {"name": "emulated stand", "origin": "emulated",
                                                        "firmware": hello.firmware, "simulated_time": True})

    def now_s(self) -> float:
        return self._t_us * 1e-6

    def set_throttle(self, value: float) -> None:
        self._wanted = value

    def poll(self, timeout_s: float) -> Heard:
        span_s = min(timeout_s, self._tick_s)
        if span_s > 0.0:
            most = self._limits.slew_per_s * span_s
            self._sent += min(max(self._wanted - self._sent, -most), most)
            self._token += 1
            self._tell(Throttle(value=self._sent, token=self._token, deadline_ms=DEADLINE_MS))
            self._t_us += round(span_s * 1e6)
            self._take(self._device.advance(self._t_us))
        heard = Heard(self._readings, self._cycles)
        self._readings, self._cycles = [], []
        return heard

    def mount(self, condition: Condition) -> None:
        """The shield; here also another propeller (a name in fixtures/thrust) or distance, 1 / distance in pressure."""
        if condition.propeller:
            self._device.plant = load_plant(condition.propeller)
        distance_m = condition.hub_distance_m or HUB_DISTANCE_M
        louder = self._noise.hover_rms_counts * HUB_DISTANCE_M / distance_m
        self._device.noise = replace(self._noise, hover_rms_counts=louder)
        self._device.mount(condition.shield)

    def trouble(self) -> str | None:
        return None

    def counters(self) -> dict[str, Any]:
        return link_counters(self._decoder, self._assembler)

    def stop(self) -> dict[str, Any]:
        self._wanted = self._sent = 0.0
        self._token += 1
        self._tell(Throttle(value=0.0, token=self._token, deadline_ms=DEADLINE_MS))
        applied = self._device.throttle.applied
        return {"idle": applied == 0.0, "confirmed": applied == 0.0, "seconds": 0.0}

    def close(self) -> None:
        if self._writer is not None:
            writer, self._writer = self._writer, None
            writer.close()

    def _tell(self, message: Message) -> None:
        self._take(self._device.receive(encode(message), self._t_us))

    def _take(self, data: bytes) -> None:
        if self._writer is not None and data:
            self._writer.write(data, self._t_us)
        for message in self._decoder.feed(data):
            if isinstance(message, Stand):
                self._readings.append(reading_of(message, self._t_us * 1e-6))
            cycle = self._assembler.add(message)
            if cycle is not None:
                self._cycles.append(cycle)


def reading_of(stand: Stand, time_s: float) -> StandReading:
    """A STAND message as a reading."""
    return StandReading(time_s=time_s, thrust_n=stand.thrust_n, torque_n_m=stand.torque_n_m, rpm=stand.rpm,
                        voltage_v=stand.voltage_v, current_a=stand.current_a,
                        esc_temperature_c=stand.esc_temperature_c, motor_temperature_c=stand.motor_temperature_c,
                        throttle=stand.throttle, token=stand.token)


def hello_dict(hello: Hello) -> dict[str, Any]:
    """A HELLO for the journal."""
    return {"firmware": hello.firmware,
            "sensors": [{"sensor": s.sensor, "role": s.role, "serial": s.serial, "fop_hz": s.fop_hz,
                         "bandwidth_hz": s.bandwidth_hz, "self_test": s.self_test, "transmits": s.transmits}
                        for s in hello.sensors]}


def link_counters(decoder: Decoder, assembler: CycleAssembler) -> dict[str, Any]:
    """Losses on the link."""
    link, cycles = decoder.counters, assembler.counters
    return {**vars_of(link), **{f"cycle_{k}": v for k, v in vars_of(cycles).items()}}


def vars_of(counters: Any) -> dict[str, int]:
    """Fields of a counters object that are whole numbers."""
    names = getattr(counters, "__slots__", None) or vars(counters)
    return {name: value for name in names if isinstance(value := getattr(counters, name), int)}
