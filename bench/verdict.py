"""Verdicts, and limits that say why they are where they are.

A verdict fails closed: what is missing, not finite, too few, in another unit, or simulated where a
measurement was asked for never passes. Verdicts combine by "worst wins" in the order ERROR, FAIL, INCONCLUSIVE,
MARGINAL, PASS: an error means that the evidence itself is not to be trusted, so no other result may hide it; a
failure is a finding, so missing evidence elsewhere does not soften it; nothing at all is INCONCLUSIVE.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from bench.statistics import CONFIDENCE, trials_needed, wilson_interval
from saranga.errors import UsageError
from saranga.fixtures import fixture_names, fixture_path, load_toml

MEASURED = "measured"
SIMULATED = "simulated"
RATE_METRICS = ("success_rate", "success_rate_strict")


class Verdict(StrEnum):
    """The five answers; scripts see them through the exit code."""

    PASS = "PASS"
    MARGINAL = "MARGINAL"
    FAIL = "FAIL"
    INCONCLUSIVE = "INCONCLUSIVE"
    ERROR = "ERROR"

    @property
    def exit_code(self) -> int:
        """0 PASS or MARGINAL, 1 FAIL, 3 INCONCLUSIVE, 4 ERROR."""
        return {"PASS": 0, "MARGINAL": 0, "FAIL": 1, "INCONCLUSIVE": 3, "ERROR": 4}[self.value]

    @property
    def accepted(self) -> bool:
        """True for PASS and MARGINAL only."""
        return self.exit_code == 0


_SEVERITY = (Verdict.PASS, Verdict.MARGINAL, Verdict.INCONCLUSIVE, Verdict.FAIL, Verdict.ERROR)


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """The worst of them; INCONCLUSIVE when there is none."""
    return max(verdicts, key=_SEVERITY.index, default=Verdict.INCONCLUSIVE)


@dataclass(frozen=True)
class Limit:
    """What a value is held to.

    `lo` and `hi` are the limits themselves (inclusive); a value inside them but below `marginal_lo` or above
    `marginal_hi` is MARGINAL. `requires` is the origin a value must have ("measured" or "any").

    Raises:
        UsageError: no bound at all, bounds that are not finite or out of order, or no reason or source.
    """

    name: str
    unit: str
    lo: float | None = None
    hi: float | None = None
    marginal_lo: float | None = None
    marginal_hi: float | None = None
    reason: str = ""
    source: str = ""
    requires: str = "any"
    min_samples: int = 1
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        def refuse(why: str) -> None:
            raise UsageError(f"limit {self.name!r}: {why}")

        bounds = [b for b in (self.lo, self.marginal_lo, self.marginal_hi, self.hi) if b is not None]
        if self.lo is None and self.hi is None:
            refuse("has neither at_least nor at_most, so it limits nothing: give one")
        if not all(math.isfinite(b) for b in bounds):
            refuse("its bounds must be finite numbers")
        if bounds != sorted(bounds):
            refuse(f"bounds {bounds} are out of order: at_least <= marginal_below <= marginal_above <= at_most")
        if not self.reason.strip() or not self.source.strip():
            refuse("needs a reason and a source, so that the next reader knows why it is where it is")
        if self.requires not in ("any", MEASURED):
            refuse(f"requires = {self.requires!r}: must be 'any' or 'measured'")
        if self.min_samples < 1:
            refuse(f"min_samples = {self.min_samples}: must be at least 1")
        if not 0 < self.confidence < 1:
            refuse(f"confidence = {self.confidence}: must lie between 0 and 1")
        if self.is_rate and (self.lo is None or not 0 < self.lo < 1 or self.hi is not None):
            refuse("a rate needs at_least between 0 and 1, and no at_most")

    @property
    def is_rate(self) -> bool:
        """True for a success rate, which is judged by its interval and not by its value."""
        return self.name in RATE_METRICS

    @property
    def text(self) -> str:
        """The limit as a person reads it, such as ">= 0.6"."""
        parts = [
            f">= {self.lo:g}" if self.lo is not None else "",
            f"<= {self.hi:g}" if self.hi is not None else "",
        ]
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        return " and ".join(p for p in parts if p) + unit


@dataclass(frozen=True)
class Measurement:
    """A value, its unit, its origin ("measured" or "simulated"), and how many samples it rests on."""

    value: float | None
    unit: str
    origin: str = SIMULATED
    samples: int = 1


@dataclass(frozen=True)
class Check:
    """One value against one limit; `why` says in one line how the verdict came about."""

    name: str
    verdict: Verdict
    value: float | None
    unit: str
    limit: str
    why: str
    origin: str = SIMULATED
    interval: tuple[float, float] | None = None
    trials_needed: int | None = None
    reason: str = ""
    source: str = ""

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        value = self.value if self.value is not None and math.isfinite(self.value) else None
        return {
            "name": self.name,
            "verdict": self.verdict.value,
            "value": value,
            "unit": self.unit,
            "limit": self.limit,
            "why": self.why,
            "origin": self.origin,
            "interval": list(self.interval) if self.interval else None,
            "trials_needed": self.trials_needed,
            "reason": self.reason,
            "source": self.source,
        }


def check(measurement: Measurement | None, limit: Limit) -> Check:
    """Hold one value to one limit. Rates belong to `check_rate`: a rate without its counts never passes."""
    m = measurement or Measurement(None, limit.unit, samples=0)

    def answer(verdict: Verdict, why: str) -> Check:
        return Check(
            limit.name,
            verdict,
            m.value,
            limit.unit,
            limit.text,
            why,
            m.origin,
            None,
            None,
            limit.reason,
            limit.source,
        )

    if m.value is None or isinstance(m.value, bool) or not math.isfinite(m.value):
        return answer(Verdict.ERROR, "no value was obtained" if m.value is None else f"{m.value} is not a number")
    if m.unit != limit.unit:
        return answer(Verdict.ERROR, f"value is in {m.unit or 'no unit'}, the limit in {limit.unit or 'no unit'}")
    if limit.is_rate:
        return answer(Verdict.INCONCLUSIVE, "a rate is judged from its counts, and only the rate is known")
    if limit.requires == MEASURED and m.origin != MEASURED:
        return answer(Verdict.INCONCLUSIVE, f"the value is {m.origin}, and this limit asks for a measured one")
    if m.samples < limit.min_samples:
        return answer(Verdict.INCONCLUSIVE, f"rests on {m.samples} samples, and {limit.min_samples} are needed")
    if (limit.lo is not None and m.value < limit.lo) or (limit.hi is not None and m.value > limit.hi):
        return answer(Verdict.FAIL, f"{m.value:.4g} is outside {limit.text}")
    if limit.marginal_lo is not None and m.value < limit.marginal_lo:
        return answer(Verdict.MARGINAL, f"{m.value:.4g} is within {limit.text} but below {limit.marginal_lo:g}")
    if limit.marginal_hi is not None and m.value > limit.marginal_hi:
        return answer(Verdict.MARGINAL, f"{m.value:.4g} is within {limit.text} but above {limit.marginal_hi:g}")
    return answer(Verdict.PASS, f"{m.value:.4g} is within {limit.text}")


def check_rate(successes: int, trials: int, limit: Limit, origin: str = SIMULATED) -> Check:
    """Non-inferiority: is the rate not below the limit?

    PASS when the lower bound of Wilson's interval reaches the limit, FAIL when its upper bound is below, else
    INCONCLUSIVE with the number of further trials that would decide if the rate stays as it is. A pass whose
    observed rate is below `marginal_lo` is MARGINAL.
    """
    assert limit.lo is not None
    low, high = wilson_interval(successes, trials, limit.confidence)
    more = trials_needed(successes, trials, limit.lo, limit.confidence)
    rate = successes / trials if trials else None
    seen = f"{successes} of {trials}, {limit.confidence:.0%} interval {low:.3f} to {high:.3f}"
    if trials < limit.min_samples:
        more = max(more or 0, limit.min_samples - trials)
        verdict, why = Verdict.INCONCLUSIVE, f"{seen}: {limit.min_samples} trials are the least"
    elif limit.requires == MEASURED and origin != MEASURED:
        verdict, why = Verdict.INCONCLUSIVE, f"{seen}, but {origin}, and this limit asks for measured trials"
    elif high < limit.lo:
        verdict, why = Verdict.FAIL, f"{seen}: below {limit.lo:g}"
    elif low < limit.lo:
        how_many = f"about {more} more" if more is not None else "more trials than is practical"
        verdict, why = Verdict.INCONCLUSIVE, f"{seen}: contains {limit.lo:g}; {how_many} would decide"
    elif limit.marginal_lo is not None and rate is not None and rate < limit.marginal_lo:
        verdict, why = Verdict.MARGINAL, f"{seen}: not below {limit.lo:g}, yet below {limit.marginal_lo:g}"
    else:
        verdict, why = Verdict.PASS, f"{seen}: not below {limit.lo:g}"
    return Check(
        limit.name,
        verdict,
        rate,
        limit.unit,
        limit.text,
        why,
        origin,
        (low, high),
        more,
        limit.reason,
        limit.source,
    )


_KEYS = {
    "unit": "unit",
    "at_least": "lo",
    "at_most": "hi",
    "marginal_below": "marginal_lo",
    "marginal_above": "marginal_hi",
    "reason": "reason",
    "source": "source",
    "requires": "requires",
    "min_samples": "min_samples",
    "confidence": "confidence",
}


def load_limits(name_or_path: str, known_metrics: Sequence[str] | None = None) -> list[Limit]:
    """Limits of a file in fixtures/limits (by name) or of the user's own file.

    Raises:
        UsageError: unknown file, malformed TOML, an unknown key or metric, a wrong type, or no limit in it.
    """
    path = fixture_path("limits", name_or_path)
    tables = load_toml(path).get("limits")
    if not isinstance(tables, dict) or not tables:
        raise UsageError(f"{path}: has no [limits.NAME] table: a file of limits without limits would pass anything")
    return [_limit(path, name, table, known_metrics) for name, table in tables.items()]


def find_limits(scene: str) -> str | None:
    """Name of the limits that ship for a scene, or None. The user's own scene file has none."""
    return scene if scene in fixture_names("limits") else None


def _limit(path: Path, name: str, table: Any, known_metrics: Sequence[str] | None) -> Limit:
    if not isinstance(table, dict):
        raise UsageError(f"{path}: limits.{name} must be a table")
    if known_metrics is not None and name not in known_metrics:
        raise UsageError(f"{path}: unknown metric {name!r}: known are {', '.join(known_metrics)}")
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in _KEYS:
            raise UsageError(f"{path}: limits.{name} has no key {key!r}: known are {', '.join(_KEYS)}")
        wants_text = key in ("unit", "reason", "source", "requires")
        wants: tuple[type, ...] = (str,) if wants_text else (int,) if key == "min_samples" else (int, float)
        if not isinstance(value, wants) or isinstance(value, bool):
            raise UsageError(f"{path}: limits.{name}.{key} = {value!r} must be a {wants[-1].__name__}")
        values[_KEYS[key]] = value
    if "unit" not in values:
        raise UsageError(f'{path}: limits.{name} needs a unit ("1" for a plain number)')
    try:
        return Limit(name, **values)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
