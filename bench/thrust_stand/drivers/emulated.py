"""The emulated stand in this process: our Teensy's bytes, from the emulated device, in wall time. Nothing turns.

`saranga-bench rig emulate` serves the same device on a port as a process of its own.
"""

import time
from typing import TYPE_CHECKING, Any

from bench.thrust_stand.calibration import Calibration
from bench.thrust_stand.drivers.teensy import TeensyStand
from bench.thrust_stand.registry import Where
from saranga.errors import DeviceError

if TYPE_CHECKING:
    from bench.rig.emulator import EmulatedDevice

NAME = "emulated"
FORMS = "emulated:[?propeller=g1&seed=1&shield=foam=6&fault=nan_stand_at_s=2]"
MEASURES = True
SPINS = True
TICK_S = 0.002
BACKLOG_US = 500_000


class DeviceLink:
    """The cable to an emulated device in the same process: it lives when it is read from or written to."""

    def __init__(self, url: str, device: "EmulatedDevice") -> None:
        self.url = url
        self.device = device
        self._began_s: float | None = None
        self._warm = False
        self._said = b""

    def open(self) -> None:
        if self._began_s is None:
            self._began_s = time.monotonic()

    def read(self, timeout_s: float) -> bytes:
        end_s = time.monotonic() + timeout_s
        while True:
            now_us = self._now_us()
            self._said += self.device.advance(now_us)
            if not self.device.plugged(now_us):
                raise DeviceError(f"{self.url}: lost: the emulated cable is out; was it unplugged?")
            left_s = end_s - time.monotonic()
            if self._said or left_s <= 0.0:
                said, self._said = self._said, b""
                return said
            time.sleep(min(TICK_S, left_s))

    def write(self, data: bytes) -> None:
        now_us = self._now_us()
        if not self.device.plugged(now_us):
            raise DeviceError(f"{self.url}: lost: the emulated cable is out; was it unplugged?")
        self._said += self.device.receive(data, now_us)
        if self.device.running and not self._warm:
            # The rig's first use compiles: seconds, in which the throttle's deadline passes as on a real device.
            self._warm = True
            self.device.warm_up()

    def close(self) -> None:
        """The device lives on, as a real one does."""

    def _now_us(self) -> int:
        if self._began_s is None:
            raise DeviceError(f"{self.url} is not open: open it first")
        return int((time.monotonic() - self._began_s) * 1e6)


def build(where: Where, propeller: str = "g1", seed: int = 1, sonar: str = "pair", shield: str = "", fault: str = "",
          thrust_scale: float = 1.0, thrust_sign: int = 1) -> TeensyStand:
    """An emulated device with rig and stand.

    Args:
        propeller: name in fixtures/thrust, or a path.
        seed: of all noise.
        sonar: name in fixtures/sonars.
        shield: what `rig emulate --shield` takes, or nothing.
        fault: what `rig emulate --fault` takes; several with commas.
        thrust_scale, thrust_sign: see `Calibration`.
    """
    if where.transport or where.path:
        raise where.refused(FORMS)
    if not isinstance(seed, int):
        raise ValueError(f"seed is {seed!r}: it must be a whole number")
    faults: list[Any] = [text for text in str(fault).split(",") if text]
    from bench.rig.emulate_command import make_device  # Here: other drivers shall not wait for the acoustics.

    device = make_device(sonar, str(propeller), [shield] if shield else [], 0.0, "none", faults, seed,
                         backlog_us=BACKLOG_US)
    return TeensyStand(DeviceLink(where.url, device), Calibration(thrust_scale, thrust_sign))
