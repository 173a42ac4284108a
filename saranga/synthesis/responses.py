"""Echo responses R: what one reflection looks like, tabulated so that a delay may be any part of a column.

R has its leading edge at 0 and a peak of magnitude 1. For the modelled pulse (`saranga.pulse`) the leading edge is
its beginning, where it has 0.044 of its peak. In a recording that place drowns in noise, so it is found from where
the rise passes half the peak: an ideal pulse of the same bandwidth does so 1.32 s after its beginning.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from saranga.pulse import PEAK_DELAY_SIGMAS, pulse, pulse_sigma_s
from saranga.resample import COLUMN_M, RANGE_COLUMNS
from saranga.synthesis.records import TRANSMIT_RECEIVE, read_rows

PHASES = 32
"""Steps of a column; the nearest is taken, which errs by at most 2.7e-3 of the peak at 4 kHz. More steps, or floats,
and the tables no longer stay in a core's cache, which costs a third of the speed."""
RESPONSE_UNIT = 1.0 / 32767.0
NEGLIGIBLE = 3e-4
HALF_RISE_SIGMAS = PEAK_DELAY_SIGMAS - math.sqrt(2.0 * math.log(2.0))
BEFORE_SIGMAS, AFTER_SIGMAS = 1.5, 6.5
"""Where a modelled pulse is cut, from its beginning: 4 s either side of its peak, 3e-4 of it."""
RECORDED_TAIL_M = 0.15
OVERSAMPLING = 16
BLANK_M = 0.15


@dataclass(frozen=True, eq=False)
class Responses:
    """All shapes of R, band by band.

    Attributes:
        re, im: int16 (bands * names, PHASES, T) in RESPONSE_UNIT; entry [v, q, j] is R at j - lead - q / PHASES
            columns.
        lead: columns before the leading edge.
        size: |R|, like re and im.
        rise: (bands * names,) columns from the leading edge to where |R| first reaches `merge_level`.
        extent: (bands * names, 2) first and past-the-last entry of T worth adding, over NEGLIGIBLE.
        names: of the responses; variant v is band v // len(names), response v % len(names).
    """

    re: NDArray[np.int16]
    im: NDArray[np.int16]
    size: NDArray[np.int16]
    lead: int
    rise: NDArray[np.float64]
    extent: NDArray[np.int64]
    names: tuple[str, ...]


def band_edges_hz(low_hz: float, high_hz: float, bands: int) -> list[float]:
    """Bandwidths of the bands, evenly spaced from low to high; the middle when there is one."""
    return [0.5 * (low_hz + high_hz)] if bands == 1 else list(np.linspace(low_hz, high_hz, bands))


def build_responses(entries: Sequence[dict[str, Any]], bandwidths_hz: Sequence[float], c_m_s: float,
                    merge_level: float, recorded_bandwidth_hz: float) -> Responses:
    """Tabulate the responses of a recipe.

    Raises:
        UsageError: a recorded response in which no echo stands out.
    """
    column_s = 2.0 * COLUMN_M / c_m_s
    widest = pulse_sigma_s(min(*bandwidths_hz, recorded_bandwidth_hz)) / column_s
    tails = [t[0] for e in entries for t in e.get("taps", [])] + [RECORDED_TAIL_M for e in entries if "file" in e]
    lead = math.ceil(BEFORE_SIGMAS * widest) + 1
    taps = lead + math.ceil(AFTER_SIGMAS * widest + max(tails) / COLUMN_M) + 1
    at = np.arange(taps)[None, :] - lead - np.arange(PHASES)[:, None] / PHASES
    recorded = {e["name"]: _recorded(Path(e["file"]).expanduser(), at, c_m_s, recorded_bandwidth_hz)
                for e in entries if "file" in e}
    shapes = [recorded[e["name"]] if "file" in e else _modelled(e["taps"], at * column_s, bandwidth_hz, c_m_s)
              for bandwidth_hz in bandwidths_hz for e in entries]
    rise = np.array([at[np.abs(shape) >= merge_level].min() for shape in shapes])
    table = np.array(shapes)
    return Responses(_stored(table.real), _stored(table.imag), _stored(np.abs(table)), lead, rise,
                     np.array([_extent(shape) for shape in shapes]), tuple(e["name"] for e in entries))


def _modelled(taps: list[list[float]], t_s: NDArray[np.float64], bandwidth_hz: float,
              c_m_s: float) -> NDArray[np.complex128]:
    total = np.zeros(t_s.shape, dtype=np.complex128)
    for range_m, level_db, phase_deg in taps:
        gain = 10.0 ** (level_db / 20.0) * cmath.exp(1j * math.radians(phase_deg))
        total += gain * pulse(t_s - 2.0 * range_m / c_m_s, bandwidth_hz)
    return total / np.abs(total).max()


def _stored(values: NDArray[np.float64]) -> NDArray[np.int16]:
    return np.ascontiguousarray(np.rint(values / RESPONSE_UNIT), dtype=np.int16)


def _extent(shape: NDArray[np.complex128]) -> tuple[int, int]:
    some = np.flatnonzero(np.any(np.abs(shape) > NEGLIGIBLE, axis=0))
    return int(some[0]), int(some[-1]) + 1


def _recorded(path: Path, at: NDArray[np.float64], c_m_s: float, bandwidth_hz: float) -> NDArray[np.complex128]:
    rows = read_rows(path, TRANSMIT_RECEIVE, c_m_s).astype(np.complex128)
    blank = int(BLANK_M / COLUMN_M)
    mean = np.abs(rows).mean(axis=0)
    peak = blank + int(np.argmax(mean[blank:]))
    # Cycles are coherent only up to a slow drift of the phase: turn each so that its peak is real, then average.
    row = (rows * np.exp(-1j * np.angle(rows[:, peak]))[:, None]).mean(axis=0)
    floor = float(np.median(np.abs(row[blank:])))
    if abs(row[peak]) < 5.0 * floor or abs(row[peak]) == 0.0:
        raise UsageError(f"{path}: no echo stands out: its peak is {abs(row[peak]):.3g} of full scale over a median of "
                         f"{floor:.3g}; at least 5 times is needed. Record one obstacle, 1 m ahead, propellers off")
    spectrum = np.fft.fft(row)
    padded = np.zeros(OVERSAMPLING * RANGE_COLUMNS, dtype=np.complex128)
    half = RANGE_COLUMNS // 2
    padded[:half], padded[-half:] = spectrum[:half], spectrum[half:]
    fine = np.fft.ifft(padded) * OVERSAMPLING
    top = int(np.argmax(np.abs(fine[(peak - 4) * OVERSAMPLING:(peak + 5) * OVERSAMPLING])))
    top += (peak - 4) * OVERSAMPLING
    size = np.abs(fine) / abs(fine[top])
    rise = top
    while rise > 0 and size[rise] >= 0.5:
        rise -= 1
    crossing = (rise + (0.5 - size[rise]) / (size[rise + 1] - size[rise])) / OVERSAMPLING
    edge = crossing - HALF_RISE_SIGMAS * pulse_sigma_s(bandwidth_hz) * c_m_s / (2.0 * COLUMN_M)
    grid = np.arange(fine.size) / OVERSAMPLING - edge
    shape = np.interp(at, grid, fine.real) + 1j * np.interp(at, grid, fine.imag)
    ends = np.minimum(at - at.min(), at.max() - at)
    shape *= np.clip(ends / 4.0, 0.0, 1.0)
    return shape / shape.flat[np.argmax(np.abs(shape))]
