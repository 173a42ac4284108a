"""Looking for the course of a family on which the stack does worst, with a bounded number of flights.

1. Successive halving (K. Jamieson, A. Talwalkar, AISTATS 2016): many drawn courses fly once, the worse half goes on
   and flies on, until two are left with about eight flights each.
2. From the worst, its obstacles are moved at random in small steps; a moved course that the rules of the scene allow
   and on which the stack does worse, over the same flight seeds, takes its place.
3. What was found, and as many fresh courses of the family, fly with seeds that no step before has seen. Only these
   flights enter the result: the flights that chose a course flatter its difficulty (the winner's curse).

All courses have the family's traversability within BAND, so that what is found is not merely fuller.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean

import numpy as np

from bench.campaign.scene_file import moved
from saranga.errors import UsageError
from sitl.scene import Scene, broken_rule, build_scene, scene_traversability
from sitl.scene_spec import SceneSpec

BAND = 0.10
LEAST_BUDGET = 60
HALVING, LOCAL = 0.40, 0.25
"""Parts of the budget; the rest is for fresh seeds, half of it for the course and half for the family."""
LOCAL_SEEDS = 4
PROPOSALS = 3
STEP_M, STEP_DEG = 0.15, 20.0
SMALLER = 0.7
NEAR_M = 0.3
FRESH_FLIGHTS, FRESH_COURSES = 1_000_000, 2_000_000
"""Where fresh seeds begin, counted from the first seed."""


@dataclass(frozen=True)
class Course:
    """A course in the search: where it came from, and itself."""

    key: str
    scene: Scene
    traversability: float


@dataclass(frozen=True)
class Flight:
    """Course and flight seed: one flight to be made."""

    course: str
    seed: int


@dataclass(frozen=True)
class Score:
    """What came of a flight. `badness` is 1 for a failure, else up to 0.5 for how near an obstacle was passed."""

    success: bool
    badness: float


def badness(success: bool, min_clearance_m: float | None) -> float:
    """See Score; nearer than NEAR_M begins to count."""
    if not success:
        return 1.0
    return 0.5 * max(0.0, 1.0 - (NEAR_M if min_clearance_m is None else max(min_clearance_m, 0.0)) / NEAR_M)


Fly = Callable[[str, Sequence[Flight]], Mapping[Flight, Score]]
"""Stage and flights to what came of them; a flight that broke off is missing from the answer."""


@dataclass(frozen=True)
class Found:
    """What the search ends with.

    Attributes:
        course: the hardest one.
        chosen_by: flights and failures that chose it; not its difficulty.
        fresh: of it, in order of the seeds.
        family: of fresh courses of the family, one flight each.
        target: mean traversability of the family.
        drawn: key and mean badness of the courses that were halved, hardest first.
        moves: how many moved courses flew, and how many took the place of the one before.
    """

    course: Course
    chosen_by: tuple[int, int]
    fresh: tuple[bool, ...]
    family: tuple[bool, ...]
    target: float
    drawn: tuple[tuple[str, float], ...]
    moves: tuple[int, int]


class Search:
    """One search; the same inputs and the same flights give the same course.

    Args:
        spec: the family; it must draw something.
        budget: flights in all.
        seed: first course seed; all other randomness follows from it.
        fly: makes flights.
        add: told about every course before it flies.

    Raises:
        UsageError: a scene that draws nothing, or a budget too small to tell anything.
    """

    def __init__(self, spec: SceneSpec, budget: int, seed: int, fly: Fly, add: Callable[[Course], None]) -> None:
        if spec.generator is None:
            raise UsageError(f"--hardest {spec.name}: that scene draws no obstacles, so there is no family to search; "
                             "take one with a [generator]")
        if budget < LEAST_BUDGET:
            raise UsageError(f"--budget {budget}: {LEAST_BUDGET} flights are the least that can tell anything")
        self.spec, self.budget, self.seed = spec, budget, seed
        self._fly, self._add = fly, add
        self._scores: dict[str, dict[int, Score]] = {}
        self.target = 0.0

    def run(self) -> Found:
        """Search, then fly what was found with fresh seeds."""
        drawn = self._draw(max(round(HALVING * self.budget / 2.5), 4))
        best, ranked = self._halve(drawn)
        best, moves = self._move(best)
        each = max((self.budget - round((HALVING + LOCAL) * self.budget)) // 2, 5)
        fresh = [Flight(best.key, self.seed + FRESH_FLIGHTS + k) for k in range(each)]
        family = [self._family(k) for k in range(each)]
        for course in family:
            self._add(course)
        others = [Flight(course.key, self.seed + FRESH_COURSES + k) for k, course in enumerate(family)]
        chosen = list(self._scores[best.key].values())
        answers = self._fly("fresh seeds", [*fresh, *others])
        return Found(best, (len(chosen), sum(not s.success for s in chosen)),
                     tuple(answers[f].success for f in fresh if f in answers),
                     tuple(answers[f].success for f in others if f in answers), self.target, ranked, moves)

    def _family(self, k: int) -> Course:
        seed = self.seed + FRESH_COURSES + k
        return self._course(f"family-{seed}", build_scene(self.spec, seed))

    def _course(self, key: str, scene: Scene) -> Course:
        return Course(key, scene, scene_traversability(scene).mean)

    def _draw(self, count: int) -> list[Course]:
        """Courses of the family, without those that are fuller or emptier than BAND allows."""
        all_drawn = [self._course(f"seed-{s}", build_scene(self.spec, s))
                     for s in range(self.seed, self.seed + count)]
        self.target = mean(c.traversability for c in all_drawn)
        kept = [c for c in all_drawn if self._in_band(c)]
        if len(kept) < 2:
            raise UsageError(f"--hardest {self.spec.name}: only {len(kept)} of {count} courses lie within "
                             f"{100 * BAND:.0f} % of the family's traversability; raise --budget, or narrow "
                             "[course] traversability of the scene")
        for course in kept:
            self._add(course)
        return kept

    def _in_band(self, course: Course) -> bool:
        return abs(course.traversability - self.target) <= BAND * self.target

    def _bad(self, key: str, seeds: Sequence[int] | None = None) -> float:
        """Mean badness over the flights so far; lower than any where none ended."""
        found = self._scores.get(key, {})
        values = [s.badness for seed, s in found.items() if seeds is None or seed in seeds]
        return mean(values) if values else -1.0

    def _score(self, stage: str, flights: Sequence[Flight]) -> None:
        for flight, score in self._fly(stage, flights).items():
            self._scores.setdefault(flight.course, {})[flight.seed] = score

    def _halve(self, courses: list[Course]) -> tuple[Course, tuple[tuple[str, float], ...]]:
        left, flown, more = list(courses), 0, 1
        while True:
            seeds = range(self.seed + flown, self.seed + flown + more)
            self._score(f"{len(left)} courses", [Flight(c.key, s) for c in left for s in seeds])
            flown += more
            left.sort(key=lambda c: -self._bad(c.key))
            if len(left) <= 2:
                break
            left = left[:max(len(left) // 2, 2)]
            more = flown  # half the courses, twice the flights: every round costs the same
        ranked = tuple(sorted(((c.key, round(self._bad(c.key), 4)) for c in courses), key=lambda item: -item[1]))
        return left[0], ranked

    def _move(self, best: Course) -> tuple[Course, tuple[int, int]]:
        """Random local search, each round from the hardest so far."""
        rounds = max(round(LOCAL * self.budget / (PROPOSALS * LOCAL_SEEDS)), 1)
        seeds = range(self.seed, self.seed + LOCAL_SEEDS)
        step, flown, taken = 1.0, 0, 0
        for number in range(rounds):
            rng = np.random.default_rng(np.random.SeedSequence([self.seed, number, 0x5EA]))
            proposals = [c for k in range(PROPOSALS) if (c := self._proposal(best, rng, step, f"{number}.{k}"))]
            missing = [Flight(best.key, s) for s in seeds if s not in self._scores.get(best.key, {})]
            self._score(f"moves, round {number + 1} of {rounds}",
                        [*missing, *(Flight(c.key, s) for c in proposals for s in seeds)])
            flown += len(proposals)
            harder = max(proposals, key=lambda c: self._bad(c.key, seeds), default=best)
            if self._bad(harder.key, seeds) > self._bad(best.key, seeds):
                best, taken = harder, taken + 1
            else:
                step *= SMALLER
        return best, (flown, taken)

    def _proposal(self, best: Course, rng: np.random.Generator, step: float, name: str) -> Course | None:
        for _ in range(60):
            scene = moved(best.scene, rng, STEP_M * step, STEP_DEG * step, len(self.spec.obstacles))
            if broken_rule(self.spec, scene) is None and self._in_band(course := self._course(f"move-{name}", scene)):
                self._add(course)
                return course
        return None
