"""What denoisers answer to a set: edge rows, time, and the truth to hold against them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser
from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS, EchoImage
from saranga.errors import BenchError
from saranga.evaluation.sets import PairSet


@dataclass(frozen=True, eq=False)
class ArrayImage:
    """An echo image from arrays, as `EchoImage` gives it: `iq` complex64 and `envelope` float32 (M, N), `rows`."""

    iq: NDArray[np.complex64]
    envelope: NDArray[np.float32]
    rows: int = HISTORY_ROWS


class Nothing:
    """Finds nothing, ever: the row that shows which measures can be gamed."""

    name = "nothing"
    threshold = 0.5
    edge_offset_m = 0.0

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Zeros (N,)."""
        return np.zeros(image.envelope.shape[1], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Answers:
    """Of one denoiser to one set.

    Attributes:
        rows: float32 (K, R, N), newest edge row of each scene and sensor.
        seconds: (K * R,), wall time of each call.
        truth: (K,) of `saranga.synthesis.truth_dtype(R)`.
        labels: float32 (K, N), newest label row of the first sensor.
    """

    rows: NDArray[np.float32]
    seconds: NDArray[np.float64]
    truth: NDArray[Any]
    labels: NDArray[np.float32]


def timed_row(denoiser: Denoiser, image: ArrayImage) -> tuple[NDArray[np.float32], float]:
    """Newest edge row (N,) and the seconds it took.

    Raises:
        BenchError: an answer of another shape, or one that is not finite.
    """
    began = perf_counter()
    answer = denoiser(cast(EchoImage, image))
    seconds = perf_counter() - began
    row = np.atleast_2d(answer)[-1]
    columns = image.envelope.shape[1]
    if row.shape != (columns,) or not np.isfinite(row).all():
        fault = "values that are not finite" if row.shape == (columns,) else f"shape {np.shape(answer)}"
        raise BenchError(f"denoiser {denoiser.name!r} answered with {fault}: it must give ({columns},) or "
                         f"({len(image.envelope)}, {columns}) finite edge strengths")
    return np.asarray(row, dtype=np.float32), seconds


def warm_up(denoiser: Denoiser) -> None:
    """One call on noise, so that nothing is compiled or loaded within a measured one."""
    noise = np.random.default_rng(0).standard_normal((HISTORY_ROWS, RANGE_COLUMNS, 2)).astype(np.float32)
    iq = np.ascontiguousarray(noise).view(np.complex64)[..., 0]
    timed_row(denoiser, ArrayImage(iq, np.abs(iq)))


def answers(denoisers: Mapping[str, Denoiser], pairs: PairSet,
            done: Callable[[int], None] = lambda frames: None) -> dict[str, Answers]:
    """Every denoiser on the same images, one after the other on each.

    Args:
        denoisers: by name.
        pairs: the images; each is drawn once.
        done: told after each batch how many frames (times denoisers) it was.
    """
    rows: dict[str, list[NDArray[np.float32]]] = {name: [] for name in denoisers}
    seconds: dict[str, list[float]] = {name: [] for name in denoisers}
    truth, labels = [], []
    for batch in pairs.batches():
        assert batch.iq is not None
        truth.append(batch.truth)
        labels.append(batch.labels[:, 0, -1].copy())
        made = {name: np.empty((*batch.images.shape[:2], RANGE_COLUMNS), dtype=np.float32) for name in denoisers}
        for k, r in np.ndindex(batch.images.shape[:2]):
            image = ArrayImage(batch.iq[k, r], batch.images[k, r], HISTORY_ROWS - int(batch.truth["first_row"][k]))
            for name, denoiser in denoisers.items():
                made[name][k, r], spent = timed_row(denoiser, image)
                seconds[name].append(spent)
        for name in denoisers:
            rows[name].append(made[name])
        done(batch.images.shape[0] * batch.images.shape[1] * len(denoisers))
    return {name: Answers(np.concatenate(rows[name]), np.array(seconds[name]), np.concatenate(truth),
                          np.concatenate(labels)) for name in denoisers}
