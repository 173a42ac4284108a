"""What networks take: the envelope image, or the track map. The shape of a network's input tells which."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saranga.denoise.pulse import BANDWIDTH_HZ, RING_DOWN_M
from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS, EchoImage
from saranga.network_input import normalised
from saranga.track_map import SHAPE as TRACK_SHAPE
from saranga.track_map import TrackMap

SHAPES: dict[str, tuple[int, int, int, int]] = {
    "tracks": (1, *TRACK_SHAPE),
    "envelope": (1, 1, HISTORY_ROWS, RANGE_COLUMNS),
}
"""Input by kind, batch of one."""
MADE: dict[str, str] = {"tracks": "tracks-2", "envelope": "envelope-1"}
"""How an input is made now. A network trained on another making of the same shape would be wrong and never say so:
count on whenever one changes. tracks-1 had a grid of two columns and 0.25 columns a row."""


class NetworkInput(Protocol):
    """Makes a network's input from an echo image."""

    kind: str

    def fill(self, image: EchoImage, out: NDArray[np.float32]) -> bool:
        """Write the input, float32 (1, C, H, W), all of it; False when nothing was measured."""
        ...


class EnvelopeInput:
    """`saranga.network_input.normalised` of the envelope."""

    kind = "envelope"

    def fill(self, image: EchoImage, out: NDArray[np.float32]) -> bool:
        """See `NetworkInput`."""
        normalised(image.envelope, out[0, 0])
        return bool(out.any())


class TrackInput:
    """`saranga.track_map` of the complex image."""

    kind = "tracks"

    def __init__(self, bandwidth_hz: float, ring_down_m: float) -> None:
        self._map = TrackMap(bandwidth_hz, ring_down_m)

    def fill(self, image: EchoImage, out: NDArray[np.float32]) -> bool:
        """See `NetworkInput`."""
        return self._map.fill(image.iq, image.rows, out[0])


def inputs_of(kind: str, envelope: NDArray[np.float32], iq: NDArray[np.complex64] | None = None,
              amplitude_only: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
    """Inputs (K, C, H, W) of many images at once, float32.

    Args:
        kind: see `SHAPES`.
        envelope, iq: (K, M, N); a track map needs `iq`, an envelope image does not.
        amplitude_only: (K,) images whose phase a track map is to do without; None: none.
    """
    out = np.empty((len(envelope), *SHAPES[kind][1:]), dtype=np.float32)
    if kind == "tracks":
        assert iq is not None
        hidden = np.zeros(len(iq), dtype=np.bool_) if amplitude_only is None else amplitude_only
        TrackMap().fill_many(iq, hidden, out)
        return out
    for image, one in zip(envelope, out[:, 0], strict=True):
        normalised(image, one)
    return out


def input_kind(shape: tuple[object, ...]) -> str | None:
    """Kind of a network whose input has this shape; None for any other."""
    return next((kind for kind, own in SHAPES.items() if own == tuple(shape)), None)


def network_input(kind: str, bandwidth_hz: float = BANDWIDTH_HZ, ring_down_m: float = RING_DOWN_M) -> NetworkInput:
    """The maker of a kind of input, for a receiver of this bandwidth.

    Raises:
        ValueError: bandwidth or ring-down out of their bounds.
    """
    return TrackInput(bandwidth_hz, ring_down_m) if kind == "tracks" else EnvelopeInput()
