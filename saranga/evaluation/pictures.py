"""MSE and SSIM of the newest row, as the paper's Fig. 8 takes them of its pictures.

A row of zeros scores well in both, because a label has a handful of ones in 512 columns: they are reported beside the
row of the baseline "nothing", never alone.
"""

import numpy as np
from numpy.typing import NDArray

from saranga.resample import COLUMN_M

SIGMA_COLUMNS = 1.5
REACH = 5
C1, C2 = 0.01**2, 0.03**2
"""Wang, Bovik, Sheikh, Simoncelli, IEEE Trans. Image Process. 13, 600-612 (2004): Gaussian window 11, range 0..1."""


def compensated(rows: NDArray[np.float32], offset_m: float) -> NDArray[np.float32]:
    """Rows (K, N) moved nearer by the denoiser's offset, to the whole column ("a compensation offset", the paper)."""
    shift = round(offset_m / COLUMN_M)
    moved = np.zeros_like(rows)
    n = rows.shape[1]
    first, last = max(0, -shift), min(n, n - shift)
    moved[:, first:last] = rows[:, first + shift:last + shift]
    return moved


def mse(rows: NDArray[np.float32], labels: NDArray[np.float32]) -> NDArray[np.float64]:
    """(K,) mean squared difference of each row."""
    return np.mean((rows.astype(np.float64) - labels) ** 2, axis=1)


def ssim(rows: NDArray[np.float32], labels: NDArray[np.float32]) -> NDArray[np.float64]:
    """(K,) structural similarity along range, in one dimension; the REACH columns at each end are left out."""
    weights = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / SIGMA_COLUMNS) ** 2)
    weights /= weights.sum()

    def mean(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.lib.stride_tricks.sliding_window_view(x, 2 * REACH + 1, axis=1) @ weights

    x, y = rows.astype(np.float64), labels.astype(np.float64)
    mx, my = mean(x), mean(y)
    vx, vy, both = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    like = (2 * mx * my + C1) * (2 * both + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))
    return like.mean(axis=1)
