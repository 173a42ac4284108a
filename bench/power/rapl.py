"""The processor package's own energy counters: RAPL in Linux. The processor only, not the board."""

import time
from pathlib import Path
from typing import Literal

from bench.power import Energy, Mark, difference
from saranga.errors import DeviceError
from saranga.evaluation.power.rapl import ROOT, Rapl
from saranga.evaluation.power.rapl import build as open_rapl

NAME = "rapl"
ABOUT = "energy counters of the processor package (x86, Linux; root only on most systems)"


class RaplSource:
    """PowerSource over `saranga.evaluation.power.rapl`."""

    name = NAME
    origin: Literal["measured", "recorded"] = "measured"

    def __init__(self, root: Path) -> None:
        self._root = root
        self._rapl: Rapl | None = None

    def open(self) -> str:
        """Raises DeviceError where there are no counters, or they may not be read."""
        self._rapl = open_rapl(self._root)
        return f"RAPL, processor package, {self._root}"

    def mark(self) -> Mark:
        if self._rapl is None:
            raise DeviceError(f"{self.name} is not open: open it first")
        return Mark(time.monotonic(), self._rapl.energy_j())

    def between(self, start: Mark, end: Mark) -> Energy:
        return difference(self.name, start, end)

    def close(self) -> None:
        self._rapl = None


def build(path: str = str(ROOT)) -> RaplSource:
    """`path`: where the counters are."""
    return RaplSource(Path(path))
