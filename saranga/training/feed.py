"""Batches for training, drawn in threads while the network computes."""

import queue
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS
from saranga.input_kinds import inputs_of
from saranga.synthesis import Synthesiser
from saranga.training.recipe import TrainingRecipe

_AHEAD = 3
"""Batches that wait, a thread."""
_GOLDEN = 0x9E3779B97F4A7C15


@dataclass(frozen=True)
class TrainingBatch:
    """`inputs` (K, C, H, W) and `targets` (K, N) or (K, M, N), float32."""

    inputs: NDArray[np.float32]
    targets: NDArray[np.float32]


@dataclass(frozen=True)
class Sources:
    """Where pairs are drawn from: the recipe's synthesis, and for `share` of the scenes a second one."""

    main: Synthesiser
    extra: Synthesiser | None
    share: float

    @staticmethod
    def of(recipe: TrainingRecipe) -> "Sources":
        """Both synthesisers of a recipe."""
        seed, second = recipe.data.seed, recipe.extra_synthesis()
        return Sources(Synthesiser(recipe.synthesis(), seed, ("left",)),
                       Synthesiser(second, seed, ("left",)) if second else None,
                       recipe.data.extra.share if recipe.data.extra else 0.0)


class Feed:
    """Batches 0, 1, 2 ... of a recipe: the same whatever the number of threads.

    Args:
        recipe: pairs, epochs, seed, batch size, architecture.
        threads: that draw.
        first: number of the first batch wanted (to go on where a run ended).
    """

    def __init__(self, recipe: TrainingRecipe, threads: int = 1, first: int = 0) -> None:
        self.recipe = recipe
        self.sources = Sources.of(recipe)
        self.batches = recipe.images // recipe.optimiser.batch
        self._first = first
        self._threads = threads
        self._stop = threading.Event()
        self._queues: list[queue.Queue[TrainingBatch | BaseException]] = [
            queue.Queue(_AHEAD) for _ in range(threads)]
        for k in range(threads):
            threading.Thread(target=self._draw, args=(k,), daemon=True, name=f"feed-{k}").start()

    def __iter__(self) -> Iterator[TrainingBatch]:
        for number in range(self._first, self.batches):
            item = self._queues[(number - self._first) % self._threads].get()
            if isinstance(item, BaseException):
                raise item
            yield item

    def close(self) -> None:
        """Let the threads end."""
        self._stop.set()
        for waiting in self._queues:
            while not waiting.empty():
                waiting.get_nowait()

    def _draw(self, thread: int) -> None:
        try:
            for number in range(self._first + thread, self.batches, self._threads):
                batch = draw_batch(self.recipe, self.sources, number)
                while not self._stop.is_set():
                    try:
                        self._queues[thread].put(batch, timeout=0.5)
                        break
                    except queue.Full:
                        continue
                if self._stop.is_set():
                    return
        except BaseException as error:  # handed to the loop, which would otherwise wait for ever
            self._queues[thread].put(error)


def draw_batch(recipe: TrainingRecipe, sources: Sources, number: int) -> TrainingBatch:
    """Batch `number`; scenes are shuffled anew in every epoch when there is more than one."""
    scenes = scene_numbers(recipe, number)
    shape = (len(scenes), 1, HISTORY_ROWS, RANGE_COLUMNS)
    images, labels = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    tracks = recipe.network.architecture == "tracks"
    iq = np.empty(shape, dtype=np.complex64) if tracks else None
    for k, (scene, second) in enumerate(zip(scenes, chosen(scenes, sources.share, 1), strict=True)):
        one = slice(k, k + 1)
        source = sources.extra if second and sources.extra else sources.main
        source.fill(int(scene), images[one], labels[one], iq[one] if iq is not None else None)
    kind = "envelope" if iq is None else "tracks"
    hidden = chosen(scenes, recipe.data.amplitude_only_share, 0)
    inputs = inputs_of(kind, images[:, 0], None if iq is None else iq[:, 0], hidden)
    return TrainingBatch(inputs, np.ascontiguousarray(labels[:, 0] if iq is None else labels[:, 0, -1]))


def scene_numbers(recipe: TrainingRecipe, number: int) -> NDArray[np.int64]:
    """Scenes of batch `number`; batches run on over the end of an epoch."""
    size, pairs = recipe.optimiser.batch, recipe.data.pairs
    at = np.arange(number * size, (number + 1) * size, dtype=np.int64)
    if recipe.data.epochs == 1:
        return at
    scenes = np.empty(size, dtype=np.int64)
    for epoch in np.unique(at // pairs):
        order = np.random.default_rng([recipe.data.seed, int(epoch)]).permutation(pairs)
        here = at // pairs == epoch
        scenes[here] = order[at[here] % pairs]
    return scenes


def chosen(scenes: NDArray[np.int64], share: float, purpose: int) -> NDArray[np.bool_]:
    """A fixed `share` of the scenes by their number, for purposes 0, 1, ... independently."""
    z = scenes.astype(np.uint64) + np.uint64((purpose + 1) * _GOLDEN % 2**64)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):  # splitmix64
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    z ^= z >> np.uint64(31)
    return (z >> np.uint64(40)).astype(np.float64) / 2.0**24 < share
