"""What a denoiser is."""

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from saranga.echo import EchoImage


@runtime_checkable
class Denoiser(Protocol):
    """An echo image in, edge strengths out.

    Attributes:
        name: by which `load_denoiser` finds it.
        threshold: the tau_c it was calibrated for: edges over it are obstacles.
        edge_offset_m: mean of (range of the edge - true range), which the stack subtracts. An echo of true range r
            starts at delay tau = 2 r / c and peaks after it (`saranga.denoise.pulse`).
    """

    name: str
    threshold: float
    edge_offset_m: float

    def __call__(self, image: EchoImage) -> NDArray[np.float32]:
        """Edge strengths 0..1 and finite, (N,) or (M, N); the last row is the newest."""
        ...
