"""The search for the hardest course, with flights that are coins of known bias: it finds, and is not flattered."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from bench.campaign.scene_file import moved, scene_text
from bench.campaign.search import BAND, FRESH_FLIGHTS, Course, Flight, Score, Search, badness
from saranga.errors import UsageError
from sitl.scene import build_scene, load_scene, scene_traversability


class Coins:
    """Flights that fail with a probability of the course; everything asked for is remembered."""

    def __init__(self, failure: dict[str, float] | float) -> None:
        self.failure = failure
        self.courses: dict[str, Course] = {}
        self.asked: list[tuple[str, Flight]] = []

    def add(self, course: Course) -> None:
        self.courses[course.key] = course

    def rate(self, key: str) -> float:
        return self.failure if isinstance(self.failure, float) else self.failure.get(key, 0.1)

    def fly(self, stage: str, flights: Sequence[Flight]) -> Mapping[Flight, Score]:
        out = {}
        for flight in flights:
            self.asked.append((stage, flight))
            word = np.random.SeedSequence([flight.seed, *flight.course.encode()])
            failed = bool(np.random.default_rng(word).uniform() < self.rate(flight.course))
            out[flight] = Score(not failed, badness(not failed, 0.2))
        return out


def search(coins: Coins, budget: int = 100, seed: int = 1) -> Search:
    return Search(load_scene("boxes"), budget, seed, coins.fly, coins.add)


def test_it_finds_the_planted_course_within_its_budget() -> None:
    coins = Coins({"seed-7": 0.95})
    found = search(coins).run()
    assert found.course.key == "seed-7" and found.drawn[0][0] == "seed-7"
    assert len(coins.asked) <= 110
    assert sum(found.fresh) < sum(found.family)
    for course in coins.courses.values():
        if not course.key.startswith("family"):
            assert abs(course.traversability - found.target) <= BAND * found.target


def test_fresh_seeds_were_never_seen_and_a_lucky_course_is_no_hard_one() -> None:
    differences = []
    for seed in range(1, 9):
        coins = Coins(0.3)  # every course alike: whatever is found is luck
        found = search(coins, 60, seed * 100).run()
        searched = {f.seed for stage, f in coins.asked if not stage.startswith("fresh")}
        fresh = {f.seed for stage, f in coins.asked if stage.startswith("fresh")}
        assert not searched & fresh and min(fresh) >= FRESH_FLIGHTS
        flights, failures = found.chosen_by
        differences.append((failures / flights, 1.0 - sum(found.fresh) / len(found.fresh)))
    chosen, honest = np.mean(differences, axis=0)
    assert chosen > 0.5, "the flights that chose do flatter"
    assert abs(honest - 0.3) < 0.15, "the fresh ones do not"


def test_the_same_flights_give_the_same_course() -> None:
    first, second = Coins(0.4), Coins(0.4)
    assert search(first).run() == search(second).run()
    assert first.asked == second.asked


def test_a_moved_course_keeps_the_rules_and_flies_from_its_file(tmp_path: Path) -> None:
    coins = Coins(0.0)
    search(coins, 60).run()
    moves = [c for c in coins.courses.values() if c.key.startswith("move")]
    assert moves
    spec = load_scene("boxes")
    for course in moves:
        text = scene_text(course.scene, spec, course.key, 'said "so"\\')
        path = tmp_path / f"{course.key}.toml"
        path.write_text(text)
        flown = build_scene(load_scene(str(path)), 991)
        assert flown.to_dict()["obstacles"] == course.scene.to_dict()["obstacles"]
        assert scene_traversability(flown).mean == pytest.approx(course.traversability)
        assert tomllib.loads(text)["scene"]["description"] == 'said "so"\\'


@pytest.mark.parametrize("name", ["paper-composite", "paper-3d", "poles-windy", "paper-transparent"])
def test_every_kind_of_obstacle_moves_and_is_written(name: str, tmp_path: Path) -> None:
    spec = load_scene(name)
    scene = build_scene(spec, 3)
    rng = np.random.default_rng(1)
    other = moved(scene, rng, 0.1, 10.0)
    while len(other.obstacles) and all(a == b for a, b in zip(scene.obstacles, other.obstacles, strict=True)):
        other = moved(scene, rng, 0.1, 10.0)
    path = tmp_path / "x.toml"
    path.write_text(scene_text(scene, spec, "x", "y"))
    again = load_scene(str(path))
    assert [s.to_table() for s in again.obstacles] == [s.to_table() for s in scene.obstacles]
    assert again.wind == spec.wind and again.weather == spec.weather


def test_what_cannot_be_searched_is_refused() -> None:
    coins = Coins(0.1)
    with pytest.raises(UsageError, match="draws no obstacles"):
        Search(load_scene("open"), 100, 1, coins.fly, coins.add)
    with pytest.raises(UsageError, match="--budget 59: 60 flights"):
        Search(load_scene("boxes"), 59, 1, coins.fly, coins.add)
