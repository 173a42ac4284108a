"""The network behind `Denoiser`, whatever runs it: image in, its edge probabilities out as sub-column peaks.

A network says how likely an edge is in each column; where an echo is faint the probability of one edge spreads over
many columns. So an edge is a local maximum, its position is the centroid about it, and its strength grows with the
evidence that there is an edge anywhere about it, x = sum of -log(1 - p) over EVIDENCE_REACH columns on each side:
x / (x + HALF_EVIDENCE). A sum of p itself would put a broad doubt over a sharp certainty. The window reaches over
lower maxima beside it: a long echo may show two, neither of them sure, and yet there surely is one.
"""

import importlib
from collections.abc import Callable, Sequence
from types import ModuleType, SimpleNamespace
from typing import cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from saranga.denoise.model_file import ModelFile, model_file
from saranga.denoise.peaks import put_peak
from saranga.denoise.pulse import blank_columns
from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS, EchoImage
from saranga.errors import DeviceError, UsageError
from saranga.input_kinds import MADE, SHAPES, NetworkInput, input_kind, network_input

IMAGE_SHAPE = (HISTORY_ROWS, RANGE_COLUMNS)
OUTPUT_SHAPES = ((1, RANGE_COLUMNS), (1, HISTORY_ROWS, RANGE_COLUMNS))

HALF_EVIDENCE = 4.0
"""Evidence at strength 0.5: calibrated thresholds are near it."""
EVIDENCE_REACH = 18
EDGE_WEIGHT = 4.0
"""Of an edge against an empty column in training (`fixtures/training/default.toml`): taken back before adding up."""
_MOST_P = 0.999
_APART = 5
"""Columns between two edges: nearer maxima belong to the higher one."""
_REACH = 7
"""Columns on each side that the position is taken from."""
_LEAST = 0.005
"""A probability under it is no edge at any threshold: two steps of an 8-bit output are 0.008."""
_MOST = 64

Runtime = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Input (1, C, H, W) in, C-contiguous; edges (1, N) or (1, M, N) out, which the next call may overwrite."""


class NetworkDenoiser:
    """Callable as every `Denoiser`.

    Attributes:
        runtime: which library runs the network, with its version.
        weights_sha256: of the weights file in use.
    """

    def __init__(self, name: str, runtime: str, weights: ModelFile, shape: Sequence[object], infer: Runtime,
                 ring_down_m: float) -> None:
        """Check the network on noise, so that no bad weights are met in flight.

        Args:
            name, runtime: see above.
            weights: what `infer` runs.
            shape: of its input, which says what it takes (`saranga.input_kinds`).
            infer: runs the network.
            ring_down_m: there is no edge nearer.

        Raises:
            UsageError: input or output of another shape, weights trained on another input than `input_kinds.MADE`,
                output that is not finite or not within 0..1.
            ValueError: `ring_down_m`.
        """
        kind = input_kind(tuple(shape))
        if kind is None:
            raise UsageError(f"weights {weights.path}: the input is {tuple(shape)}; expected "
                             f"{' or '.join(f'{own} ({kind})' for kind, own in SHAPES.items())}")
        if weights.made_from != MADE[kind] and (weights.made_from or kind == "tracks"):
            raise UsageError(f"weights {weights.path}: trained on input {weights.made_from or 'tracks-1'!r}, this "
                             f"version makes {MADE[kind]!r}: their edges would be wrong; train and publish the network "
                             "anew (python -m saranga train, publish)")
        self.name = name
        self.runtime = runtime
        self.threshold = weights.threshold
        self.edge_offset_m = weights.edge_offset_m
        self.weights_sha256 = weights.sha256
        self._infer = infer
        self._blank = blank_columns(ring_down_m)
        self._maker: NetworkInput = network_input(kind, ring_down_m=ring_down_m)
        self._input = np.zeros(SHAPES[kind], dtype=np.float32)
        self._check(weights)

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Edge strengths (N,) of the newest row; all zero for an image with nothing measured in it.

        Raises:
            UsageError: an image of another shape. DeviceError: the network's output is not finite.
        """
        if image.iq.shape != IMAGE_SHAPE:
            raise UsageError(f"denoiser {self.name!r} takes images of {IMAGE_SHAPE}, this one is {image.iq.shape}")
        out = np.zeros(RANGE_COLUMNS, dtype=np.float32)
        if not self._maker.fill(image, self._input):
            return out
        found = _peaks(self._infer(self._input).reshape(-1, RANGE_COLUMNS)[-1], self._blank)
        if found is None:
            raise DeviceError(f"denoiser {self.name!r}: {self.runtime} gave edges that are not finite; check its "
                              "installation")
        for column, strength in found:
            put_peak(out, column, strength)
        return out

    def _check(self, weights: ModelFile) -> None:
        noise = np.random.default_rng(0).normal(size=(*IMAGE_SHAPE, 2)).astype(np.float32).view(np.complex64)[..., 0]
        sample = SimpleNamespace(iq=noise, envelope=np.abs(noise), rows=HISTORY_ROWS)
        self._maker.fill(cast(EchoImage, sample), self._input)
        edges = self._infer(self._input)
        if edges.shape not in OUTPUT_SHAPES:
            raise UsageError(f"weights {weights.path}: the output is {edges.shape}; expected "
                             f"{' or '.join(map(str, OUTPUT_SHAPES))}")
        if not np.isfinite(edges).all():
            raise UsageError(f"weights {weights.path}: the output for noise is not finite; the weights are broken, "
                             "export them anew")
        low, high = float(edges.min()), float(edges.max())
        if low < -1e-3 or high > 1.001:
            raise UsageError(f"weights {weights.path}: outputs reach from {low:.3g} to {high:.3g}; expected 0..1: "
                             "export with the sigmoid inside (python -m saranga export)")


def open_weights(weights: str, precision: str, known: tuple[str, ...]) -> tuple[ModelFile, bytes]:
    """Weights by name or metadata path, verified.

    Raises:
        UsageError: unknown weights or precision, a file that is missing or does not match its metadata.
    """
    if precision not in known:
        raise UsageError(f"unknown precision {precision!r}: known are {', '.join(known)}")
    found = model_file(weights, precision)
    return found, found.read()


def need(denoiser: str, package: str, distribution: str, extra: str) -> ModuleType:
    """Import a runtime, which is optional.

    Raises:
        UsageError: not installed, with the command that installs it.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise UsageError(f"denoiser {denoiser!r} needs the package {distribution}, which cannot be imported ({error}): "
                         f"pip install 'saranga-bench[{extra}]'") from error


def need_threads(threads: int) -> int:
    """`threads`, checked.

    Raises:
        ValueError: not within 1..64.
    """
    if isinstance(threads, bool) or not isinstance(threads, int) or not 1 <= threads <= 64:
        raise ValueError(f"threads is {threads!r}; give a whole number from 1 to 64")
    return threads


def unreadable(weights: ModelFile, runtime: str, error: Exception) -> UsageError:
    """The error for weights that match their metadata and yet cannot be loaded."""
    reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else type(error).__name__
    return UsageError(f"weights {weights.path} ({weights.path.stat().st_size} bytes): {runtime} cannot load them: "
                      f"{reason}; export them anew")


@njit(cache=True)
def _peaks(row, blank):  # type: ignore[no-untyped-def]
    """(k, 2): column and strength of each edge; None when `row` is not finite."""
    n = row.size
    at = np.empty(_MOST, dtype=np.int64)
    k = 0
    total = np.float32(0.0)
    for c in range(n):
        total += row[c]
    if not np.isfinite(total):
        return None
    for c in range(blank, n):
        v = row[c]
        if v < _LEAST or k == _MOST:
            continue
        highest = True
        for j in range(max(c - _APART, blank), min(c + _APART + 1, n)):
            if row[j] > v or (row[j] == v and j < c):
                highest = False
                break
        if highest:
            stop = c
            while stop + 1 < n and row[stop + 1] == v:
                stop += 1
            at[k] = (c + stop) // 2  # the middle of a flat top, as saturated or 8-bit outputs have
            k += 1
    found = np.empty((k, 2))
    for i in range(k):
        first, last = blank, n - 1
        low, high = max(at[i] - EVIDENCE_REACH, blank), min(at[i] + EVIDENCE_REACH, n - 1)
        if i > 0:
            first = (at[i - 1] + at[i]) // 2 + 1
            if row[at[i - 1]] > row[at[i]]:
                low = max(low, first)
        if i + 1 < k:
            last = (at[i] + at[i + 1]) // 2
            if row[at[i + 1]] > row[at[i]]:
                high = min(high, last)
        mass = 0.0
        moment = 0.0
        evidence = 0.0
        for j in range(low, high + 1):
            p = min(max(float(row[j]), 0.0), _MOST_P)
            evidence -= np.log1p(-p / (p + EDGE_WEIGHT * (1.0 - p)))
            if abs(j - at[i]) <= _REACH and first <= j <= last:
                mass += p
                moment += p * j
        found[i, 0] = moment / mass
        found[i, 1] = evidence / (evidence + HALF_EVIDENCE)
    return found
