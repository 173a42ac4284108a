"""What can be wrong with an emulated rig: one field a fault, given as NAME or NAME=VALUE."""

import math
from dataclasses import dataclass, fields
from typing import Any

from saranga.errors import UsageError
from saranga.plugins import nearest_hint

ROLES = ("left", "right", "down")
PROBABILITIES = ("duplicates", "repeats", "drops", "corrupt")
# What a fault given without a value means.
DEFAULTS: dict[str, Any] = {
    "swapped_sensors": True, "dead_transmitter": True, "desync_us": 300.0, "desync_jitter_us": 100.0,
    "fop_drift_hz_s": 20.0, "missing_horn": True, "dead_sensor": "right", "link_errors": "right",
    "noisy_sensor": "right", "duplicates": 0.01, "repeats": 0.01, "drops": 0.01, "corrupt": 0.01, "reset_at_s": 2.0,
    "unplug_at_s": 2.0, "unplug_for_s": 1.0, "hang_at_s": 2.0, "clock_ppm": 2000.0, "firmware": "2.0", "protocol": 2,
    "no_dead_man": True, "throttle_stuck": True, "nan_stand_at_s": 2.0, "negative_thrust": True,
}


@dataclass(frozen=True)
class DeviceFaults:
    """Faults of the emulated device. Times are seconds since it was switched on; None or 0: never.

    Attributes:
        swapped_sensors: the left and the right sensor are plugged into each other's place.
        dead_transmitter: the transmitting sensor makes no sound.
        desync_us: the right sensor starts recording this late.
        desync_jitter_us: it starts at a random time, standard deviation.
        fop_drift_hz_s: the resonance of all sensors wanders.
        missing_horn: the transmitter lacks its horn: it rings on longer, and is quieter.
        dead_sensor: this role sends nothing. link_errors: its link test comes back wrong.
        noisy_sensor: its own noise is ten times as high.
        duplicates: share of frames sent twice. repeats: share of frames that carry the record before them anew.
        drops, corrupt: share of frames lost, and with one byte changed.
        reset_at_s, hang_at_s: the device starts again, or says nothing more and hears nothing.
        unplug_at_s, unplug_for_s: the cable is out from then on, for that long (for ever without the second).
        clock_ppm: the device's clock is fast.
        firmware: version it says it has. protocol: version of the protocol in its frames.
        no_dead_man: it holds a throttle for ever. throttle_stuck: the motor stays at the highest throttle it had.
        nan_stand_at_s: the load cell reads NaN from then on. negative_thrust: its sign is wrong.
    """

    swapped_sensors: bool = False
    dead_transmitter: bool = False
    desync_us: float = 0.0
    desync_jitter_us: float = 0.0
    fop_drift_hz_s: float = 0.0
    missing_horn: bool = False
    dead_sensor: str = ""
    link_errors: str = ""
    noisy_sensor: str = ""
    duplicates: float = 0.0
    repeats: float = 0.0
    drops: float = 0.0
    corrupt: float = 0.0
    reset_at_s: float | None = None
    unplug_at_s: float | None = None
    unplug_for_s: float | None = None
    hang_at_s: float | None = None
    clock_ppm: float = 0.0
    firmware: str = ""
    protocol: int = 1
    no_dead_man: bool = False
    throttle_stuck: bool = False
    nan_stand_at_s: float | None = None
    negative_thrust: bool = False

    def given(self) -> dict[str, Any]:
        """The faults that are there."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}


def fault_names() -> list[str]:
    """Every fault that can be asked for."""
    return [f.name for f in fields(DeviceFaults)]


def parse_faults(texts: list[str]) -> DeviceFaults:
    """From `--fault NAME` and `--fault NAME=VALUE`.

    Raises:
        UsageError: an unknown name, or a value that it cannot have.
    """
    return DeviceFaults(**dict(_parse(text) for text in texts))


def _parse(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    name = name.replace("-", "_")
    if name not in DEFAULTS:
        raise UsageError(f"--fault {text!r}: no such fault{nearest_hint(name, fault_names())}: known are "
                         f"{', '.join(fault_names())}")
    default = DEFAULTS[name]
    if not equals:
        return name, default
    if isinstance(default, bool):
        if value not in ("true", "false"):
            raise UsageError(f"--fault {text!r}: must be true or false")
        return name, value == "true"
    if isinstance(default, str):
        if name != "firmware" and value not in ROLES:
            raise UsageError(f"--fault {text!r}: must be one of {', '.join(ROLES)}")
        return name, value
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    low = -1e6 if name == "fop_drift_hz_s" or name == "clock_ppm" else 0.0
    high = 1.0 if name in PROBABILITIES else 255.0 if name == "protocol" else 1e6
    if not low <= number <= high:
        raise UsageError(f"--fault {text!r}: must be a number in {low:g}..{high:g}")
    return name, int(number) if name == "protocol" else number
