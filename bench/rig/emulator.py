"""An emulated rig and stand: rig protocol v1 in bytes, on a clock that its owner turns. No I/O, no threads.

`receive(data, t_us)` takes the host's bytes and answers; `advance(t_us)` lives up to that time and returns what the
device has said meanwhile. So it runs in simulated time in tests and in wall time behind a port (`serve.py`).
"""

import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from cobs import cobs

from bench.rig.bench_acoustics import BenchAcoustics, Reflector
from bench.rig.faults import DeviceFaults
from bench.rig.noise_law import NoiseLaw
from bench.rig.throttle_keeper import ThrottleKeeper
from saranga.echo import SonarGeometry
from saranga.wire import (
    ALL_SENSORS,
    FLAG_BOOT,
    FLAG_OVERRUN,
    MODE_RECEIVE_ONLY,
    Config,
    Decoder,
    Echo,
    Fault,
    Hello,
    HelloRequest,
    Message,
    SelfTest,
    SensorInfo,
    Stand,
    Start,
    Status,
    Stop,
    Throttle,
    encode,
)

FIRMWARE = "saranga-rig 1.0 emulated"
STATUS_PERIOD_US = 1_000_000
STAND_PERIOD_US = 20_000
LONGEST_STEP_S = 0.1
UNSUPPORTED, BAD_CONFIG, DEAD_MAN = 1, 2, 3
LINK_TEST = 1
USUAL_SAMPLES = 340
"""The longest record of the sensors' general-purpose firmware, at ODR 6 (hardware.md)."""
Truth = Callable[[dict[str, Any]], None]


class Plant(Protocol):
    """Propeller, motor and battery: `step` returns an object with the fields of STAND, those it has.

    One with a `truth` (the same without measurement noise) is heard by that.
    """

    def step(self, dt_s: float, throttle: float) -> Any: ...


class EmulatedDevice:
    """A rig with two or three sensors, and a thrust stand where it is given a plant.

    Args:
        sensors: the suite, as flights use it.
        plant: what the throttle drives; None for a rig without a stand.
        noise: how loud the propeller is; `shield` and `mount` choose what is between it and the sensors.
        faults: what is wrong with it.
        reflector: the pole on the bench; None for free field.
        seed: of every draw.
        start_us: where the device's own clock begins (it wraps at 2^32).
        backlog_us: in wall time, cycles further behind than this are lost and counted as overruns.
        truth: called with an event, a dict with "t_us" and "event", for each thing that a test wants to know.
    """

    def __init__(self, sensors: SonarGeometry, plant: Plant | None = None, noise: NoiseLaw | None = None,
                 faults: DeviceFaults | None = None, *, shield: str = "none", reflector: Reflector | None = None,
                 seed: int = 1, start_us: int = 0, backlog_us: int | None = None, truth: Truth | None = None) -> None:
        self.faults = faults or DeviceFaults()
        self.noise = noise or NoiseLaw()
        self.plant = plant
        self.quantities: Any = None
        self.shield = shield
        self.throttle = ThrottleKeeper(self.faults)
        self._sensors = sensors
        self._reflector = reflector
        self._seed = seed
        self._rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([0xE301, seed])))
        self._start_us = start_us
        self._backlog_us = backlog_us
        self._truth = truth
        self._mounting_db = 0.0
        self._mounted_shield = ""
        self._now_us = 0
        self._reset_done = False
        self._boot_hello_due = True
        self._switch_on()
        self.mount(shield)

    # ---- the bench around it ---------------------------------------------------------------------
    def mount(self, shield: str) -> None:
        """Put a shield on ("none": take it off). Each mounting differs from the last by the law's spread."""
        self.noise.noise_rms_counts(1.0, shield)
        self.shield = shield
        self._mounting_db = 0.0 if shield == "none" else float(self._rng.normal()) * self.noise.mounting_sd_db
        self._tell("mount", shield=shield, mounting_db=self._mounting_db)

    def given(self) -> dict[str, Any]:
        """What it was given, JSON-ready: the truth that a measurement is compared with."""
        return {"sonar": self._sensors.name, "seed": self._seed, "noise": asdict(self.noise),
                "faults": self.faults.given(), "quiet_floor_counts": self._sensors.quiet_floor_counts,
                "reflector": asdict(self._reflector) if self._reflector else None, "origin": "emulated",
                "stand": self.plant is not None}

    def warm_up(self) -> None:
        """Compile and fill what the first frame, and the usual CONFIG, would wait for; changes nothing heard later."""
        self._hear().record(self._sensors.roles[0], 0.0, False, np.random.default_rng(0))
        BenchAcoustics(self._sensors, self.faults, self._reflector, self._seed, 6, USUAL_SAMPLES)

    def rotor_rms_counts(self) -> float:
        """RMS |IQ| that the propeller makes at the sensors right now, the quiet floor left out."""
        # The air does not hear the load cell's noise: the plant's truth where it has one.
        thrust_n = _field(getattr(self.plant, "truth", self.quantities), "thrust_n")
        loud = self.noise.noise_rms_counts(thrust_n if math.isfinite(thrust_n) else 0.0, self.shield)
        return loud * 10.0 ** (self._mounting_db / 20.0)

    # ---- the cable -------------------------------------------------------------------------------
    def plugged(self, t_us: int) -> bool:
        """Whether the cable is in."""
        faults = self.faults
        if faults.unplug_at_s is None or t_us < faults.unplug_at_s * 1e6:
            return True
        return faults.unplug_for_s is not None and t_us >= (faults.unplug_at_s + faults.unplug_for_s) * 1e6

    def receive(self, data: bytes, t_us: int) -> bytes:
        """Take the host's bytes at `t_us`; returns the answers. Rubbish is counted, never answered."""
        said = self.advance(t_us)
        if self._hung(t_us) or not self.plugged(t_us):
            return said
        return said + b"".join(self._answer(message, t_us) for message in self._decoder.feed(data))

    def advance(self, t_us: int) -> bytes:
        """Live up to `t_us` (never back); returns wire bytes. What nobody could hear is lost, as on a real cable."""
        parts: list[bytes] = []
        if self._boot_hello_due:
            self._boot_hello_due = False
            parts.append(self._hello(self._now_us, FLAG_BOOT))
        self._skip_backlog(t_us)
        while True:
            due_us, event = min(self._events(), key=lambda pair: pair[0])
            if due_us > t_us:
                break
            now_us = max(round(due_us), self._now_us)
            self._live(now_us)
            data = event(now_us)
            if self.plugged(now_us) and not self._hung(now_us):
                parts.append(data)
        self._live(t_us)
        return b"".join(parts)

    # ---- time ------------------------------------------------------------------------------------
    def _events(self) -> list[tuple[float, Callable[[int], bytes]]]:
        faults = self.faults
        reset_us = math.inf if self._reset_done or faults.reset_at_s is None else round(faults.reset_at_s * 1e6)
        events: list[tuple[float, Callable[[int], bytes]]] = [(reset_us, self._reset),
                                                             (self.throttle.expires_us, self._expire),
                                                             (self._status_us, self._say_status)]
        if self.running:
            events.append((self._cycle_us, self._cycle))
        if self.plant is not None:
            events.append((self._stand_us, self._say_stand))
        return events

    def _live(self, t_us: int) -> None:
        """The plant, from where it is to `t_us`, at the throttle of this stretch."""
        span_s = (t_us - self._now_us) * 1e-6
        if span_s <= 0.0:
            return
        self._now_us = t_us
        if self.plant is not None:
            steps = math.ceil(span_s / LONGEST_STEP_S)
            for _ in range(steps):
                self.quantities = self.plant.step(span_s / steps, self.throttle.applied)

    def _hung(self, t_us: float) -> bool:
        return self.faults.hang_at_s is not None and t_us >= self.faults.hang_at_s * 1e6

    def _switch_on(self) -> None:
        geometry = self._sensors
        self.running = False
        self.mode = 0
        self.rate_hz = 1e6 / geometry.cycle_us
        self.cycles = self.overruns = 0
        self._odr, self._samples = geometry.odr, geometry.samples
        self._acoustics: BenchAcoustics | None = None
        self._decoder = Decoder()
        self._sequence = dict.fromkeys([ALL_SENSORS, *range(len(geometry.roles))], 0)
        self._self_test = dict.fromkeys(geometry.roles, "untested")
        self._last: dict[str, Echo] = {}
        self._overrun = False
        self._trigger = 0
        self._booted_us = self._now_us
        self._cycle_us = math.inf
        self._status_us: float = self._now_us + STATUS_PERIOD_US
        self._stand_us: float = self._now_us + STAND_PERIOD_US

    def _reset(self, t_us: int) -> bytes:
        self._reset_done = True
        self._switch_on()
        self.throttle.idle()
        self._tell("reset")
        self._tell_throttle("reset")
        return self._hello(t_us, FLAG_BOOT)

    def _device_us(self, t_us: float) -> int:
        elapsed = (t_us - self._booted_us) * (1.0 + self.faults.clock_ppm * 1e-6)
        return round(self._start_us + elapsed) & 0xFFFFFFFF

    # ---- what it says ----------------------------------------------------------------------------
    def _cycle(self, t_us: int) -> bytes:
        self._cycle_us += 1e6 / self.rate_hz
        self.cycles += 1
        self._trigger += 1
        rms = self.rotor_rms_counts()
        parts = [self._frame(role, k, t_us, rms) for k, role in enumerate(self._sensors.roles)]
        self._overrun = False
        return b"".join(parts)

    def _skip_backlog(self, t_us: int) -> None:
        """Cycles that should long have been are lost, as on a device that did not keep up."""
        late_us = t_us - self._cycle_us if self.running else 0.0
        if self._backlog_us is None or late_us <= self._backlog_us:
            return
        lost = int(late_us * self.rate_hz * 1e-6)
        self._cycle_us += lost * 1e6 / self.rate_hz
        self._trigger += lost
        self.overruns += lost
        self._overrun = True

    def _frame(self, role: str, sensor: int, t_us: int, rotor_rms_counts: float) -> bytes:
        faults, rng = self.faults, self._rng
        if faults.dead_sensor == role:
            return b""
        number = self._next(sensor)
        if faults.drops and rng.random() < faults.drops:
            return b""
        iq = self._hear().record(role, rotor_rms_counts, self.mode == MODE_RECEIVE_ONLY, rng)
        last = self._last.get(role)
        if last is not None and last.iq.shape == iq.shape and faults.repeats and rng.random() < faults.repeats:
            iq = last.iq
        # RTC calibration reads the resonance to about a hertz.
        fop = self._sensors.fop_hz + faults.fop_drift_hz_s * (t_us - self._booted_us) * 1e-6 + float(rng.normal()) * 0.5
        echo = Echo(sensor=sensor, sequence=number, trigger=self._trigger & 0xFFFFFFFF,
                    device_time_us=self._device_us(t_us), flags=FLAG_OVERRUN if self._overrun else 0,
                    fop_hz=min(max(fop, 20e3), 200e3), odr=self._odr, mode=self.mode, iq=iq)
        self._last[role] = echo
        data = self._wire(echo)
        if faults.corrupt and rng.random() < faults.corrupt:
            at = int(rng.integers(len(data)))
            data = data[:at] + bytes([data[at] ^ int(rng.integers(1, 256))]) + data[at + 1:]
        return data * 2 if faults.duplicates and rng.random() < faults.duplicates else data

    def _hear(self) -> BenchAcoustics:
        if self._acoustics is None:
            self._acoustics = BenchAcoustics(self._sensors, self.faults, self._reflector, self._seed, self._odr,
                                             self._samples)
        return self._acoustics

    def _say_status(self, t_us: int) -> bytes:
        self._status_us += STATUS_PERIOD_US
        counters = self._decoder.counters
        state = 0 if not self.running else 2 if self.mode == MODE_RECEIVE_ONLY else 1
        return self._wire(Status(sequence=self._next(ALL_SENSORS), device_time_us=self._device_us(t_us),
                                 trigger=self._trigger & 0xFFFFFFFF, overruns=self.overruns, cycles=self.cycles,
                                 host_errors=counters.bad_cobs + counters.bad_crc + counters.bad_message,
                                 temperature_c=self._sensors.temperature_c, state=state))

    def _say_stand(self, t_us: int) -> bytes:
        self._stand_us += STAND_PERIOD_US
        return self._stand(t_us)

    def _stand(self, t_us: int) -> bytes:
        if self.plant is None:
            return b""
        thrust_n = _field(self.quantities, "thrust_n")
        faults = self.faults
        if faults.negative_thrust:
            thrust_n = -thrust_n
        if faults.nan_stand_at_s is not None and t_us >= faults.nan_stand_at_s * 1e6:
            thrust_n = math.nan
        names = ("torque_n_m", "rpm", "voltage_v", "current_a", "esc_temperature_c", "motor_temperature_c")
        measured: dict[str, Any] = {name: _field(self.quantities, name) for name in names}
        return self._wire(Stand(sequence=self._next(ALL_SENSORS), device_time_us=self._device_us(t_us),
                                trigger=self._trigger & 0xFFFFFFFF, thrust_n=thrust_n,
                                **measured,
                                throttle=self.throttle.applied, token=self.throttle.token))

    def _hello(self, t_us: int, flags: int = 0) -> bytes:
        geometry, faults = self._sensors, self.faults
        serials = dict(zip(geometry.roles, geometry.roles, strict=True))
        if faults.swapped_sensors and "right" in serials:
            serials["left"], serials["right"] = "right", "left"
        sensors = tuple(SensorInfo(sensor=k, role=role, fop_hz=geometry.fop_hz, bandwidth_hz=geometry.bandwidth_hz,
                                   self_test=self._self_test[role], transmits=role == geometry.transmitter,
                                   serial=f"emulated-{geometry.name}-{serials[role]}"[:32])
                        for k, role in enumerate(geometry.roles))
        firmware = f"saranga-rig {faults.firmware} emulated" if faults.firmware else FIRMWARE
        return self._wire(Hello(firmware=firmware[:64], sensors=sensors, flags=flags, sequence=self._next(ALL_SENSORS),
                                device_time_us=self._device_us(t_us), has_stand=self.plant is not None,
                                has_throttle=self.plant is not None))

    # ---- what it is told -------------------------------------------------------------------------
    def _answer(self, message: Message, t_us: int) -> bytes:
        if isinstance(message, HelloRequest):
            return self._hello(t_us)
        if isinstance(message, Start):
            self.running, self.mode, self.rate_hz = True, message.mode, message.rate_hz
            self._cycle_us = t_us + 1e6 / message.rate_hz
            self._tell("start", mode=message.mode, rate_hz=message.rate_hz)
            return b""
        if isinstance(message, Stop):
            self.running = False
            self._tell("stop")
            return b""
        if isinstance(message, Config):
            if message.sensor != ALL_SENSORS:
                return self._complain(BAD_CONFIG, "CONFIG of one sensor: send it to all (255)", t_us)
            self._odr, self._samples, self._acoustics = message.odr, message.samples, None
            self._last.clear()
            # Now, which takes a while, and not when the first cycle waits for it.
            self._hear()
            self._tell("config", odr=message.odr, samples=message.samples)
            return b""
        if isinstance(message, SelfTest):
            return self._test(message, t_us)
        if isinstance(message, Throttle) and self.plant is not None:
            self.throttle.command(message, t_us)
            self._tell_throttle("command", deadline_ms=message.deadline_ms)
            # At once, not with the next period: the host waits for the readback.
            return self._stand(t_us)
        return self._complain(UNSUPPORTED, f"{type(message).__name__.upper()}: this device has none", t_us)

    def _test(self, test: SelfTest, t_us: int) -> bytes:
        """Built-in test: HELLO with its results. Link test: an ECHO whose sample n reads Q = n, I = -n."""
        roles = self._sensors.roles
        chosen = [(k, role) for k, role in enumerate(roles) if test.sensor in (k, ALL_SENSORS)]
        if test.kind != LINK_TEST:
            for _, role in chosen:
                self._self_test[role] = "fail" if self.faults.dead_sensor == role else "pass"
            return self._hello(t_us)
        parts = []
        for k, role in chosen:
            if self.faults.dead_sensor == role:
                continue
            ramp = np.arange(self._samples, dtype=np.int16)
            iq = np.stack([ramp, -ramp], axis=1)
            if self.faults.link_errors == role:
                iq[self._samples // 2, 0] ^= 1
            parts.append(self._wire(Echo(sensor=k, sequence=self._next(k), trigger=0, iq=iq, mode=self.mode,
                                         device_time_us=self._device_us(t_us), fop_hz=self._sensors.fop_hz,
                                         odr=self._odr)))
        return b"".join(parts)

    def _expire(self, t_us: int) -> bytes:
        """The dead-man: nobody has refreshed the throttle in time."""
        self.throttle.idle()
        self._tell_throttle("dead_man")
        said = self._stand(t_us)
        return said + self._complain(DEAD_MAN, "throttle deadline passed without a new command: idle", t_us)

    def _complain(self, code: int, text: str, t_us: int) -> bytes:
        return self._wire(Fault(code=code, text=text, sequence=self._next(ALL_SENSORS),
                                device_time_us=self._device_us(t_us)))

    def _next(self, sensor: int) -> int:
        number = self._sequence[sensor]
        self._sequence[sensor] = (number + 1) & 0xFFFFFFFF
        return number

    def _wire(self, message: Message) -> bytes:
        data = encode(message)
        return data if self.faults.protocol == 1 else _of_protocol(data, self.faults.protocol)

    def _tell(self, event: str, **values: Any) -> None:
        if self._truth is not None:
            self._truth({"t_us": self._now_us, "event": event, **values})

    def _tell_throttle(self, event: str, **values: Any) -> None:
        self._tell(event, applied=self.throttle.applied, token=self.throttle.token, **values)


def _field(quantities: Any, name: str) -> float:
    return float(getattr(quantities, name, math.nan))


def _of_protocol(data: bytes, version: int) -> bytes:
    """The frame as a device of another protocol version would send it: right CRC, other version."""
    body = bytes([version]) + cobs.decode(data[:-1])[1:-4]
    return bytes(cobs.encode(body + struct.pack("<I", zlib.crc32(body)))) + b"\0"
