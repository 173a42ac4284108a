"""What a flight with a fault did, in one word, and whether that is acceptable.

- `flew_on`: clean to the goal and landed.
- `stopped`: touched nothing and came to no goal (stuck or timeout).
- `held`: the stack named a fault (echoes silent, a sensor silent, a command that is not finite) and held still.
- `failsafe`: the autopilot took over, said why, and landed upright without touching anything.
- `touched`: an obstacle or a net, in the course or while a failsafe brought it down.
- `lost`: came down, or ended, in any other way.
- `broken`: the flight says nothing: the fault never came, the simulator or the harness failed.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field, model_validator

from bench.statistics import trials_needed, wilson_interval
from bench.verdict import Verdict, worst
from sitl.validation import Table

Behaviour = Literal["flew_on", "stopped", "held", "failsafe", "touched", "lost"]
UPRIGHT, HIT = "; landed after", "; then "
LEFT = "autopilot left guided flight"
STILL_M_S = 0.5
"""A vehicle that holds is slower than this when the flight ends, a second after the stack saw the fault."""


class Acceptable(Table):
    """[row.acceptable]: what flights with this fault may do.

    `may`: behaviours that are fine in every flight. `touched_at_most`: how often it may touch something besides; the
    interval of the rate must lie below. `says`: words that the cause of every `held` and `failsafe` flight must hold,
    so that it ended for the right reason. `reason`: why that is acceptable.
    """

    may: list[Behaviour] = Field(min_length=1)
    touched_at_most: float | None = Field(default=None, gt=0.0, lt=1.0)
    says: str = ""
    reason: str = Field(min_length=10)

    @model_validator(mode="after")
    def _one_rule(self) -> "Acceptable":
        if self.touched_at_most is not None and "touched" in self.may:
            raise ValueError("touched_at_most says nothing where may has \"touched\": leave one of them out")
        return self


@dataclass(frozen=True)
class Judged:
    """`did`: how often each behaviour was seen; `touched`: interval of its rate."""

    verdict: Verdict
    reason: str
    did: dict[str, int]
    touched: tuple[float, float]
    trials_needed: int | None


def behaviour_of(result: Mapping[str, Any]) -> str:
    """One of the words of the module."""
    outcome, cause = result.get("outcome"), str(result.get("cause") or "")
    if outcome == "clean":
        return "flew_on" if result.get("success_strict") is True else "lost"
    if outcome in ("obstacle_hit", "net_hit"):
        return "touched"
    if outcome in ("stuck", "timeout"):
        return "stopped"
    if outcome == "infrastructure" and cause.startswith("stack: "):
        speed = (result.get("measures") or {}).get("end_speed_m_s")
        return "held" if isinstance(speed, float | int) and speed <= STILL_M_S else "lost"
    if outcome == "estimator_failure" and cause.startswith(LEFT):
        if UPRIGHT in cause:
            return "failsafe"
        return "touched" if HIT in cause and " hit " in cause else "lost"
    return "lost" if outcome == "estimator_failure" else "broken"


def judge_row(acceptable: Acceptable, results: Sequence[Mapping[str, Any]], planned: int) -> Judged:
    """Hold all flights of a row to what is acceptable; anything not known to be is not."""
    did = Counter(behaviour_of(r) for r in results)
    n, touched = len(results), did["touched"]
    low, high = wilson_interval(touched, n)
    seen = ", ".join(f"{count} {word.replace('_', ' ')}" for word, count in did.most_common()) or "nothing flown"
    parts, why = [Verdict.PASS], []
    needed: int | None = None
    if did["broken"]:
        parts.append(Verdict.ERROR)
        why.append("what broke off proves nothing: " + next(str(r.get("cause")) for r in results
                                                            if behaviour_of(r) == "broken"))
    if n < planned:
        parts.append(Verdict.INCONCLUSIVE)
        why.append(f"{n} of {planned} flown")
        needed = planned - n
    limit = acceptable.touched_at_most
    wrong = [word for word in did if word not in acceptable.may and word != "broken"
             and not (word == "touched" and limit is not None)]
    if wrong:
        parts.append(Verdict.FAIL)
        first = next(r for r in results if behaviour_of(r) in wrong)
        why.append(f"not acceptable: {', '.join(wrong)}, such as seed {first.get('seed')}: {first.get('cause')}")
    unsaid = [r for r in results if behaviour_of(r) in ("held", "failsafe")
              and acceptable.says.lower() not in str(r.get("cause")).lower()]
    if unsaid:
        parts.append(Verdict.FAIL)
        why.append(f"ended for another reason than {acceptable.says!r}: seed {unsaid[0].get('seed')}: "
                   f"{unsaid[0].get('cause')}")
    if limit is not None and n:
        rate = (f"touched {100 * touched / n:.0f} % (95 % {100 * low:.0f} to {100 * high:.0f}), "
                f"{100 * limit:.0f} % allowed")
        if low > limit:
            parts.append(Verdict.FAIL)
        elif high > limit:
            parts.append(Verdict.INCONCLUSIVE)
            more = trials_needed(n - touched, n, 1.0 - limit)
            needed = max(needed or 0, more or 0) or None
            rate += f"; about {more} more flights would decide" if more else "; no practical number would decide"
        why.append(rate)
    verdict = worst(parts) if n else Verdict.INCONCLUSIVE
    return Judged(verdict, "; ".join([seen, *why]), dict(did), (low, high), needed)
