"""How long a call takes, held to its share of the 16 Hz tick."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from bench.verdict import MEASURED, Check, Limit, Measurement, check

TICK_MS = 62.5
CALLS = 40
WARM_UP = 3


def latency_check(name: str, call: Callable[[], Any], budget_ms: float, reason: str) -> Check:
    """The 90th percentile of some calls after a warm-up, against `budget_ms`; over half of it is MARGINAL.

    The percentile, not the longest: what else runs on this computer is not under test.
    """
    for _ in range(WARM_UP):
        call()
    spent_ms = []
    for _ in range(CALLS):
        start = perf_counter()
        call()
        spent_ms.append(1e3 * (perf_counter() - start))
    limit = Limit(name, "ms", hi=budget_ms, marginal_hi=budget_ms / 2, reason=reason, min_samples=CALLS,
                  requires=MEASURED, source="16 Hz control: one tick is 62.5 ms")
    return check(Measurement(float(np.percentile(spent_ms, 90)), "ms", MEASURED, CALLS), limit)


def latency_text(subject: str, found: Check) -> str:
    return (f"{found.verdict.value:<8} {subject}: {found.name} {found.value:.2f} ms (90 % of {CALLS} calls), "
            f"{found.limit}")
