"""Noise to add to echoes: complex rows read at a random row, offset and phase.

Fresh Gaussian numbers would take 95 % of the time (perception.md), a bank takes 3 us an image. Rows are periodic, so
that they can be read around from any column. A bank has groups: bands of modelled noise or files of recorded noise;
an image keeps to one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from saranga.pulse import pulse_sigma_s
from saranga.resample import COLUMN_M, RANGE_COLUMNS
from saranga.synthesis.records import RECEIVE_ONLY, read_rows, recorded_span

FADE_COLUMNS = 16
LEAST_COLUMNS = 128
LEAST_ROWS = 8
BANK_SEED = 53_000
BANK_UNIT = 1.0 / 1024.0
"""Step of the stored noise over its RMS: reaches to 32 times the RMS and adds 1e-7 of its power."""


@dataclass(frozen=True, eq=False)
class NoiseBank:
    """Mean |x|^2 = 1 in every group.

    Attributes:
        re, im: int16 (K, P) in BANK_UNIT, seamless when read around. Half the memory to read, half the time.
        starts: (G + 1,) first row of each group, and K.
        banded: groups are the bandwidths of the recipe, in its order; else an image draws any group.
        source: what it was made from, for provenance.
    """

    re: NDArray[np.int16]
    im: NDArray[np.int16]
    starts: NDArray[np.int64]
    banded: bool
    source: tuple[str, ...]


def modelled_bank(bandwidths_hz: Sequence[float], rows: int, c_m_s: float) -> NoiseBank:
    """Complex Gaussian with the power spectrum of the receiver, `saranga.pulse`, one group a bandwidth.

    The autocorrelation along range is exp(-t^2 / (4 s^2)). An infinite bandwidth gives white rows. Always the same
    numbers for the same arguments.
    """
    rng = np.random.Generator(np.random.Philox(BANK_SEED))
    frequency_hz = np.fft.fftfreq(RANGE_COLUMNS, 2.0 * COLUMN_M / c_m_s)
    groups = []
    for bandwidth_hz in bandwidths_hz:
        shape = np.ones(RANGE_COLUMNS)
        if math.isfinite(bandwidth_hz):
            shape = np.exp(-2.0 * (math.pi * frequency_hz * pulse_sigma_s(bandwidth_hz)) ** 2)
        white = rng.standard_normal((rows, RANGE_COLUMNS, 2), dtype=np.float32).view(np.complex64)[..., 0]
        groups.append(np.fft.ifft(np.fft.fft(white, axis=1) * shape.astype(np.float32), axis=1).astype(np.complex64))
    return _assemble(groups, True, tuple(f"modelled, {b:g} Hz" for b in bandwidths_hz))


def recorded_bank(paths: Sequence[Path], c_m_s: float) -> NoiseBank:
    """Noise of receive-only recordings (`records.read_rows`), one group a file.

    Each row's end is faded into its beginning over FADE_COLUMNS (in power), which makes it seamless. Records shorter
    than the grid come round again within a row.

    Raises:
        UsageError: an unreadable file, or one with fewer than LEAST_ROWS rows or LEAST_COLUMNS recorded columns.
    """
    if not paths:
        raise UsageError("no noise files: give at least one receive-only recording")
    groups = []
    for path in paths:
        rows = read_rows(path, RECEIVE_ONLY, c_m_s)
        first, last = recorded_span(rows)
        rows = rows[np.any(rows != 0, axis=1), first:last]
        if len(rows) < LEAST_ROWS or last - first < LEAST_COLUMNS:
            raise UsageError(f"{path}: {len(rows)} rows of {last - first} columns with noise: at least {LEAST_ROWS} "
                             f"rows of {LEAST_COLUMNS} columns are needed; record longer")
        groups.append(rows)
    period = min(group.shape[1] for group in groups) - FADE_COLUMNS
    ramp = (np.arange(FADE_COLUMNS) + 0.5) / FADE_COLUMNS
    seamless = []
    for group in groups:
        rows = group[:, :period].astype(np.complex64)
        rows[:, :FADE_COLUMNS] = (np.sqrt(ramp) * rows[:, :FADE_COLUMNS]
                                  + np.sqrt(1.0 - ramp) * group[:, period:period + FADE_COLUMNS])
        seamless.append(rows)
    return _assemble(seamless, False, tuple(str(path) for path in paths))


def _assemble(groups: list[NDArray[np.complex64]], banded: bool, source: tuple[str, ...]) -> NoiseBank:
    level = [group / np.sqrt(np.mean(np.abs(group) ** 2, dtype=np.float64)) for group in groups]
    rows = np.concatenate(level)
    starts = np.concatenate([[0], np.cumsum([len(group) for group in groups])]).astype(np.int64)
    return NoiseBank(_stored(rows.real), _stored(rows.imag), starts, banded, source)


def _stored(values: NDArray[np.floating[Any]]) -> NDArray[np.int16]:
    return np.clip(np.rint(values / BANK_UNIT), -32767, 32767).astype(np.int16)
