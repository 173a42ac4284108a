"""The images of one cycle denoised at the same time, one thread for each denoiser.

A denoiser keeps working memory, so each thread has one of its own. ONNX Runtime and the kernels let go of the
interpreter while they compute: two sensors on two cores take two thirds of the time that they take one after the other.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser, load_denoiser
from saranga.echo import EchoImage

Rows = dict[str, NDArray[np.float32]]


def more_of(name: str, threads: int) -> list[Denoiser]:
    """Denoisers for `threads` - 1 helping threads. None for the user's own (MODULE:NAME): it may keep things in common.

    Raises:
        UsageError: as `load_denoiser`. ValueError: fewer than one thread.
    """
    if threads < 1:
        raise ValueError(f"threads is {threads}: at least 1")
    return [] if ":" in name else [load_denoiser(name) for _ in range(threads - 1)]


class SideBySide:
    """Newest edge rows of several images; the first denoiser works in the caller's thread."""

    def __init__(self, denoisers: Sequence[Denoiser]) -> None:
        self._denoisers = list(denoisers)
        self._pools = [ThreadPoolExecutor(1, thread_name_prefix="denoise") for _ in self._denoisers[1:]]
        for pool in self._pools:
            pool.submit(int)  # the thread begins now: a flight may bind the caller, and what it starts, to one CPU

    def __call__(self, images: Mapping[str, EchoImage]) -> Rows:
        """Edges (N,) by sensor role, in the order of `images`.

        Raises:
            What a denoiser raises, once all have ended.
        """
        roles, of = list(images), len(self._denoisers)
        running = [pool.submit(_rows, denoiser, images, roles[k::of])
                   for k, (pool, denoiser) in enumerate(zip(self._pools, self._denoisers[1:], strict=True), start=1)
                   if roles[k::of]]
        try:
            found = _rows(self._denoisers[0], images, roles[::of])
        finally:
            wait(running)
        for share in running:
            found |= share.result()
        return {role: found[role] for role in roles}


def _rows(denoiser: Denoiser, images: Mapping[str, EchoImage], roles: Sequence[str]) -> Rows:
    return {role: np.atleast_2d(denoiser(images[role]))[-1] for role in roles}
