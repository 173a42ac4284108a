"""Energy counters of the processor package (Intel RAPL, also AMD): /sys/class/powercap in Linux."""

from pathlib import Path

from saranga.errors import DeviceError

NAME = "rapl"
ROOT = Path("/sys/class/powercap")


class Rapl:
    """Sum of all packages. The counters wrap, which is followed as long as they are read in time (minutes)."""

    name = NAME

    def __init__(self, root: Path) -> None:
        # intel-rapl:0 is a package, intel-rapl:0:1 a part of it that is counted there already
        self._zones = sorted(p for p in root.glob("intel-rapl:*") if p.name.count(":") == 1)
        if not self._zones:
            raise DeviceError(f"no energy counters in {root}: this machine, or its container, has no RAPL; leave out "
                              "--power, or measure on the machine itself")
        self._most_uj = [_number(zone / "max_energy_range_uj") for zone in self._zones]
        self._last_uj = [_number(zone / "energy_uj") for zone in self._zones]
        self._total_uj = 0

    def energy_j(self) -> float:
        """Joules since this object was made."""
        for k, zone in enumerate(self._zones):
            now = _number(zone / "energy_uj")
            step = now - self._last_uj[k]
            self._total_uj += step if step >= 0 else step + self._most_uj[k]
            self._last_uj[k] = now
        return self._total_uj * 1e-6


def _number(path: Path) -> int:
    try:
        return int(path.read_text())
    except PermissionError:
        raise DeviceError(f"{path} may not be read: only root may read energy counters; run it as root, or allow it "
                          f"(chmod o+r {path})") from None
    except (OSError, ValueError) as error:
        raise DeviceError(f"{path} cannot be read: {error}; leave out --power") from error


def build(root: str | Path = ROOT) -> Rapl:
    """RAPL counters below `root`.

    Raises:
        DeviceError: none there, or they may not be read.
    """
    return Rapl(Path(root))
