"""One verdict over success and all measures, at one confidence for the whole of them (Bonferroni).

FAIL: a measure is worse, surely and by more than its margin. MARGINAL: surely, but by less. PASS: no regression shown;
each measure says the least worsening that it would have shown. INCONCLUSIVE: too few pairs to show anything; a measure
that is worse at this confidence by itself, though not after the correction; or one that the baseline has and the run
lacks. ERROR: flights of the run broke off.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.baseline.flights import Flights, Pairs, Result, pair, unpaired
from bench.baseline.measures import MEASURES, TESTS, Measure, value_of
from bench.baseline.rank_tests import Shift, independent_shift, least_pairs, paired_shift
from bench.baseline.success_test import Drop, independent_drop, paired_drop
from bench.verdict import SIMULATED, Verdict, worst
from saranga.errors import UsageError

CONFIDENCE = 0.99
"""One false alarm in a hundred comparisons at most: a CI that cries wolf is switched off."""

SUSPECT = f"worse by itself, not surely among {TESTS} tests; fly more"


@dataclass(frozen=True)
class Finding:
    """One measure: `worse_by` with bounds (positive = worse, in `unit`), p, and `would_see`, the least worsening that
    would have been shown. `verdict` None: not compared, and nothing is missing (`why` says what)."""

    name: str
    unit: str
    verdict: Verdict | None
    why: str
    n: int = 0
    baseline: float = math.nan
    run: float = math.nan
    worse_by: float = math.nan
    low: float = math.nan
    high: float = math.nan
    p: float = math.nan
    would_see: float = math.nan
    margin: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready: what is not finite is None."""
        found = {key: None if isinstance(value, float) and not math.isfinite(value) else value
                 for key, value in asdict(self).items()}
        return found | {"verdict": self.verdict.value if self.verdict else None, "origin": SIMULATED}


@dataclass(frozen=True)
class Comparison:
    """The verdict, its reason in one line, and every finding; `identical`: pairs that are the same bit for bit."""

    verdict: Verdict
    reason: str
    findings: tuple[Finding, ...]
    pairs: int
    paired: bool
    identical: int
    confidence: float
    run: str
    baseline: str
    notes: tuple[str, ...]
    broken: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self) | {"verdict": self.verdict.value, "findings": [f.to_dict() for f in self.findings],
                               "notes": list(self.notes), "broken": list(self.broken), "tests": TESTS,
                               "correction": "Bonferroni"}


def compare_runs(run: Flights, baseline: Flights, paired: bool = True, confidence: float = CONFIDENCE) -> Comparison:
    """Compare two runs.

    Raises:
        UsageError: runs that cannot be compared (`bench.baseline.flights`), or a confidence outside (0.5, 1).
    """
    if not 0.5 < confidence < 1.0:
        raise UsageError(f"--confidence {confidence:g}: must lie between 0.5 and 1, such as {CONFIDENCE:g}")
    if paired:
        pairs = pair(run, baseline)
    else:
        ours, theirs, broken, notes = unpaired(run, baseline)
        pairs = Pairs((), tuple(ours), tuple(theirs), broken, notes)
    return compare(pairs, paired, confidence, str(run.folder), str(baseline.folder))


def compare(pairs: Pairs, paired: bool = True, confidence: float = CONFIDENCE, run: str = "", baseline: str = ""
            ) -> Comparison:
    """See the module."""
    alpha = (1.0 - confidence) / TESTS
    n, least = min(len(pairs.run), len(pairs.baseline)), least_pairs(alpha)
    identical = 0
    if paired:
        identical = sum(a.get("determinism_hash") == b.get("determinism_hash") and bool(a.get("determinism_hash"))
                        for a, b in zip(pairs.run, pairs.baseline, strict=True))
    what = "pairs" if paired else "flights in each run"
    findings: tuple[Finding, ...] = ()
    if n < least:
        verdict = Verdict.INCONCLUSIVE
        reason = (f"{n} {what}: at {confidence:g} confidence over {TESTS} tests nothing could be shown with fewer than "
                  f"{least}; fly {least - n} more")
    else:
        findings = (_success(pairs, paired, alpha),
                    *(_measure(m, pairs.run, pairs.baseline, paired, alpha, least) for m in MEASURES))
        verdict = worst(f.verdict for f in findings if f.verdict is not None)
        reason = _reason(verdict, findings, n, what, identical)
    if pairs.broken:
        verdict = Verdict.ERROR
        reason = f"{len(pairs.broken)} flights broke off, so the evidence is not whole: {pairs.broken[0]}"
    return Comparison(verdict, reason, findings, n, paired, identical, confidence, run, baseline, pairs.notes,
                      pairs.broken)


def _reason(verdict: Verdict, findings: Sequence[Finding], n: int, what: str, identical: int) -> str:
    if verdict is Verdict.PASS:
        same = f", {identical} of them bit for bit the same" if identical else ""
        success = findings[0]
        least = f"{100 * success.would_see:.0f} points" if math.isfinite(success.would_see) else "nothing"
        return f"no regression shown over {n} {what}{same}; a drop of the success rate by {least} would have been"
    return "; ".join(f"{f.name}: {f.why}" for f in findings if f.verdict is verdict)


def _alone(alpha: float) -> float:
    """The level of one test by itself."""
    return alpha * TESTS


def _success(pairs: Pairs, paired: bool, alpha: float) -> Finding:
    run, baseline = ([r.get("success_strict") is True for r in side] for side in (pairs.run, pairs.baseline))
    drop: Drop = (paired_drop if paired else independent_drop)(run, baseline, alpha)
    seen = f"{drop.baseline} of {len(baseline)} clean before, {drop.run} of {len(run)} now"
    if drop.p < alpha:
        verdict, why = Verdict.FAIL, f"{seen} (p = {drop.p:.2g})"
    elif drop.p < _alone(alpha):
        verdict, why = Verdict.INCONCLUSIVE, f"{seen} (p = {drop.p:.2g}): {SUSPECT}"
    elif drop.seen_from is None:
        verdict, why = Verdict.INCONCLUSIVE, f"{seen}: no drop would have been significant; fly more"
    else:
        verdict, why = Verdict.PASS, f"{seen}; a drop by {100 * drop.seen_from:.0f} points would have been shown"
    return Finding("success", "1", verdict, why, drop.n, drop.baseline / len(baseline), drop.run / len(run), drop.value,
                   drop.low, drop.high, drop.p, math.nan if drop.seen_from is None else drop.seen_from)


def _measure(measure: Measure, run: Sequence[Result], baseline: Sequence[Result], paired: bool, alpha: float,
             least: int) -> Finding:
    x, y = _values(measure, run), _values(measure, baseline)
    if paired:
        if measure.clean_only:
            both = [r.get("success_strict") is True and b.get("success_strict") is True
                    for r, b in zip(run, baseline, strict=True)]
            x, y = (np.where(both, side, math.nan) for side in (x, y))
        kept = np.isfinite(x) & np.isfinite(y)
        had, now = int(np.isfinite(y).sum()), int(kept.sum())
        x, y = x[kept], y[kept]
    else:
        had, now = int(np.isfinite(y).sum()), int(np.isfinite(x).sum())
        x, y = x[np.isfinite(x)], y[np.isfinite(y)]
    n = min(len(x), len(y))
    if n < least:
        missing = had >= least and not measure.clean_only
        why = f"{now} flights have it now, {had} before, and {least} are the least"
        return Finding(measure.name, measure.unit, Verdict.INCONCLUSIVE if missing else None, why, n)
    s, t = measure.sign * x, measure.sign * y
    shift: Shift = paired_shift(s - t, alpha) if paired else independent_shift(s, t, alpha)
    would_see = max(-shift.low, measure.margin) if math.isfinite(shift.low) else math.nan
    text = f"worse by {shift.estimate:.3g} {measure.unit}"
    if shift.p < alpha and shift.estimate >= measure.margin:
        verdict, why = Verdict.FAIL, f"{text} (p = {shift.p:.2g})"
    elif shift.p < alpha:
        verdict = Verdict.MARGINAL
        why = f"{text} (p = {shift.p:.2g}), less than the {measure.margin:g} {measure.unit} that matter"
    elif shift.p < _alone(alpha) and shift.estimate >= measure.margin:
        verdict, why = Verdict.INCONCLUSIVE, f"{text} (p = {shift.p:.2g}): {SUSPECT}"
    else:
        verdict, why = Verdict.PASS, f"{text} (p = {shift.p:.2g}); {would_see:.3g} {measure.unit} would have been shown"
    return Finding(measure.name, measure.unit, verdict, why, n, float(np.mean(y)), float(np.mean(x)), shift.estimate,
                   shift.low, shift.high, shift.p, would_see, measure.margin)


def _values(measure: Measure, results: Sequence[Result]) -> Any:
    values = [value_of(measure, r) for r in results]
    if measure.clean_only:
        values = [v if r.get("success_strict") is True else math.nan for v, r in zip(values, results, strict=True)]
    return np.array(values, dtype=np.float64)
