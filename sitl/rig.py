"""The sonar rig as the wire sees it: a scene's echoes as frames of rig protocol v1, and answers to the host.

It has no clock and no transport of its own: whoever owns simulated time calls `cycle` at each trigger and carries the
bytes (in-process, `rig_ports.py`). Every fault is drawn from the seed.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saranga.echo import SonarGeometry
from saranga.wire import (
    ALL_SENSORS,
    FLAG_BOOT,
    MAX_SAMPLES,
    MODE_RECEIVE_ONLY,
    MODE_TRANSMIT_RECEIVE,
    Config,
    Decoder,
    Echo,
    Fault,
    Hello,
    HelloRequest,
    Message,
    SelfTest,
    SensorInfo,
    Start,
    Status,
    Stop,
    encode,
)
from sitl.acoustics.sonar import AcousticModel

FIRMWARE = "virtual rig 1"
STATUS_PERIOD_US = 1_000_000
FAULT_STREAM = 0xFA17
UNSUPPORTED, BAD_CONFIG = 1, 2
SELF_TEST_LINK = 1


@dataclass(frozen=True)
class RigFaults:
    """What is wrong with the rig or its cable. Times are simulated microseconds, None is never.

    Attributes:
        silent_after_us: nothing at all is said from then on.
        dead_role: this sensor sends nothing from `dead_after_us` on (from the start where that is None).
        corrupt_probability: of one byte of a frame being changed.
        drop_probability: of a frame being lost.
        delay_us: by which every frame of `cycle` is late, at the earliest with a later cycle.
        cycle_drop_probability: of all frames of a cycle being lost.
        swapped: the records of left and right change places.
        gain_db: of every record, before the converter's limit.
        clock_offset_us: added to the times in ECHO and STATUS.
    """

    silent_after_us: int | None = None
    dead_role: str | None = None
    dead_after_us: int | None = None
    corrupt_probability: float = 0.0
    drop_probability: float = 0.0
    delay_us: int = 0
    cycle_drop_probability: float = 0.0
    swapped: bool = False
    gain_db: float = 0.0
    clock_offset_us: int = 0


class VirtualRig:
    """A rig whose sensors hear an `AcousticModel`.

    It streams from the start, as nobody in the same process needs to START it; STOP ends that and START begins it
    anew. `running` is True from a START to the next STOP. The first HELLO carries FLAG_BOOT.
    """

    def __init__(self, model: AcousticModel, geometry: SonarGeometry, faults: RigFaults | None = None) -> None:
        self.faults = faults or RigFaults()
        self.running = False
        self.mode = MODE_TRANSMIT_RECEIVE
        self.rate_hz = 1e6 / geometry.cycle_us
        self.cycles = 0
        self._model = model
        self._geometry = geometry
        self._stopped = False
        self._booted = False
        self._decoder = Decoder()
        self._sequence = dict.fromkeys([ALL_SENSORS, *range(len(geometry.roles))], 0)
        self._self_test = dict.fromkeys(geometry.roles, "untested")
        self._rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([FAULT_STREAM, model.seed])))
        self._late: deque[tuple[int, bytes]] = deque()
        self._status_due_us = STATUS_PERIOD_US

    @property
    def geometry(self) -> SonarGeometry:
        """The sensors as configured now."""
        return self._geometry

    def hello(self, t_us: int = 0) -> bytes:
        """HELLO as wire bytes, untouched by faults: what a host hears at power-up."""
        geometry = self._geometry
        sensors = tuple(
            SensorInfo(sensor=k, role=role, fop_hz=geometry.fop_hz, bandwidth_hz=geometry.bandwidth_hz,
                       self_test=self._self_test[role], transmits=role == geometry.transmitter,
                       serial=f"virtual-{geometry.name}-{role}"[:32])
            for k, role in enumerate(geometry.roles))
        flags = 0 if self._booted else FLAG_BOOT
        self._booted = True
        return encode(Hello(firmware=FIRMWARE, sensors=sensors, flags=flags, sequence=self._next(ALL_SENSORS),
                            device_time_us=t_us & 0xFFFFFFFF))

    def cycle(self, trigger: int, t_us: int, pos_m: NDArray[np.float64], quat: NDArray[np.float64],
              vel_m_s: NDArray[np.float64], thrust_n: NDArray[np.float64]) -> bytes:
        """The frames of one trigger, and STATUS once a second.

        Args:
            trigger: number of the trigger, sent modulo 2^32 as is the time.
            t_us: simulated time of the trigger.
            pos_m, quat, vel_m_s, thrust_n: the vehicle, as `AcousticModel.cycle`.

        Returns:
            Wire bytes; b"" while stopped or silent.
        """
        if self._stopped or self._silent(t_us):
            self._late.clear()
            return b""
        receive_only = self.mode == MODE_RECEIVE_ONLY
        records = self._model.cycle(pos_m, quat, vel_m_s, thrust_n, t_us, receive_only=receive_only)
        geometry = self._geometry
        self.cycles += 1
        lost = self._cycle_lost()
        for sensor, role in enumerate(geometry.roles):
            if self._dead(role, t_us):
                continue
            sequence = self._next(sensor)
            if lost:
                continue
            self._send(Echo(sensor=sensor, sequence=sequence, trigger=trigger & 0xFFFFFFFF,
                            device_time_us=self._device_time(t_us), fop_hz=geometry.fop_hz, odr=geometry.odr,
                            mode=self.mode, iq=self._record(records, role)), t_us)
        if t_us >= self._status_due_us:
            self._status_due_us = (t_us // STATUS_PERIOD_US + 1) * STATUS_PERIOD_US
            self._send(self._status(trigger, t_us), t_us)
        return self._due(t_us)

    def receive(self, data: bytes, t_us: int = 0) -> bytes:
        """Take the host's bytes; returns the answers. Rubbish is counted, never answered."""
        answers = [self._answer(message, t_us) for message in self._decoder.feed(data)]
        return b"" if self._silent(t_us) else b"".join(answers)

    # ---- host messages ---------------------------------------------------------------------------
    def _answer(self, message: Message, t_us: int) -> bytes:
        if isinstance(message, HelloRequest):
            return self.hello(t_us)
        if isinstance(message, Start):
            self.running, self._stopped = True, False
            self.mode, self.rate_hz = message.mode, message.rate_hz
            return b""
        if isinstance(message, Stop):
            self.running, self._stopped = False, True
            return b""
        if isinstance(message, Config):
            return self._configure(message, t_us)
        if isinstance(message, SelfTest):
            return self._test(message, t_us)
        return self._complain(UNSUPPORTED, f"{type(message).__name__}: the virtual rig has none", t_us)

    def _configure(self, config: Config, t_us: int) -> bytes:
        if config.sensor != ALL_SENSORS:
            return self._complain(BAD_CONFIG, "CONFIG of one sensor: send it to all (255)", t_us)
        if not (2 <= config.odr <= 6 and 1 <= config.samples <= MAX_SAMPLES):
            return self._complain(BAD_CONFIG, f"CONFIG odr {config.odr} samples {config.samples}: ODR 2..6, samples "
                                              f"1..{MAX_SAMPLES}", t_us)
        self._model = self._model.with_geometry(odr=config.odr, samples=config.samples,
                                                ring_down_samples=config.ring_down_samples)
        self._geometry = self._model.geometry
        return b""

    def _test(self, test: SelfTest, t_us: int) -> bytes:
        """Built-in test: HELLO with its results. Link test: an ECHO whose sample n reads Q = n, I = -n."""
        chosen = [(k, role) for k, role in enumerate(self._geometry.roles) if test.sensor in (k, ALL_SENSORS)]
        if test.kind != SELF_TEST_LINK:
            for _, role in chosen:
                self._self_test[role] = "fail" if self._dead(role, t_us) else "pass"
            return self.hello(t_us)
        ramp = np.arange(self._geometry.samples, dtype=np.int16)
        iq = np.stack([ramp, -ramp], axis=1)
        return b"".join(
            encode(Echo(sensor=k, sequence=self._next(k), trigger=0, device_time_us=t_us & 0xFFFFFFFF,
                        fop_hz=self._geometry.fop_hz, odr=self._geometry.odr, mode=self.mode, iq=iq))
            for k, role in chosen if not self._dead(role, t_us))

    def _complain(self, code: int, text: str, t_us: int) -> bytes:
        return encode(Fault(code=code, text=text, sequence=self._next(ALL_SENSORS), device_time_us=t_us & 0xFFFFFFFF))

    # ---- the way out -----------------------------------------------------------------------------
    def _status(self, trigger: int, t_us: int) -> Status:
        counters = self._decoder.counters
        return Status(sequence=self._next(ALL_SENSORS), trigger=trigger & 0xFFFFFFFF,
                      device_time_us=self._device_time(t_us), cycles=self.cycles & 0xFFFFFFFF,
                      temperature_c=self._model.weather.temperature_c,
                      host_errors=counters.bad_cobs + counters.bad_crc + counters.bad_message,
                      state=2 if self.mode == MODE_RECEIVE_ONLY else 1)

    def _next(self, sensor: int) -> int:
        number = self._sequence[sensor]
        self._sequence[sensor] = (number + 1) & 0xFFFFFFFF
        return number

    def change_model(self, model: AcousticModel) -> None:
        """Hear the world through another model from now on; the sensors stay as they are configured."""
        self._model = model.with_geometry(odr=self._geometry.odr, samples=self._geometry.samples,
                                          ring_down_samples=self._geometry.ring_down_samples)

    def _device_time(self, t_us: int) -> int:
        return (t_us + self.faults.clock_offset_us) & 0xFFFFFFFF

    def _record(self, records: dict[str, NDArray[np.int16]], role: str) -> NDArray[np.int16]:
        """What that sensor's socket delivers."""
        faults = self.faults
        if faults.swapped:
            role = {"left": "right", "right": "left"}.get(role, role)
        record = records[role]
        if faults.gain_db == 0.0:
            return record
        most = self._geometry.saturation_counts
        amplified = np.rint(record * 10.0 ** (faults.gain_db / 20.0))
        return np.clip(amplified, -most, most).astype(np.int16)

    def _cycle_lost(self) -> bool:
        probability = self.faults.cycle_drop_probability
        return probability > 0.0 and self._rng.random() < probability

    def _dead(self, role: str, t_us: int) -> bool:
        return role == self.faults.dead_role and t_us >= (self.faults.dead_after_us or 0)

    def _silent(self, t_us: int) -> bool:
        return self.faults.silent_after_us is not None and t_us >= self.faults.silent_after_us

    def _send(self, message: Message, t_us: int) -> None:
        faults = self.faults
        if faults.drop_probability > 0.0 and self._rng.random() < faults.drop_probability:
            return
        data = encode(message)
        if faults.corrupt_probability > 0.0 and self._rng.random() < faults.corrupt_probability:
            at = int(self._rng.integers(len(data)))
            flip = int(self._rng.integers(1, 256))
            data = data[:at] + bytes([data[at] ^ flip]) + data[at + 1:]
        self._late.append((t_us + faults.delay_us, data))

    def _due(self, t_us: int) -> bytes:
        parts = []
        while self._late and self._late[0][0] <= t_us:
            parts.append(self._late.popleft()[1])
        return b"".join(parts)
