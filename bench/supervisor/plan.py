"""What the supervisor is asked, and what it answers."""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from bench.supervisor.guard import Timing, Trip
from bench.supervisor.limits import Limits
from bench.thrust_stand.protocol import Origin
from saranga.errors import UsageError

SPIN_WORD = "SPIN"
CLEAR_WORD = "CLEAR"


@dataclass(frozen=True)
class SupervisorPlan:
    """Which devices, what limits, how fast.

    Args:
        throttle_url: what spins.
        stand_url: what measures; may be the same device; None: no stand, then no limit can be set but `throttle`.
        limits: of the run; each needs a stand that measures its quantity.
        token_timeout_s: longest silence of the control loop while the throttle is above idle.
        ramp_down_s: how long an emergency ramp takes, from whatever throttle.
        stale_s: oldest measurement of a limited quantity while spinning.
        deadline_s: the device idles this long after the last command, by itself; at most 0.15.
        log_folder: where `supervisor.jsonl` goes (the run folder).
        latch_folder: where trips stay latched between runs; None: the user's state folder, for emulated devices the
            log folder.
        accept_no_dead_man: spin a device that has no dead-man of its own.
    """

    throttle_url: str
    stand_url: str | None
    limits: Limits = field(default_factory=Limits)
    token_timeout_s: float = Timing.token_timeout_s
    ramp_down_s: float = Timing.ramp_down_s
    stale_s: float = Timing.stale_s
    deadline_s: float = Timing.deadline_s
    readback_s: float = Timing.readback_s
    confirm_s: float = Timing.confirm_s
    log_folder: Path | None = None
    latch_folder: Path | None = None
    accept_no_dead_man: bool = False

    def timing(self) -> Timing:
        """The guard's timing; raises UsageError for what is out of bounds."""
        return Timing(**{f.name: getattr(self, f.name) for f in fields(Timing)})

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "log_folder": _text(self.log_folder), "latch_folder": _text(self.latch_folder)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "SupervisorPlan":
        """The inverse of to_dict."""
        folders = {k: Path(data[k]) if data[k] is not None else None for k in ("log_folder", "latch_folder")}
        return cls(**{**data, **folders, "limits": Limits(**data["limits"])})


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path.resolve())


@dataclass(frozen=True)
class Confirmation:
    """That a person knows that something will spin. The supervisor itself checks it against the device's origin."""

    text: str = ""
    yes_spin: bool = False

    @classmethod
    def typed(cls, text: str) -> "Confirmation":
        """What was typed; only SPIN (CLEAR for clearing trips) counts."""
        return cls(text=text.strip())

    @classmethod
    def flag(cls, text: str = "") -> "Confirmation":
        """`--yes-spin`: enough for emulated devices; others need the typed word as well."""
        return cls(text=text.strip(), yes_spin=True)

    @classmethod
    def none(cls) -> "Confirmation":
        """Measure only: nothing may spin."""
        return cls()

    @classmethod
    def from_operator(cls, what: str, word: str = SPIN_WORD, ask: Callable[[str], str] | None = None) -> "Confirmation":
        """Show what is about to happen and let the operator type the word.

        Raises:
            UsageError: nobody is at the terminal, or something else was typed.
        """
        if ask is None:
            if not sys.stdin.isatty():
                raise UsageError(f"{what}: nobody is at a terminal to type {word}: nothing spins")
            ask = input
        print(what, file=sys.stderr)
        try:
            typed = ask(f"Type {word} to go on, anything else to leave: ").strip()
        except EOFError:
            typed = ""
        if typed != word:
            raise UsageError(f"{typed!r} was typed, not {word}: nothing spins")
        return cls(text=typed)

    def allows_spinning(self, origin: Origin) -> bool:
        """Whether this is enough for a device of that origin."""
        return self.text == SPIN_WORD or (self.yes_spin and origin == "emulated")


@dataclass(frozen=True)
class SupervisorStatus:
    """`state` is idle, ramp, hold, ramp-down, tripped or stopped. Throttles 0..1; `applied` as the device says."""

    state: str
    target: float = 0.0
    commanded: float = 0.0
    applied: float = math.nan
    trips: tuple[Trip, ...] = ()
    why: str = ""
    confirmed: bool = False
    tee_refused: int = 0
    """Frames from the rig's user that were not passed on to the device, THROTTLE above all."""
    tee_dropped_bytes: int = 0

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "SupervisorStatus":
        """The inverse of asdict."""
        return cls(**{**data, "trips": tuple(Trip(**t) for t in data["trips"])})


@dataclass(frozen=True)
class StopReport:
    """`confirmed`: the device itself said that it idles, `seconds` after it was told to (NaN: it did not)."""

    confirmed: bool
    seconds: float
    text: str
    trips: tuple[Trip, ...] = ()
