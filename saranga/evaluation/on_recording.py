"""Denoisers on a recording: in how many frames is the obstacle where it is known to be, and what else is reported.

Hit: an edge over the threshold within the tolerance of the true range; every other edge is a false alarm, be it of
noise or of something real that nobody has measured. The history is the recording's own, from its first frame on.

A sensor that cancels its ringing leaves the first samples of a record nearly empty (20 of them by default, 0.27 m at
fop/4): the noise begins there with a step, which is a rising edge to any filter. Nothing is evaluated nearer than that.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser, load_denoiser
from saranga.denoise.pulse import RING_DOWN_M, blank_columns
from saranga.errors import UsageError
from saranga.evaluation import intervals
from saranga.evaluation.answering import warm_up
from saranga.evaluation.detections import ranges, strongest_range
from saranga.evaluation.intervals import Interval
from saranga.evaluation.long_image import LongImage, columns_of, images, range_per_sample, stitched_row
from saranga.evaluation.measures import NAN
from saranga.evaluation.recorded import RecordedFrames
from saranga.resample import COLUMN_M, RANGE_COLUMNS

CLEAR_DB = 10.0
MOST_RING_DOWN_M = 0.5
_MEDIAN_OVER_RMS = float(np.sqrt(np.log(2.0)))


@dataclass(frozen=True)
class Consensus:
    """Where the mean envelope over all frames has its peak, beyond the ring-down, and how far it stands out.

    `ring_down_m`: up to where the record is ringing, or empty because the sensor cancels it.
    """

    range_m: float
    peak_over_noise_db: float
    frames: int
    ring_down_m: float


@dataclass(frozen=True)
class RecordingScore:
    """See the module; `false_alarms_per_window` is the rate in 1.66 m, comparable with the synthetic sets;
    `hit_rate_clear` is of the `clear_frames`, where the envelope within the tolerance is CLEAR_DB over the noise."""

    frames: int
    hits: int
    hit_rate: float
    hit_rate_interval: Interval
    hit_rate_strongest: float
    hit_rate_strongest_interval: Interval
    clear_frames: int
    hit_rate_clear: float
    hit_rate_clear_interval: Interval
    false_alarms_per_frame: float
    false_alarms_interval: Interval
    false_alarms_per_window: float
    median_error_m: float
    median_error_interval_m: Interval
    bias_m: float
    ms_per_image: float
    threshold: float
    edge_offset_m: float


def consensus(recorded: RecordedFrames, c_m_s: float, range_per_sample_m: float | None = None,
              ring_down_m: float | None = None) -> Consensus:
    """Peak of the mean |IQ| of the frames that are measurements; noise RMS from the median of every row.

    `ring_down_m` None looks for it: where the mean first reaches half its median, and a sample on; at least the
    denoisers' own, and that too where the first MOST_RING_DOWN_M are all empty.
    """
    rows = [np.abs(image.iq[-1]) for image in images(recorded, c_m_s, range_per_sample_m)]
    mean = np.mean(rows, axis=0)
    if ring_down_m is None:
        measured = mean[mean > 0.0]
        begins_m = int(np.argmax(mean >= 0.5 * np.median(measured))) * COLUMN_M if measured.size else 0.0
        sample_m = range_per_sample_m or range_per_sample(recorded.frames[0], c_m_s)
        ring_down_m = max(RING_DOWN_M, begins_m + sample_m) if begins_m <= MOST_RING_DOWN_M else RING_DOWN_M
    first = blank_columns(ring_down_m)
    peak = first + int(np.argmax(mean[first:]))
    noise = float(np.median([np.median(row[first:][row[first:] > 0.0]) for row in rows if row[first:].any()]))
    over = 20.0 * np.log10(mean[peak] * _MEDIAN_OVER_RMS / noise) if noise > 0.0 else NAN
    return Consensus(peak * COLUMN_M, float(over), len(rows), ring_down_m)


def with_ring_down(name: str, denoiser: Denoiser, ring_down_m: float) -> Denoiser:
    """The same denoiser, blind up to another range: 0 where a window does not begin at the transmitter."""
    try:
        return load_denoiser(name, ring_down_m=ring_down_m)
    except UsageError:  # it has no such option
        return denoiser


def score_recording(denoisers: Mapping[str, Denoiser], recorded: RecordedFrames, truth_m: float, tolerance_m: float,
                    c_m_s: float, range_per_sample_m: float | None = None, ring_down_m: float = RING_DOWN_M,
                    done: Callable[[int, int], None] = lambda frames, of: None,
                    keep: Callable[[str, LongImage, NDArray[np.float32]], None] = lambda name, image, row: None,
                    ) -> dict[str, RecordingScore]:
    """Every denoiser on every frame.

    Args:
        truth_m: range of the obstacle.
        tolerance_m: how far an edge may be from it.
        range_per_sample_m: in place of what carrier, rate and speed of sound give.
        ring_down_m: nothing nearer is evaluated; denoisers that have an option of this name are told.
        done: told after each frame how many of how many are done.
        keep: given every edge row, for pictures.

    Raises:
        UsageError: a true range outside the record, or a tolerance that is not over 0.
    """
    columns = columns_of(recorded, c_m_s, range_per_sample_m)
    check_truth(recorded, truth_m, tolerance_m, columns)
    pairs = {name: (with_ring_down(name, denoiser, ring_down_m), with_ring_down(name, denoiser, 0.0))
             for name, denoiser in denoisers.items()}
    for near, far in pairs.values():
        warm_up(near)
        warm_up(far)
    tallies = {name: _Tally(truth_m, tolerance_m) for name in denoisers}
    total = sum(frame.trigger not in recorded.left_out for frame in recorded.frames)
    for count, image in enumerate(images(recorded, c_m_s, range_per_sample_m), start=1):
        clear = peak_over_noise_db(image, truth_m, tolerance_m, ring_down_m) >= CLEAR_DB
        for name, (near, far) in pairs.items():
            row, seconds = stitched_row(near, far, image)
            row[:blank_columns(ring_down_m)] = 0.0
            tallies[name].add(row, seconds, near, clear)
            keep(name, image, row)
        done(count, total)
    return {name: tallies[name].score(denoiser, columns / RANGE_COLUMNS) for name, denoiser in denoisers.items()}


def peak_over_noise_db(image: LongImage, range_m: float, reach_m: float, ring_down_m: float = RING_DOWN_M) -> float:
    """Highest |IQ| of the newest row within `reach_m` of `range_m`, over the row's noise RMS from its median."""
    row = np.abs(image.iq[-1])
    there = row[blank_columns(ring_down_m):]
    low, high = int((range_m - reach_m) / COLUMN_M), int((range_m + reach_m) / COLUMN_M) + 2
    part = row[max(low, 0):high]
    if part.size == 0 or not (there > 0.0).any():
        return float("-inf")
    noise = float(np.median(there[there > 0.0])) / _MEDIAN_OVER_RMS
    return float(20.0 * np.log10(max(float(part.max()), 1e-12) / noise))


def check_truth(recorded: RecordedFrames, truth_m: float, tolerance_m: float, columns: int) -> None:
    """Raises UsageError for a true range outside the record or a tolerance that makes no sense."""
    record_m = (columns - 1) * COLUMN_M
    if not 0.0 < truth_m <= record_m:
        raise UsageError(f"--truth-m {truth_m:g} m is outside the record of {recorded.path}, 0 to {record_m:.2f} m: "
                         "check it, or --columns-m")
    if not 0.0 < tolerance_m <= record_m:
        raise UsageError(f"--tolerance-m {tolerance_m:g} m: it must be over 0 and at most the record, {record_m:.2f} m")


class _Tally:
    def __init__(self, truth_m: float, tolerance_m: float) -> None:
        self._truth_m, self._tolerance_m = truth_m, tolerance_m
        self._error_m: list[float] = []
        self._false = self._strongest = 0
        self._seconds: list[float] = []
        self._clear = self._clear_hits = 0

    def add(self, row: NDArray[np.float32], seconds: float, denoiser: Denoiser, clear: bool) -> None:
        error = ranges(row, denoiser.threshold, denoiser.edge_offset_m) - self._truth_m
        near = np.abs(error) <= self._tolerance_m
        if near.any():
            self._error_m.append(float(error[np.argmin(np.abs(error))]))
        self._false += int((~near).sum())
        strongest = strongest_range(row, denoiser.edge_offset_m)
        self._strongest += abs(strongest - self._truth_m) <= self._tolerance_m
        self._seconds.append(seconds)
        self._clear += clear
        self._clear_hits += clear and bool(near.any())

    def score(self, denoiser: Denoiser, windows: float) -> RecordingScore:
        error, frames = np.array(self._error_m), len(self._seconds)
        size = np.abs(error)
        return RecordingScore(
            frames=frames, hits=error.size, hit_rate=error.size / frames,
            hit_rate_interval=intervals.wilson(error.size, frames),
            hit_rate_strongest=self._strongest / frames,
            hit_rate_strongest_interval=intervals.wilson(self._strongest, frames),
            clear_frames=self._clear, hit_rate_clear=self._clear_hits / self._clear if self._clear else NAN,
            hit_rate_clear_interval=intervals.wilson(self._clear_hits, self._clear),
            false_alarms_per_frame=self._false / frames,
            false_alarms_interval=intervals.poisson(self._false, frames),
            false_alarms_per_window=self._false / frames / windows,
            median_error_m=float(np.median(size)) if error.size else NAN,
            median_error_interval_m=intervals.median(size),
            bias_m=float(np.median(error)) if error.size else NAN,
            ms_per_image=1e3 * float(np.median(self._seconds)), threshold=denoiser.threshold,
            edge_offset_m=denoiser.edge_offset_m)


def recording_json(recorded: RecordedFrames, scores: Mapping[str, RecordingScore], truth: dict[str, Any],
                   skipped: Mapping[str, str], complete: bool) -> dict[str, Any]:
    """As `--json` prints it, before `report.plain`."""
    from dataclasses import asdict

    return {
        "methods": {name: asdict(score) for name, score in scores.items()}, "skipped": dict(skipped),
        "complete": complete, "truth": truth,
        "recording": {
            "file": str(recorded.path), "role": recorded.role, "frames": len(recorded.frames),
            "evaluated": len(recorded.frames) - len(recorded.left_out), "repeated_left_out": recorded.repeated,
            "before_take_off_left_out": recorded.before_take_off, "lost": recorded.lost,
            "closed_properly": recorded.complete, "losses": recorded.losses,
            "amplitude_only": recorded.amplitude_only, "metadata": recorded.metadata},
    }
