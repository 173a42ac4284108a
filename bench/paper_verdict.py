"""Is our rate as good as the one the paper printed? Non-inferiority, by a sequential test and by an interval.

The paper flew about twenty trials a row, so its own rate is only known to +-18 points; equality cannot be asked for.
Asked is: not worse than the paper's rate by more than MARGIN. Two ways to decide, and both look at the same trials:

- SPRT of p1 = the paper's rate against p0 = p1 - MARGIN, alpha = beta = 0.05. It decides as early as the trials allow.
- Wilson's 95 % interval: PASS when all of it lies at or over p0, FAIL when all of it lies below.

Where the SPRT has not decided the interval may. Where neither has, the row is INCONCLUSIVE and says how many more
trials are expected to decide. A paper rate of 1 is taken as P1_MOST, since no test can hold anything to "never fails".
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bench.statistics import Sprt, sprt, trials_needed, wilson_interval
from bench.verdict import Verdict

MARGIN = 0.15
"""0.85 against 0.70 is what 40 trials can tell apart (acceptance sampling at 5 % errors)."""
P1_MOST = 0.95
LEAST_TRIALS = 5


@dataclass(frozen=True)
class PaperVerdict:
    """`reason` is one line for people; `trials_needed` None when decided or when no practical number would do."""

    verdict: Verdict
    reason: str
    trials_needed: int | None
    sprt: dict[str, Any]


def paper_verdict(outcomes: Sequence[bool], paper_successes: int, paper_trials: int) -> PaperVerdict:
    """Hold outcomes, in the order of their seeds, to the paper's rate.

    Raises:
        ValueError: counts of the paper that cannot be.
    """
    low, high = wilson_interval(paper_successes, paper_trials)
    p1 = min(paper_successes / paper_trials, P1_MOST)
    p0 = p1 - MARGIN
    test = sprt(list(outcomes), p0, p1)
    n, k = len(outcomes), sum(outcomes)
    ours = wilson_interval(k, n)
    seen = (f"{k} of {n} (95 % {ours[0]:.2f} to {ours[1]:.2f}), paper {paper_successes} of {paper_trials} "
            f"({low:.2f} to {high:.2f})")
    if n < LEAST_TRIALS:
        return PaperVerdict(Verdict.INCONCLUSIVE, f"{seen}: {LEAST_TRIALS} trials are the least", LEAST_TRIALS - n,
                            asdict(test))
    if test.decision == "accept" or (test.decision == "continue" and ours[0] >= p0):
        return PaperVerdict(Verdict.PASS, f"{seen}: not below {p0:.2f}{_by(test)}", None, asdict(test))
    if test.decision == "reject" or ours[1] < p0:
        return PaperVerdict(Verdict.FAIL, f"{seen}: below {p1:.2f}{_by(test)}", None, asdict(test))
    more = [m for m in (test.expected_more, trials_needed(k, n, p0)) if m]
    needed = min(more, default=None)
    how_many = f"about {needed} more trials would decide" if needed else "no practical number of trials would decide"
    return PaperVerdict(Verdict.INCONCLUSIVE, f"{seen}: neither {p1:.2f} nor {p0:.2f} is ruled out; {how_many}", needed,
                        asdict(test))


def _by(test: Sprt) -> str:
    return f" (SPRT at trial {test.at_trial})" if test.at_trial is not None else " (interval)"
