"""Writing a peak between two columns into an edge row so that `saranga.localise.edges` reads its exact position."""

import numpy as np
from numpy.typing import NDArray


def put_peak(row: NDArray[np.float32], position: float, strength: float) -> None:
    """Set the two columns about `position` so that their centroid is `position` and their larger value `strength`."""
    first = int(np.floor(position))
    if first < 0 or first + 1 >= row.size:
        return
    share = position - first
    near = min(share, 1.0 - share) / max(share, 1.0 - share)
    row[first] = strength if share <= 0.5 else strength * near
    row[first + 1] = strength * near if share <= 0.5 else strength
