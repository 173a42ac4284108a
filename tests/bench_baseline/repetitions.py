"""Is a worsened stack caught, and an unchanged one not? Flights once, then the verdict over disjoint sets of seeds.

    python tests/bench_baseline/repetitions.py fly FOLDER [--seeds 240] [--first 1]
    python tests/bench_baseline/repetitions.py judge FOLDER [--pairs 12]

`fly` writes one journal a condition (embedded autopilot, scene poles, denoiser tbd or another) and goes on where it was
stopped; `judge` cuts the seeds into repetitions and counts the verdicts.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.baseline.flights import Flights, read_flights
from bench.baseline.inputs import world_inputs
from bench.baseline.verdict import Comparison, compare_runs
from bench.journal import FILE_NAME, open_journal, read_journal
from bench.verdict import Verdict
from saranga.denoise import load_denoiser
from saranga.navigate import VelocityCommand, load_policy
from sitl.trial_types import Faults, TrialRequest

NUDGE_M_S = 1e-6
WORSE_THRESHOLD = 1.5
"""Times the one that track-before-detect was calibrated for."""


class Nudged:
    """The shipped policy, sideways by a micrometre a second: the same in substance, no flight the same bit for bit."""

    name = "nudged"

    def __init__(self, **options: Any) -> None:
        self._inner = load_policy("saranga", **options)

    def reset(self) -> None:
        self._inner.reset()

    def decide(self, obstacles: Any, t_us: int) -> VelocityCommand:
        command = self._inner.decide(obstacles, t_us)
        return replace(command, vy_m_s=command.vy_m_s + NUDGE_M_S)


def deaf_tbd(**options: Any) -> Any:
    """Track-before-detect with a threshold that is too high."""
    denoiser = load_denoiser("tbd", **options)
    denoiser.threshold *= WORSE_THRESHOLD
    return denoiser


def deaf_gaussian(**options: Any) -> Any:
    """The Gaussian filter with a threshold that is too high."""
    denoiser = load_denoiser("gaussian", **options)
    denoiser.threshold *= WORSE_THRESHOLD
    return denoiser


def conditions_of(denoiser: str) -> dict[str, TrialRequest]:
    """What is flown, by name; "baseline" is the stack as it is."""
    plain = TrialRequest("poles", autopilot="embedded", denoiser=denoiser)
    return {
        "baseline": plain,
        "threshold": replace(plain, denoiser=f"repetitions:deaf_{denoiser}"),
        "swapped": replace(plain, faults=Faults.parse(["sensors_swapped=1"])),
        "late": replace(plain, faults=Faults(setpoint_delay_ms=100.0)),
        "nudged": replace(plain, stack="repetitions:Nudged"),
    }


WORSE = ("threshold", "swapped", "late")


def fly(root: Path, requests: dict[str, TrialRequest], seeds: range,
        say: Callable[[str], None] = lambda text: None) -> None:
    """Fly what is not flown yet; seeds of all conditions in turn."""
    from sitl.trial import run_trial

    for name in requests:
        (root / name).mkdir(parents=True, exist_ok=True)
    inputs = world_inputs(requests.values())
    for seed in seeds:
        for name, plain in requests.items():
            folder = root / name
            with open_journal(folder / FILE_NAME, run_kind="fly", run=str(folder), inputs=inputs) as journal:
                if any(r["seed"] == seed for r in read_journal(journal.path).of("trial")):
                    continue
                request = replace(plain, seed=seed)
                result = run_trial(request)
                journal.append("trial", seed=seed, request=request.to_dict(), result=result.to_dict())
                say(f"{name} seed {seed}: {result.outcome}")


def slices(flights: Flights, seeds: range, pairs: int) -> list[Flights]:
    """The run cut into disjoint sets of `pairs` seeds."""
    return [replace(flights, results={k: v for k, v in flights.results.items() if k[3] in part})
            for part in (seeds[at:at + pairs] for at in range(0, len(seeds) - pairs + 1, pairs))]


def judge(root: Path, seeds: range, pairs: int, confidence: float) -> dict[str, list[Comparison]]:
    """Every condition against the baseline, repetition by repetition; and the baseline against the next one's seeds.

    A repetition whose seeds are not all flown is left out.
    """
    cut = {name: slices(read_flights(root / name), seeds, pairs) for name in conditions_of("tbd")
           if (root / name).is_dir()}
    base = cut.pop("baseline")
    found = {name: [compare_runs(a, b, True, confidence) for a, b in zip(runs, base, strict=True)
                    if len(a.results) == len(b.results) == pairs] for name, runs in cut.items()}
    base = [part for part in base if len(part.results) == pairs]
    found["unchanged"] = [compare_runs(a, a, True, confidence) for a in base]
    turned = [*base[1:], base[0]]
    found["unchanged, other seeds"] = [compare_runs(a, b, False, confidence) for a, b in zip(turned, base, strict=True)]
    return found


def flagged(comparisons: Iterable[Comparison]) -> int:
    """How many of them say regression."""
    return sum(c.verdict is Verdict.FAIL for c in comparisons)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("fly", "judge"))
    parser.add_argument("root", type=Path)
    parser.add_argument("--conditions", default="baseline,threshold,swapped,late")
    parser.add_argument("--denoiser", choices=("tbd", "gaussian"), default="tbd")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=240)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--confidence", type=float, default=0.99)
    asked = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent))
    seeds = range(asked.first, asked.first + asked.seeds)
    if asked.what == "fly":
        all_of_them = conditions_of(asked.denoiser)
        chosen = {name: all_of_them[name] for name in asked.conditions.split(",")}
        fly(asked.root, chosen, seeds, lambda text: print(text, flush=True))
        return
    for name, comparisons in judge(asked.root, seeds, asked.pairs, asked.confidence).items():
        verdicts = Counter(c.verdict.value for c in comparisons)
        by = Counter(f.name for c in comparisons for f in c.findings if f.verdict is Verdict.FAIL)
        print(f"{name}: flagged {flagged(comparisons)} of {len(comparisons)}  {json.dumps(verdicts)}  by {dict(by)}")


if __name__ == "__main__":
    main()
