"""How loud the propeller is in the sensor: RMS |IQ| of receive-only records, with what clipping does to it.

The metric is sqrt(mean(I^2 + Q^2)) over the samples after ring-down, in counts; / 20 000 is the paper's unit
(hardware.md, "Noise experiment"). |IQ| of noise is Rayleigh distributed and the sensor ends at A = 20 984 counts, so a
true RMS s reads as s sqrt(1 - exp(-A^2 / s^2)): -0.05 dB at 10 000 counts, -0.21 at 12 000, -0.66 at 15 000. Up to
1 dB this is taken back; beyond, the reading is only a lower bound.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.echo import FULL_SCALE, EchoFrame
from saranga.errors import UsageError

SATURATION_COUNTS = 20_984.0
CLIP_COUNTS = 20_500.0
"""|IQ| from here on counts as clipped."""
MOST_CLIPPING_DB = 1.0
SPECTRUM_BINS = 32
ENDPOINT_SAMPLES = 1
"""Sample 0 reads 0 or metadata, whatever the ring-down."""


def clipping_bias_db(true_rms_counts: float) -> float:
    """What saturation takes from the RMS of Rayleigh noise, dB (not positive); 0 for no noise."""
    if true_rms_counts <= 0.0:
        return 0.0
    return 10.0 * math.log10(-math.expm1(-((SATURATION_COUNTS / true_rms_counts) ** 2)))


def unclipped_rms_counts(read_rms_counts: float) -> float:
    """The RMS that reads as `read_rms_counts` once clipped; infinite where none does (all samples at the end).

    Source: inversion of s^2 (1 - exp(-A^2 / s^2)) = m^2 for a Rayleigh envelope.
    """
    if read_rms_counts <= 0.2 * SATURATION_COUNTS:
        return max(read_rms_counts, 0.0)
    if read_rms_counts >= SATURATION_COUNTS:
        return math.inf
    from scipy.optimize import brentq

    def excess(s: float) -> float:
        return s * s * -math.expm1(-((SATURATION_COUNTS / s) ** 2)) - read_rms_counts**2

    most = 1e4 * SATURATION_COUNTS
    return float(brentq(excess, read_rms_counts, most)) if excess(most) > 0.0 else math.inf


@dataclass(frozen=True)
class NoiseReading:
    """One sensor at one step.

    Attributes:
        rms: RMS |IQ| / 20 000 with the clipping taken back where that is at most 1 dB.
        raw_rms: as read, the paper's figure.
        frames, n: records, and samples in them.
        clipped_share: of the samples, |IQ| >= 20 500.
        clipping_db: what clipping took (not positive).
        lower_bound: clipping took more than 1 dB, so the truth is at least `rms`.
        spectrum: (32,) mean power by baseband frequency from -rate/2, sum 1.
        rate_hz: IQ rate, the width of the spectrum.
        correlation: of fast-time samples at lags 1 to 3.
        frame_spread_db: standard deviation of the records' own RMS, dB.
    """

    rms: float
    raw_rms: float
    frames: int
    n: int
    clipped_share: float
    clipping_db: float
    lower_bound: bool
    spectrum: tuple[float, ...] = ()
    rate_hz: float = 0.0
    correlation: tuple[float, ...] = ()
    frame_spread_db: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; spectra to five digits."""
        return {"rms": self.rms, "raw_rms": self.raw_rms, "n": self.n, "frames": self.frames,
                "clipped_share": self.clipped_share, "clipping_db": self.clipping_db, "lower_bound": self.lower_bound,
                "spectrum": [float(f"{v:.5g}") for v in self.spectrum], "rate_hz": self.rate_hz,
                "correlation": [round(v, 4) for v in self.correlation],
                "frame_spread_db": round(self.frame_spread_db, 4)}


@dataclass
class NoiseMeter:
    """Sums one sensor's records into a `NoiseReading`; holds no records."""

    skip_samples: int = 20
    frames: int = 0
    n: int = 0
    _power: float = 0.0
    _clipped: int = 0
    _spectrum: NDArray[np.float64] = field(default_factory=lambda: np.zeros(SPECTRUM_BINS))
    _lags: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(4, dtype=np.complex128))
    _frame_db: list[float] = field(default_factory=list)
    _rate_hz: float = 0.0

    def add(self, frame: EchoFrame) -> None:
        """Take one receive-only record.

        Raises:
            UsageError: a record of transmit/receive mode, or one with nothing after the ring-down.
        """
        if frame.mode != 1:
            raise UsageError(f"sensor {frame.role}: record {frame.sequence} was made while transmitting: noise needs "
                             "receive-only records; send START with mode 1")
        iq = iq_of(frame, self.skip_samples)
        power = np.abs(iq) ** 2
        total = float(power.sum())
        self.frames += 1
        self.n += iq.size
        self._power += total
        self._clipped += int(np.count_nonzero(power >= CLIP_COUNTS**2))
        self._rate_hz = frame.iq_rate_hz
        self._frame_db.append(10.0 * math.log10(max(total / iq.size, 1e-12)))
        self._spectrum += segment_power(iq)
        for lag in range(min(4, iq.size)):
            self._lags[lag] += np.vdot(iq[:iq.size - lag], iq[lag:])

    def reading(self) -> NoiseReading:
        """What was measured so far.

        Raises:
            UsageError: no record yet.
        """
        if self.n == 0:
            raise UsageError("no noise record came: is the rig in receive-only mode, and the sensor alive?")
        raw = math.sqrt(self._power / self.n)
        true = unclipped_rms_counts(raw) if self._clipped else raw
        bias = 20.0 * math.log10(raw / true) if 0.0 < true < math.inf else (-math.inf if raw else 0.0)
        bounded = bias < -MOST_CLIPPING_DB
        total = float(self._spectrum.sum())
        level = self._lags[0].real
        return NoiseReading(
            rms=(raw if bounded else true) / FULL_SCALE, raw_rms=raw / FULL_SCALE, frames=self.frames, n=self.n,
            clipped_share=self._clipped / self.n, clipping_db=max(bias, -99.0), lower_bound=bounded,
            spectrum=tuple((self._spectrum / total).tolist()) if total > 0.0 else (), rate_hz=self._rate_hz,
            correlation=tuple((np.abs(self._lags[1:]) / level).tolist()) if level > 0.0 else (),
            frame_spread_db=float(np.std(self._frame_db)))


@dataclass
class CoherenceMeter:
    """Magnitude-squared coherence of the noise at two sensors of one trigger, over the band where there is noise.

    0: each hears its own turbulence; 1: both hear the same sound. With K segments independent noise reads about 1 / K.
    """

    skip_samples: int = 20
    segments: int = 0
    _cross: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(SPECTRUM_BINS, dtype=np.complex128))
    _one: NDArray[np.float64] = field(default_factory=lambda: np.zeros(SPECTRUM_BINS))
    _other: NDArray[np.float64] = field(default_factory=lambda: np.zeros(SPECTRUM_BINS))

    def add(self, one: EchoFrame, other: EchoFrame) -> None:
        """Take the records of two sensors of the same trigger; records of different length or rate are left out."""
        a, b = iq_of(one, self.skip_samples), iq_of(other, self.skip_samples)
        if a.size != b.size or one.odr != other.odr:
            return
        fa, fb = _segments(a), _segments(b)
        self.segments += len(fa)
        self._cross += np.sum(fa * fb.conj(), axis=0)
        self._one += np.sum(np.abs(fa) ** 2, axis=0)
        self._other += np.sum(np.abs(fb) ** 2, axis=0)

    def value(self) -> float | None:
        """Power-weighted mean over the band, None before the first pair."""
        weight = np.sqrt(self._one * self._other)
        if self.segments < 2 or not weight.any():
            return None
        strong = weight > 0.05 * weight.max()
        msc = np.abs(self._cross[strong]) ** 2 / (self._one[strong] * self._other[strong])
        return float(np.average(msc, weights=weight[strong]))


def rehearse_metric(samples: int, skip_samples: int) -> None:
    """Compute everything once, clipping included: first calls import and build, and would stall a loop that spins."""
    loud = np.full((samples, 2), 20_000, dtype=np.int16)
    frame = EchoFrame("left", 0, 0, 0, 0, 53_000.0, 6, 1, loud)
    meter, pair = NoiseMeter(skip_samples), CoherenceMeter(skip_samples)
    for _ in range(3):
        meter.add(frame)
        pair.add(frame, frame)
    meter.reading()
    pair.value()
    unclipped_rms_counts(0.7 * SATURATION_COUNTS)


def iq_of(frame: EchoFrame, skip_samples: int) -> NDArray[np.complex128]:
    """I + jQ in counts without the first `skip_samples`.

    Raises:
        UsageError: nothing is left.
    """
    skip = max(skip_samples, ENDPOINT_SAMPLES)
    if len(frame.iq) <= skip:
        raise UsageError(f"sensor {frame.role}: {len(frame.iq)} samples a record, of which {skip} are ring-down: "
                         "configure longer records")
    rest = frame.iq[skip:].astype(np.float64)
    return rest[:, 1] + 1j * rest[:, 0]


def segment_power(iq: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Welch power (32,), Hann windows with half overlap, frequencies from -rate/2 up."""
    power: NDArray[np.float64] = np.sum(np.abs(_segments(iq)) ** 2, axis=0)
    return power


def _segments(iq: NDArray[np.complex128]) -> NDArray[np.complex128]:
    if iq.size < SPECTRUM_BINS:
        iq = np.pad(iq, (0, SPECTRUM_BINS - iq.size))
    windows = np.lib.stride_tricks.sliding_window_view(iq, SPECTRUM_BINS)[::SPECTRUM_BINS // 2]
    return np.fft.fftshift(np.fft.fft(windows * np.hanning(SPECTRUM_BINS), axis=1), axes=1)
