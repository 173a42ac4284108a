"""An emulated device on a byte link in simulated time: waiting costs no time, and a run is the same each time."""

from typing import Any

from bench.rig.check import CheckPlan, examine, gather
from bench.rig.driver import Rig
from bench.rig.emulate_command import make_device
from bench.verdict import Verdict, load_limits, worst
from saranga.errors import DeviceError

STEP_S = 0.005


class SimulatedLink:
    """`now` turns only while somebody reads."""

    url = "emulated:"

    def __init__(self, *faults: str, sonar: str = "pair", seed: int = 1, reflector: str = "0.8,30", plant: Any = None,
                 **more: Any) -> None:
        self.device = make_device(sonar, None, [], 0.0, reflector, list(faults), seed, **more)
        self.device.plant = plant
        self.t_s = 0.0
        self._answers = b""
        self._is_open = False

    def now(self) -> float:
        return self.t_s

    def sleep(self, seconds: float) -> None:
        self.t_s += seconds

    def open(self) -> None:
        if not self.device.plugged(self._t_us):
            raise DeviceError("emulated: cannot be opened")
        self._is_open = True

    def read(self, timeout_s: float) -> bytes:
        self._check()
        until = self.t_s + timeout_s
        while True:
            data, self._answers = self._answers + self.device.advance(self._t_us), b""
            if data or self.t_s >= until:
                return data
            self.t_s += STEP_S
            self._check()

    def write(self, data: bytes) -> None:
        self._check()
        self._answers += self.device.receive(data, self._t_us)

    def close(self) -> None:
        self._is_open = False

    @property
    def _t_us(self) -> int:
        return round(self.t_s * 1e6)

    def _check(self) -> None:
        if not self._is_open or not self.device.plugged(self._t_us):
            raise DeviceError("emulated: lost: the other end has closed; was it unplugged?")


def simulated_check(*faults: str, sonar: str = "pair", seed: int = 1, emulated: dict[str, Any] | None = None,
                    **plan: Any) -> tuple[Verdict, dict[str, dict[str, Any]]]:
    """Verdict and the checks by name, of a check in simulated time."""
    link = SimulatedLink(*faults, sonar=sonar, seed=seed, **(emulated or {}))
    rig = Rig(link, now=link.now, sleep=link.sleep)
    rig.open()
    evidence = gather(rig, CheckPlan("emulated:", sonar=sonar, **plan))
    rows = examine(evidence, load_limits("rig"), rig.origin)
    rig.close()
    return worst(Verdict(row["verdict"]) for row in rows), {row["name"]: row for row in rows}
