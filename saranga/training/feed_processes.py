"""Batches drawn in processes: a GPU takes them faster than threads of one interpreter can hand them over."""

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from saranga.training.feed import Sources, TrainingBatch, draw_batch
from saranga.training.recipe import TrainingRecipe

_AHEAD = 3
"""Batches that wait, a process."""
_START = "spawn"
"""A process forked from one with threads and a GPU may hang or take its parent along."""


class NumberedBatches(Dataset[tuple[Tensor, Tensor]]):
    """Batch k of a recipe is item k, whatever process draws it."""

    def __init__(self, recipe: TrainingRecipe) -> None:
        self._recipe = recipe
        self._sources: Sources | None = None

    def __getitem__(self, number: int) -> tuple[Tensor, Tensor]:
        if self._sources is None:  # in the process that draws, so that only the recipe travels there
            self._sources = Sources.of(self._recipe)
        batch = draw_batch(self._recipe, self._sources, number)
        return torch.from_numpy(batch.inputs), torch.from_numpy(batch.targets)


def feed_from_processes(recipe: TrainingRecipe, processes: int, first: int = 0) -> Iterator[TrainingBatch]:
    """The batches of `saranga.training.feed.Feed`, in the same order, from `processes` processes."""
    batches = recipe.images // recipe.optimiser.batch
    loader: DataLoader[tuple[Tensor, Tensor]] = DataLoader(
        NumberedBatches(recipe), batch_size=None, sampler=range(first, batches), num_workers=processes,
        prefetch_factor=_AHEAD, multiprocessing_context=_START)
    for inputs, targets in loader:
        yield TrainingBatch(inputs.numpy(), targets.numpy())
