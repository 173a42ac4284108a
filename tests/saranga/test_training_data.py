"""What networks learn from: recipes, and batches that depend on nothing but the recipe."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from saranga.track_map import SHAPE
from saranga.training.check import check_sets, strongest_edge_rate
from saranga.training.feed import Feed, Sources, chosen, draw_batch, scene_numbers
from saranga.training.recipe import TrainingRecipe, load_training_recipe, parse_training_recipe


def small(architecture: str = "tracks", **data: Any) -> TrainingRecipe:
    tables = load_toml(fixture_path("training", "default" if architecture == "tracks" else "paper"))
    tables["data"] |= {"pairs": 24, "epochs": 1, **data}
    tables["optimiser"]["batch"] = 4
    return parse_training_recipe(tables, "test")


def test_the_papers_recipe_is_the_papers() -> None:
    paper = load_training_recipe("paper")
    assert (paper.data.pairs, paper.data.epochs, paper.optimiser.batch) == (40_000, 100, 128)
    assert (paper.optimiser.name, paper.optimiser.rate, paper.optimiser.decay) == ("adam", 2e-4, "none")
    assert paper.loss.kind == "mse" and paper.images == 4_000_000
    assert paper.synthesis().name == "paper" and paper.extra_synthesis() is None


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [("optimiser", "rate", -1.0, "optimiser.rate is -1.0"), ("data", "pairs", "many", "data.pairs is 'many'"),
     ("loss", "kind", "l1", "loss.kind is 'l1'"), ("network", "architecture", "vgg", "network.architecture is 'vgg'"),
     ("data", "colour", 1, "data.colour: Extra inputs"), ("data", "synthesis", "nothing", "nothing"),
     ("data", "set", {"noise.psnr": [0, 1]}, "unknown recipe value 'noise.psnr'")],
)
def test_a_bad_recipe_is_one_clear_error(table: str, key: str, value: Any, words: str) -> None:
    tables = load_toml(fixture_path("training", "default"))
    tables[table][key] = value
    with pytest.raises(UsageError) as caught:
        parse_training_recipe(tables, "my.toml")
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_the_hash_follows_values_not_layout_and_covers_the_synthesis() -> None:
    tables = load_toml(fixture_path("training", "default"))
    same = parse_training_recipe(dict(reversed(list(tables.items()))), "x")
    assert same.sha256 == load_training_recipe("default").sha256
    tables["data"]["set"] = tables["data"]["set"] | {"noise.psnr_db": [0.0, 1.0]}
    assert parse_training_recipe(tables, "x").sha256 != same.sha256


def test_batches_do_not_depend_on_the_threads_nor_on_where_a_run_began() -> None:
    recipe = small()
    one = list(Feed(recipe, threads=1))
    three = list(Feed(recipe, threads=3))
    late = list(Feed(recipe, threads=2, first=4))
    assert len(one) == len(three) == 6 and len(late) == 2
    for a, b in zip(one, three, strict=True):
        np.testing.assert_array_equal(a.inputs, b.inputs)
        np.testing.assert_array_equal(a.targets, b.targets)
    np.testing.assert_array_equal(late[1].inputs, one[5].inputs)
    assert one[0].inputs.shape == (4, *SHAPE) and one[0].targets.shape == (4, 512)
    assert any(batch.targets.any() for batch in one)


PROCESSES = """
import sys
import numpy as np
from saranga.training.feed import Feed
from saranga.training.feed_processes import feed_from_processes
from saranga.training.recipe import load_training_recipe

if __name__ == "__main__":
    recipe = load_training_recipe(sys.argv[1])
    threads, processes = list(Feed(recipe))[2:], list(feed_from_processes(recipe, 2, first=2))
    assert len(processes) == 4
    for a, b in zip(threads, processes, strict=True):
        np.testing.assert_array_equal(a.inputs, b.inputs)
        np.testing.assert_array_equal(a.targets, b.targets)
    print("the same")
"""


def test_processes_draw_the_same_batches_as_threads(tmp_path: Path) -> None:
    """In a process of its own, as training is: the loader's processes and handlers are no guests for a test worker."""
    text = fixture_path("training", "default").read_text(encoding="utf-8")
    text = re.sub(r"batch = \d+", "batch = 4", re.sub(r"pairs = [\d_]+", "pairs = 24", text))
    (tmp_path / "small.toml").write_text(text)
    (tmp_path / "compare.py").write_text(PROCESSES)
    done = subprocess.run([sys.executable, str(tmp_path / "compare.py"), str(tmp_path / "small.toml")], timeout=200,
                          capture_output=True, text=True)
    assert done.returncode == 0 and "the same" in done.stdout, done.stderr[-2000:]


def test_an_error_in_drawing_reaches_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> None:
        raise MemoryError("no memory")

    monkeypatch.setattr("saranga.training.feed.draw_batch", broken)
    with pytest.raises(MemoryError, match="no memory"):
        next(iter(Feed(small())))


def test_epochs_shuffle_and_cover_every_pair_once() -> None:
    recipe = small("paper", pairs=10, epochs=4)
    seen = np.concatenate([scene_numbers(recipe, k) for k in range(10)])
    for epoch in range(4):
        assert sorted(seen[10 * epoch:10 * epoch + 10]) == list(range(10))
    assert not np.array_equal(seen[:10], seen[10:20])
    batch = draw_batch(recipe, Sources.of(recipe), 1)
    assert batch.inputs.shape == (4, 1, 32, 512) and batch.targets.shape == (4, 32, 512)


def test_shares_are_kept_and_independent() -> None:
    scenes = np.arange(200_000)
    phase, extra = chosen(scenes, 0.125, 0), chosen(scenes, 0.35, 1)
    assert phase.mean() == pytest.approx(0.125, abs=0.003)
    assert extra.mean() == pytest.approx(0.35, abs=0.005)
    assert (phase & extra).mean() == pytest.approx(0.125 * 0.35, abs=0.004)
    assert not chosen(scenes, 0.0, 0).any()


def test_the_second_recipe_is_what_its_share_is_drawn_from() -> None:
    recipe = small(pairs=400)
    sources = Sources.of(recipe)
    assert sources.extra is not None
    second = chosen(np.arange(400), sources.share, 1)
    scene = int(np.flatnonzero(second)[0])
    whole = draw_batch(recipe, sources, scene // 4)
    own = np.empty((1, 1, 32, 512), dtype=np.float32), np.empty((1, 1, 32, 512), dtype=np.float32)
    sources.extra.fill(scene, *own)
    np.testing.assert_array_equal(whole.targets[scene % 4], own[1][0, 0, -1])


def test_the_quick_check_knows_right_from_wrong() -> None:
    one = check_sets("tracks", count=20)[0]
    assert one.inputs.shape == (20, *SHAPE)
    right = np.zeros((20, 512), dtype=np.float32)
    right[np.arange(20), np.rint(one.range_m / 1.66 * 512).astype(int) + 4] = 1.0
    assert strongest_edge_rate(right, one.range_m) == 1.0
    assert strongest_edge_rate(np.roll(right, 40, axis=1), one.range_m) < 0.2
    assert strongest_edge_rate(np.zeros_like(right), one.range_m) == 0.0


def test_recipes_ship(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean 'default'"):
        load_training_recipe("defalt")
