"""What a check found, held to its limit: the same for the rig's checks and those of preflight."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

from bench.verdict import Check, Limit, Measurement, Verdict, check


class Found(Protocol):
    """One value for one limit; `blocked` says why it cannot be judged, "" where it can."""

    @property
    def limit(self) -> str: ...
    @property
    def value(self) -> float | None: ...
    @property
    def unit(self) -> str: ...
    @property
    def of(self) -> str: ...
    @property
    def samples(self) -> int: ...
    @property
    def blocked(self) -> str: ...


def judge_finding(finding: Found, limits: Mapping[str, Limit], origin: str) -> Check:
    """INCONCLUSIVE where the limits have none for it, or where it is blocked; else what the limit says."""
    title = f"{finding.limit} {finding.of}".strip()
    limit = limits.get(finding.limit)
    if limit is None:
        return Check(title, Verdict.INCONCLUSIVE, finding.value, finding.unit, "", "the limits file has none for it",
                     origin)
    if finding.blocked:
        return Check(title, Verdict.INCONCLUSIVE, None, finding.unit, limit.text, finding.blocked, origin,
                     reason=limit.reason, source=limit.source)
    return replace(check(Measurement(finding.value, finding.unit, origin, finding.samples), limit), name=title)
