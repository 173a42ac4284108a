"""TI INA228 on I2C by its own energy accumulator, through `adafruit-circuitpython-ina228` (and Blinka's `board`)."""

import importlib
import math
import time
from typing import Any, Literal

from bench.power import Energy, Mark, difference
from saranga.errors import DeviceError

NAME = "ina228"
ABOUT = "INA228 on I2C: ina228:0x40?shunt_ohm=0.015&max_a=10; needs `pip install adafruit-circuitpython-ina228`"
PACKAGE = "adafruit_ina228"
COUNTS = 1 << 40
ENERGY_LSB_PER_A = 16.0 * 3.2 / (1 << 19)
"""Joules a count for one ampere of full scale (data sheet: 16 x 3.2 x CURRENT_LSB, CURRENT_LSB = max / 2^19)."""


class Ina228:
    """PowerSource. The counter has 40 bits and is followed over its end."""

    name = NAME
    origin: Literal["measured", "recorded"] = "measured"

    def __init__(self, address: int, shunt_ohm: float, max_a: float) -> None:
        self._address = address
        self._shunt_ohm = shunt_ohm
        self._max_a = max_a
        self._sensor: Any = None
        self._last_j = 0.0
        self._total_j = 0.0

    def open(self) -> str:
        """Raises DeviceError where the package, the bus or the chip is absent."""
        try:
            package = importlib.import_module(PACKAGE)
            board = importlib.import_module("board")
        except (ImportError, NotImplementedError) as error:
            raise DeviceError(f"{self.name}: its Python package is absent or does not know this computer ({error}): "
                              "pip install adafruit-circuitpython-ina228") from error
        try:
            sensor = package.INA228(board.I2C(), address=self._address)
            sensor.set_calibration(self._shunt_ohm, self._max_a)
            sensor.reset_accumulators()
            volts = float(sensor.bus_voltage)
        except Exception as error:  # the package raises OSError, ValueError and RuntimeError, undocumented
            raise DeviceError(f"{self.name}: nothing at I2C address 0x{self._address:02x}: {error}; check wiring and "
                              "address") from error
        self._sensor, self._last_j, self._total_j = sensor, 0.0, 0.0
        return (f"INA228 at 0x{self._address:02x}, shunt {self._shunt_ohm:g} ohm, full scale {self._max_a:g} A, "
                f"{volts:.3f} V")

    def mark(self) -> Mark:
        if self._sensor is None:
            raise DeviceError(f"{self.name} is not open: open it first")
        try:
            energy_j = float(self._sensor.energy)
        except OSError as error:
            raise DeviceError(f"{self.name}: lost: {error}; check its wiring") from error
        now_s = time.monotonic()
        step = energy_j - self._last_j
        self._total_j += step if step >= 0.0 else step + COUNTS * ENERGY_LSB_PER_A * self._max_a
        self._last_j = energy_j
        return Mark(now_s, self._total_j)

    def between(self, start: Mark, end: Mark) -> Energy:
        return difference(self.name, start, end)

    def close(self) -> None:
        self._sensor = None


def build(path: str = "0x40", shunt_ohm: str = "0.015", max_a: str = "10") -> Ina228:
    """The chip at an I2C address.

    Args:
        path: the address, 0x40..0x4f.
        shunt_ohm, max_a: of the board; 0.015 ohm and 10 A on the usual breakout.

    Raises:
        ValueError: a value outside its limits.
    """
    address = int(path, 0)
    if not 0x40 <= address <= 0x4F:
        raise ValueError(f"address is {path}: it must be 0x40..0x4f")
    shunt, most = float(shunt_ohm), float(max_a)
    if not (math.isfinite(shunt) and 1e-5 <= shunt <= 10.0):
        raise ValueError(f"shunt_ohm is {shunt_ohm}: it must be 0.00001..10")
    if not (math.isfinite(most) and 1e-3 <= most <= 1000.0):
        raise ValueError(f"max_a is {max_a}: it must be 0.001..1000")
    return Ina228(address, shunt, most)
