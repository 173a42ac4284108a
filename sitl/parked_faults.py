"""What can be wrong with a parked vehicle: one field a fault, given as NAME or NAME=VALUE; PARAMETER=VALUE as well."""

import math
from dataclasses import dataclass, field, fields
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import UsageError
from saranga.plugins import nearest_hint
from sitl.autopilot.frames import FrameReader

# What a fault given without a value means.
DEFAULTS: dict[str, Any] = {
    "no_flow": True, "flow_quality": 3.0, "flow_every": 25.0, "no_range": True, "range_offset_m": 0.6,
    "no_origin": True, "says_armed": True, "says_plane": True, "says_version": 0x03060000, "second_vehicle": True,
    "silent": True, "delay_ms": 120.0, "stall_ms": 300.0, "drop": 0.2, "corrupt": 0.1, "clock_jump_s": 5.0,
    "shake_m_s2": 40.0, "mute": "EKF_STATUS_REPORT",
}
SECOND_SYSTEM = 7


@dataclass(frozen=True)
class ParkedFaults:
    """Faults of a parked vehicle.

    Attributes:
        no_flow, no_range: the sensor says nothing. flow_quality: 0..255. flow_every: only each n-th message comes.
        range_offset_m: the range finder reads too far. shake_m_s2: 45 Hz in its accelerometers, amplitude.
        no_origin: nobody tells it where it is.
        says_armed: its heartbeats say armed (it is not). says_plane: they say it is an aeroplane.
        says_version: packed firmware version that it gives. second_vehicle: another one talks on the same link.
        silent: nothing comes out. mute: messages of this name do not.
        delay_ms: what comes out comes late. stall_ms: twice a second nothing comes out for so long.
        drop, corrupt: share of messages lost, and with one byte changed.
        clock_jump_s: its clock leaps while it is watched.
        parameters: set at boot.
    """

    no_flow: bool = False
    flow_quality: float = 255.0
    flow_every: float = 1.0
    no_range: bool = False
    range_offset_m: float = 0.0
    shake_m_s2: float = 0.0
    no_origin: bool = False
    says_armed: bool = False
    says_plane: bool = False
    says_version: float = 0.0
    second_vehicle: bool = False
    silent: bool = False
    delay_ms: float = 0.0
    stall_ms: float = 0.0
    drop: float = 0.0
    corrupt: float = 0.0
    clock_jump_s: float = 0.0
    mute: str = ""
    parameters: dict[str, float] = field(default_factory=dict)


def parse_parked_faults(texts: list[str]) -> ParkedFaults:
    """Faults from NAME, NAME=VALUE and PARAMETER=VALUE (capitals).

    Raises:
        UsageError: an unknown name or a value that is no number.
    """
    given: dict[str, Any] = {}
    parameters: dict[str, float] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if name.isupper() or (equals and name.upper() == name):
            parameters[name] = _number(text, value)
            continue
        name = name.replace("-", "_")
        if name not in DEFAULTS:
            known = [f.name for f in fields(ParkedFaults) if f.name != "parameters"]
            raise UsageError(f"fault {text!r}: no such fault{nearest_hint(name, known)}: known are {', '.join(known)}, "
                             "and PARAMETER=VALUE")
        default = DEFAULTS[name]
        if not equals or isinstance(default, bool):
            given[name] = default
        else:
            given[name] = value if isinstance(default, str) else _number(text, value)
    return ParkedFaults(**given, parameters=parameters)


def _number(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"fault {text!r}: needs a number after =")
    return number


class Disguise:
    """Changes what a vehicle says, message by message; never what it does."""

    def __init__(self, faults: ParkedFaults, seed: int = 1) -> None:
        import random

        self._faults = faults
        self._reader = FrameReader()
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._second = mavlink.MAVLink(None, srcSystem=SECOND_SYSTEM, srcComponent=1)
        self._rng = random.Random(seed)
        self._times = 0
        f = faults
        self.changes_nothing = not (f.says_armed or f.says_plane or f.says_version or f.second_vehicle or f.silent
                                    or f.drop or f.corrupt or f.clock_jump_s or f.mute)

    def __call__(self, data: bytes) -> bytes:
        """The bytes as they come out."""
        if self.changes_nothing or not data:
            return data
        if self._faults.silent:
            return b""
        return b"".join(self._changed(frame.raw, self._reader.decode(frame)) for frame in self._reader.feed(data))

    def _changed(self, raw: bytes, message: Any) -> bytes:
        faults = self._faults
        if self._rng.random() < faults.drop:
            return b""
        if self._rng.random() < faults.corrupt:
            place = self._rng.randrange(10, len(raw))
            return raw[:place] + bytes([raw[place] ^ 0x55]) + raw[place + 1:]
        if message is None:
            return raw
        kind = message.get_type()
        if kind == faults.mute:
            return b""
        if kind == "HEARTBEAT":
            extra = b""
            if faults.second_vehicle:
                extra = mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(self._second)
            if faults.says_armed:
                message.base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            if faults.says_plane:
                message.type = mavlink.MAV_TYPE_FIXED_WING
            return (message.pack(self._mav) if faults.says_armed or faults.says_plane else raw) + extra
        if kind == "AUTOPILOT_VERSION" and faults.says_version:
            message.flight_sw_version = int(faults.says_version)
            return message.pack(self._mav)
        if kind == "SYSTEM_TIME" and faults.clock_jump_s:
            self._times += 1
            if self._times > 12:
                message.time_boot_ms += round(faults.clock_jump_s * 1e3)
                return message.pack(self._mav)
        return raw
