"""Echo images with known truth: Gaussian pulses on the range grid, range walk, noise of the receiver's band."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 32, 512
COLUMN_M = 1.66 / 512
CYCLE_S = 0.0256
C_M_S = 343.2
FOP_HZ = 53_000.0
PULSE_S = 0.1325 / (3980.0 / 2)
"""Width s of the pulse exp(-(t - 2.5 s)^2 / (2 s^2)), whose amplitude spectrum is -3 dB at +-1.99 kHz."""
PEAK_S = 2.5 * PULSE_S
COLUMN_S = 2 * COLUMN_M / C_M_S


@dataclass
class SyntheticImage:
    """As `EchoImage`: newest row last."""

    iq: NDArray[np.complex64]
    envelope: NDArray[np.float32] = field(init=False)
    rows: int = ROWS

    def __post_init__(self) -> None:
        self.iq = np.ascontiguousarray(self.iq, dtype=np.complex64)
        self.envelope = np.abs(self.iq)


@dataclass(frozen=True)
class Reflector:
    """Range now and how it came about: r(t) = range_m - closing t + accel t^2 / 2, t <= 0 before the newest row."""

    range_m: float
    closing_m_s: float = 0.0
    accel_m_s2: float = 0.0
    amplitude: float = 1.0
    rows: int = ROWS

    def ranges_m(self) -> NDArray[np.float64]:
        """(ROWS,) oldest first; NaN before it appeared."""
        t = -CYCLE_S * np.arange(ROWS - 1, -1, -1)
        r = self.range_m - self.closing_m_s * t + 0.5 * self.accel_m_s2 * t * t
        r[: ROWS - self.rows] = np.nan
        return r


def echoes(reflectors: list[Reflector], path_extra_m: float = 0.0) -> NDArray[np.complex128]:
    """(ROWS, COLUMNS) noise-free; `path_extra_m` is added to every path (another receiver)."""
    t = np.arange(COLUMNS) * COLUMN_S
    image = np.zeros((ROWS, COLUMNS), dtype=np.complex128)
    for reflector in reflectors:
        tau = (2 * reflector.ranges_m() + path_extra_m) / C_M_S
        pulse = np.exp(-((t[None, :] - tau[:, None] - PEAK_S) ** 2) / (2 * PULSE_S**2))
        image += np.nan_to_num(reflector.amplitude * pulse * np.exp(-2j * np.pi * FOP_HZ * tau[:, None]))
    return image


def noise(rng: np.random.Generator) -> NDArray[np.complex128]:
    """(ROWS, COLUMNS) complex Gaussian of unit RMS, coloured along range by the receiver band, white down the rows."""
    half = 24
    kernel = np.exp(-((np.arange(-half, half + 1) * COLUMN_S) ** 2) / (2 * PULSE_S**2))
    kernel /= np.sqrt(np.sum(kernel**2))
    shape = (ROWS, COLUMNS + 2 * half)
    white = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    return np.stack([np.convolve(row, kernel, mode="valid") for row in white])


def image(
    reflectors: list[Reflector], psnr_db: float, rng: np.random.Generator, path_extra_m: float = 0.0,
    scale: float = 0.2,
) -> SyntheticImage:
    """Echoes plus noise whose RMS is `psnr_db` under a peak of amplitude 1; `scale` is that peak over full scale."""
    clean = echoes(reflectors, path_extra_m)
    return SyntheticImage(scale * (clean + 10 ** (-psnr_db / 20) * noise(rng)))


def draw_reflector(rng: np.random.Generator) -> Reflector:
    """One obstacle as a flight sees it: 0.3..1.5 m, -0.2..2 m/s closing, mostly small accelerations."""
    return Reflector(rng.uniform(0.3, 1.5), rng.uniform(-0.2, 2.0), rng.uniform(-0.8, 0.8))
