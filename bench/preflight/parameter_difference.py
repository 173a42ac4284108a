"""A vehicle's parameters against the wanted set, in the names of the firmware that answers."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from bench.preflight.evidence import VehicleEvidence
from sitl.autopilot.parameters import Parameter, load_parameters

PARAMETER_SETS = ("arducopter-gps-denied", "preflight")
"""What flights were made with, and what only a vehicle that somebody stands beside needs."""
SIMULATOR_ONLY = ("SIM_",)
# What a simulator needs to be fast and repeatable, and a flight controller decides for itself.
BENCH_ONLY = ("SIM_RATE_HZ", "SCHED_LOOP_RATE", "INS_GYRO_RATE", "LOG_DISARMED", "LOG_FILE_DSRMROT")
TOLERANCE = 1e-4


@dataclass(frozen=True)
class Difference:
    """One parameter that reads otherwise than wanted."""

    name: str
    found: float
    wanted: float
    why: str

    def __str__(self) -> str:
        return f"{self.name} {self.found:g}, wanted {self.wanted:g}"


@dataclass
class Comparison:
    """What was compared, what differs, and what the firmware does not have."""

    compared: int = 0
    different: list[Difference] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)


def wanted_parameters(names: Sequence[str] = PARAMETER_SETS) -> list[Parameter]:
    """The sets of `names` in fixtures/parameters (or paths) as one; a later one wins.

    Raises:
        UsageError: unknown or malformed.
    """
    merged = {p.name: p for name in names for p in load_parameters(name)}
    return list(merged.values())


def difference(vehicle: VehicleEvidence, wanted: Sequence[Parameter]) -> Comparison:
    """Compare.

    The simulator's own settings count on a simulator only. The embedded autopilot has few parameters: those it
    has are compared, by its own list. A vehicle of unknown version is held to the newest names.
    """
    version = vehicle.major_minor if vehicle.version is not None and not vehicle.embedded else (4, 7)
    simulated = vehicle.origin != "measured"
    out = Comparison()
    for parameter in wanted:
        name, value = parameter.spelling(version)
        if not simulated and (parameter.name.startswith(SIMULATOR_ONLY) or parameter.name in BENCH_ONLY):
            continue
        found = vehicle.parameters.get(name)
        if found is None:
            if not vehicle.embedded:
                out.absent.append(name)
            continue
        out.compared += 1
        if not abs(found - value) <= TOLERANCE * max(1.0, abs(value)):
            out.different.append(Difference(name, found, value, parameter.why))
    return out
