"""May the embedded autopilot screen for the real one? Agreement over the same seeds, with the error it would make.

Every row is flown by both. The answer is the difference of the success rates, paired by seed, with its interval: PASS
when all of it lies within +-MARGIN, FAIL when all of it lies outside, else INCONCLUSIVE with the number of further
pairs. The largest difference that the interval allows is the stated error of a rate that only the fast one flew.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.campaign.agreement import cohens_kappa, paired_difference, pairs_needed, path_agreement
from bench.campaign.suite import Screening, Suite
from bench.flight_summary import NOT_JUDGED
from bench.statistics import mcnemar_exact, wilson_interval
from bench.verdict import Verdict

MARGIN = 0.10
LEAST_PAIRS = 10
FAST, SLOW = "embedded", "arducopter"

Trial = dict[str, Any]


def screening_suite(suite: Suite) -> Suite:
    """The same rows, each once on the embedded autopilot and once on the real one, over the same seeds."""
    rows, pairs = [], []
    for row in suite.rows:
        names = {kind: f"{row.name}.{kind}" for kind in (FAST, SLOW)}
        rows += [row.model_copy(update={"name": name, "autopilot": kind, "paper": None})
                 for kind, name in names.items()]
        pairs.append(Screening(name=row.name, fast=names[FAST], slow=names[SLOW]))
    head = suite.head.model_copy(update={"name": f"{suite.head.name}-screening",
                                         "description": f"{suite.head.description}; embedded autopilot against the "
                                                        "real one, seed by seed"})
    return replace(suite, head=head, rows=tuple(rows), comparisons=(), screenings=tuple(pairs))


def screening_of(screenings: Sequence[dict[str, Any]], rules: dict[str, str], outcomes: Sequence[Trial],
                 folder: Path | None) -> dict[str, Any] | None:
    """Agreement of every pair of rows and of all together; None where the suite asks for none.

    Args:
        rules: "strict" or "lenient" of every row.
        folder: of the run, for the tracks; without it there is no word on paths.
    """
    if not screenings:
        return None
    rows, everything = [], []
    for pair in screenings:
        both = _pairs(pair, outcomes)
        key = f"success_{rules[pair['slow']]}"
        found = [_compared(fast, slow, key, folder) for fast, slow in both]
        rows.append({"name": pair["name"], "fast": pair["fast"], "slow": pair["slow"], **_agreement(found)})
        everything += found
    whole = _agreement(everything)
    verdict, reason = _verdict(whole)
    return {"rows": rows, "all": whole, "verdict": verdict.value, "reason": reason, "margin": MARGIN}


def _pairs(pair: dict[str, Any], outcomes: Sequence[Trial]) -> list[tuple[Trial, Trial]]:
    fast, slow = ({t["seed"]: t for t in outcomes if t["row"] == pair[side] and t["outcome"] not in NOT_JUDGED}
                  for side in ("fast", "slow"))
    return [(fast[seed], slow[seed]) for seed in sorted(fast.keys() & slow.keys())]


def _compared(fast: Trial, slow: Trial, key: str, folder: Path | None) -> dict[str, Any]:
    tracks = [_track(folder, trial) for trial in (fast, slow)]
    path = None if tracks[0] is None or tracks[1] is None else path_agreement(tracks[0], tracks[1])
    return {"seed": fast["seed"], "fast": fast[key] is True, "slow": slow[key] is True,
            "fast_outcome": fast["outcome"], "slow_outcome": slow["outcome"],
            "path": None if path is None else asdict(path)}


def _track(folder: Path | None, trial: Trial) -> Any:
    try:
        assert folder is not None
        data = json.loads((folder / trial["files"]["trial"]).read_text(encoding="utf-8"))
        track = np.array(data["track"], dtype=np.float64).reshape(-1, 4)
        return track if len(track) else None
    except (AssertionError, KeyError, OSError, ValueError):
        return None


def _agreement(pairs: list[dict[str, Any]]) -> dict[str, Any]:
    n = len(pairs)
    if not n:
        return {"pairs": 0, "seeds": []}
    fast, slow = ([p[side] for p in pairs] for side in ("fast", "slow"))
    same = sum(a == b for a, b in zip(fast, slow, strict=True))
    only_fast = sum(a and not b for a, b in zip(fast, slow, strict=True))
    only_slow = n - same - only_fast
    difference, kappa = paired_difference(fast, slow), cohens_kappa(fast, slow)
    paths = [p["path"] for p in pairs if p["path"] is not None]
    return {
        "pairs": n, "fast_rate": sum(fast) / n, "slow_rate": sum(slow) / n,
        "agreement": {"count": same, "rate": same / n, "interval": list(wilson_interval(same, n))},
        "same_outcome": sum(p["fast_outcome"] == p["slow_outcome"] for p in pairs),
        "kappa": None if kappa is None else {"value": kappa[0], "interval": list(kappa[1:])},
        "only_fast": only_fast, "only_slow": only_slow, "mcnemar_p": mcnemar_exact(only_fast, only_slow),
        "difference": {"value": difference.value, "interval": [difference.low, difference.high]},
        "stated_error": difference.largest, "pairs_needed": pairs_needed(only_fast, only_slow, n, MARGIN),
        "paths": None if not paths else {
            "compared": len(paths), "rms_m": median(p["rms_m"] for p in paths),
            "rms_p90_m": float(np.percentile([p["rms_m"] for p in paths], 90)),
            "max_m": max(p["max_m"] for p in paths), "common_m": median(p["common_m"] for p in paths)},
        "seeds": pairs,
    }


def _verdict(whole: dict[str, Any]) -> tuple[Verdict, str]:
    n = whole["pairs"]
    if n < LEAST_PAIRS:
        return Verdict.INCONCLUSIVE, f"{n} pairs: {LEAST_PAIRS} are the least"
    low, high = whole["difference"]["interval"]
    seen = (f"embedded minus real: {100 * whole['difference']['value']:+.0f} points "
            f"({100 * low:+.0f} to {100 * high:+.0f}) over {n} pairs")
    if low >= -MARGIN and high <= MARGIN:
        return Verdict.PASS, f"{seen}: may screen, with an error of at most {100 * whole['stated_error']:.0f} points"
    if low > MARGIN or high < -MARGIN:
        return Verdict.FAIL, f"{seen}: more than {100 * MARGIN:.0f} points apart, must not screen"
    more = whole["pairs_needed"]
    return Verdict.INCONCLUSIVE, (f"{seen}: {100 * MARGIN:.0f} points are asked for; "
                                  + (f"about {more} more pairs would show that" if more
                                     else "at this difference no number of pairs would show that"))
