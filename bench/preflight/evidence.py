"""What a preflight rests on: what vehicle, rig and this computer said, each with the time when it was heard."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.rig.evidence import Evidence as RigEvidence
from sitl.autopilot.parameters import Parameter

MEASURED, SIMULATED, EMULATED = "measured", "simulated", "emulated"
EMBEDDED = "EMBEDDED"


class Heard(NamedTuple):
    """One message: host time (monotonic, s) and its fields."""

    t_s: float
    fields: dict[str, Any]


@dataclass(frozen=True)
class Finding:
    """One value for one limit.

    Attributes:
        limit: name in the limits file.
        value: None where none could be obtained.
        action: what to do if the limit is not kept.
        of: the part it belongs to, "" where there is only one.
        samples: how many messages or measurements it rests on.
        heard_s: host time of the newest evidence in it, None where there is none.
        blocked: why it cannot be judged: it is then INCONCLUSIVE.
        seen: what was found, in words.
        bypassed: who switched off what this check looks at; said in capitals.
    """

    limit: str
    value: float | None
    unit: str
    action: str
    of: str = ""
    samples: int = 1
    heard_s: float | None = None
    blocked: str = ""
    seen: str = ""
    bypassed: str = ""


@dataclass
class VehicleEvidence:
    """What a vehicle said.

    Attributes:
        messages: by name, in order; those of the connection and of the watch alike.
        watch_s: host times at which the watch at raised rates began and ended.
        parameters: as read. parameter_count: how many it says it has. parameters_s: host time of the last.
        texts: (host time, severity, text).
        prearm_asked_s: host time of asking; prearm_result: MAV_RESULT of the answer.
        round_trips_ms: of TIMESYNC, in order; round_trips_asked: how many were sent.
        intervals_us: what message rates were before, by message id; put back afterwards.
        stopped: why gathering ended early ("" where it did not).
    """

    url: str
    system: int = 1
    messages: dict[str, list[Heard]] = field(default_factory=dict)
    watch_s: tuple[float, float] = (math.nan, math.nan)
    parameters: dict[str, float] = field(default_factory=dict)
    parameter_count: int | None = None
    parameters_s: float | None = None
    texts: list[tuple[float, int, str]] = field(default_factory=list)
    prearm_asked_s: float | None = None
    prearm_result: int | None = None
    round_trips_ms: list[float] = field(default_factory=list)
    round_trips_asked: int = 0
    round_trips_s: float | None = None
    intervals_us: dict[int, float] = field(default_factory=dict)
    bad_messages: int = 0
    good_messages: int = 0
    other_vehicles: tuple[int, ...] = ()
    stopped: str = ""

    # ---- messages --------------------------------------------------------------------------------
    def all(self, name: str) -> list[Heard]:
        """Every message of a name."""
        return self.messages.get(name, [])

    def watched(self, name: str) -> list[Heard]:
        """Those heard during the watch."""
        began, ended = self.watch_s
        return [heard for heard in self.all(name) if began <= heard.t_s <= ended]

    def last(self, name: str) -> Heard | None:
        """The newest one."""
        heard = self.all(name)
        return heard[-1] if heard else None

    def values(self, name: str, key: str) -> list[float]:
        """One field of the watched messages."""
        return [float(heard.fields[key]) for heard in self.watched(name)]

    def heard_s(self, name: str) -> float | None:
        """Host time of the newest message of a name."""
        heard = self.last(name)
        return None if heard is None else heard.t_s

    # ---- what it is ------------------------------------------------------------------------------
    @property
    def version(self) -> int | None:
        """AUTOPILOT_VERSION's packed firmware version."""
        heard = self.last("AUTOPILOT_VERSION")
        return None if heard is None else int(heard.fields["flight_sw_version"])

    @property
    def major_minor(self) -> tuple[int, int]:
        """(0, 0) where it is unknown."""
        packed = self.version or 0
        return packed >> 24 & 0xFF, packed >> 16 & 0xFF

    @property
    def firmware_hash(self) -> str:
        """Custom version: the first eight characters of the firmware's commit."""
        heard = self.last("AUTOPILOT_VERSION")
        codes = [] if heard is None else heard.fields["flight_custom_version"]
        return bytes(codes).rstrip(b"\0").decode("ascii", "replace")

    @property
    def embedded(self) -> bool:
        """Whether it is the project's own embedded autopilot."""
        return self.firmware_hash == EMBEDDED

    @property
    def origin(self) -> str:
        """"emulated" for the embedded autopilot, "simulated" for a SITL build, else "measured"."""
        if self.embedded:
            return EMULATED
        return SIMULATED if any(name.startswith("SIM_") for name in self.parameters) else MEASURED

    @property
    def armed(self) -> bool:
        """Whether its newest heartbeat says so."""
        heard = self.last("HEARTBEAT")
        return heard is not None and bool(int(heard.fields["base_mode"]) & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def boot_seconds(self) -> float | None:
        """How far the vehicle's own clock went during the watch; None with fewer than two SYSTEM_TIME."""
        times = self.values("SYSTEM_TIME", "time_boot_ms")
        return None if len(times) < 2 else (times[-1] - times[0]) * 1e-3

    def parameter(self, *names: str) -> float | None:
        """Value under the first of these names that it has (spellings of different versions)."""
        return next((self.parameters[name] for name in names if name in self.parameters), None)


@dataclass
class RigSide:
    """What the rig said; `heard_s` is the host's time of the end."""

    url: str
    evidence: RigEvidence
    origin: str
    heard_s: float


@dataclass
class StackSide:
    """What the stack did on this computer.

    Attributes:
        step_ms: time of each step, in order. tick_ms: the time there is for one.
        weights_expected, weights_found: SHA-256 of each file, by precision; found is "" where it cannot be read.
        runs_on: the precision that the denoiser runs on, None for one without weights.
    """

    denoiser: str
    policy: str
    step_ms: list[float]
    tick_ms: float
    weights_expected: dict[str, str]
    weights_found: dict[str, str]
    runs_on: str | None
    cpu: str
    free_bytes: int
    utc_year: int
    heard_s: float
    failed: str = ""


@dataclass
class Evidence:
    """Everything. A part that is None was not there: why is in `absent`, by "vehicle", "rig" or "stack"."""

    vehicle: VehicleEvidence | None = None
    rig: RigSide | None = None
    stack: StackSide | None = None
    mavsdk: dict[str, Any] | None = None
    absent: dict[str, str] = field(default_factory=dict)
    wanted: Sequence[Parameter] = ()
    now_s: float = 0.0

    def why_not(self, part: str) -> str:
        """Why a part is absent."""
        return self.absent.get(part, f"nothing was heard of the {part}")


Examine = Callable[[VehicleEvidence], list[Finding]]


def vehicle_check(limits: Sequence[tuple[str, str]], action: str,
                  examine: Examine) -> Callable[[Evidence], list[Finding]]:
    """A check that needs a vehicle heard to the end; without it each of `limits` (name, unit) stays open.

    A check that cannot be made must not be absent from the list, and must not pass.
    """
    def examine_all(evidence: Evidence) -> list[Finding]:
        vehicle = evidence.vehicle
        if vehicle is None or vehicle.stopped:
            why = evidence.why_not("vehicle") if vehicle is None else vehicle.stopped
            return [Finding(name, None, unit, action, blocked=why) for name, unit in limits]
        return examine(vehicle)

    return examine_all


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which `share` of them lie; nan of none."""
    if not values:
        return math.nan
    ordered = sorted(values)
    return ordered[min(round(share * (len(ordered) - 1)), len(ordered) - 1)]
