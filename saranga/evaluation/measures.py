"""What is measured of one denoiser on one set, with 95 % intervals.

Hit: an edge of the newest row within 5 cm of an obstacle's range. `hit_rate` asks for an edge over the denoiser's own
threshold, since that is what flies; `hit_rate_strongest` takes the strongest edge of the row whatever its strength,
once an image; `hit_rate_equal_false_alarms` is as `hit_rate` at the threshold that raises 0.01 false edges a frame. A
false alarm is an edge over the threshold farther than 5 cm from every obstacle. Errors are of hits; `rmse_m` is
conditional on a hit and says nothing of what was missed.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser
from saranga.evaluation import intervals, pictures
from saranga.evaluation.answering import Answers, answers, warm_up
from saranga.evaluation.detections import Truth, detect, truth_of
from saranga.evaluation.intervals import NONE, Interval
from saranga.evaluation.positions import WIDE_DEG, locate
from saranga.evaluation.sets import PairSet
from saranga.localise import Matching
from saranga.sonar_geometry import load_sonar

NAN = float("nan")


@dataclass(frozen=True)
class AzimuthScore:
    """Median absolute error and share of errors over 10 degrees, of `hits` matched hits."""

    hits: int
    median_deg: float
    median_interval_deg: Interval
    wide_share: float
    wide_interval: Interval


@dataclass(frozen=True)
class SetScore:
    """See the module. NaN where nothing could be measured; `azimuth` by matching, empty for a single sensor."""

    images: int
    obstacles: int
    hit_rate: float
    hit_rate_interval: Interval
    hit_rate_strongest: float
    hit_rate_strongest_interval: Interval
    false_alarms_per_frame: float
    false_alarms_interval: Interval
    median_error_m: float
    median_error_interval_m: Interval
    bias_m: float
    rmse_m: float
    mse: float
    ssim: float
    hit_rate_equal_false_alarms: float = NAN
    hit_rate_equal_false_alarms_interval: Interval = NONE
    position_rmse_m: float = NAN
    position_rmse_interval_m: Interval = NONE
    azimuth: dict[str, AzimuthScore] = field(default_factory=dict)


def score(denoiser: Denoiser, pairs: PairSet) -> SetScore:
    """One denoiser on one set at its own threshold."""
    warm_up(denoiser)
    return score_rows(answers({denoiser.name: denoiser}, pairs)[denoiser.name], pairs, denoiser.threshold,
                      denoiser.edge_offset_m)


def score_rows(found: Answers, pairs: PairSet, threshold: float, offset_m: float,
               equal_threshold: float | None = None) -> SetScore:
    """Edge rows that are there already, for whoever runs a network in batches.

    Args:
        found: rows of the scenes of `pairs`, in order; `rows` (K, R, N).
        pairs: says which echoes are strong enough to be asked for, and which sensors there are.
        threshold, offset_m: of the denoiser.
        equal_threshold: from `equal_rate_threshold`; None leaves that measure out.
    """
    truth = truth_of(found.truth, pairs.recipe["label"]["least_snr_db"])
    rows = found.rows[:, 0]
    seen = detect(rows, truth, threshold, offset_m)
    obstacles, asked = int(truth.sought.sum()), truth.sought.any(axis=1)
    error = seen.error_m[~np.isnan(seen.error_m)]
    strongest = int(seen.strongest[asked].sum())
    false = int(seen.false.sum())
    moved = pictures.compensated(rows, offset_m)
    return SetScore(
        images=len(rows), obstacles=obstacles,
        hit_rate=_rate(error.size, obstacles), hit_rate_interval=intervals.wilson(error.size, obstacles),
        hit_rate_strongest=_rate(strongest, int(asked.sum())),
        hit_rate_strongest_interval=intervals.wilson(strongest, int(asked.sum())),
        false_alarms_per_frame=_rate(false, len(rows)), false_alarms_interval=intervals.poisson(false, len(rows)),
        median_error_m=_median(np.abs(error)), median_error_interval_m=intervals.median(np.abs(error)),
        bias_m=_median(error), rmse_m=float(np.sqrt(np.mean(error**2))) if error.size else NAN,
        mse=float(pictures.mse(moved, found.labels).mean()), ssim=float(pictures.ssim(moved, found.labels).mean()),
        **_equal(rows, truth, equal_threshold, offset_m, obstacles),
        **_located(found, truth, pairs, threshold, offset_m),
    )


def _equal(rows: NDArray[np.float32], truth: Truth, threshold: float | None, offset_m: float,
           obstacles: int) -> dict[str, Any]:
    if threshold is None:
        return {}
    hits = int((~np.isnan(detect(rows, truth, threshold, offset_m).error_m)).sum())
    return {"hit_rate_equal_false_alarms": _rate(hits, obstacles),
            "hit_rate_equal_false_alarms_interval": intervals.wilson(hits, obstacles)}


def _located(found: Answers, truth: Truth, pairs: PairSet, threshold: float, offset_m: float) -> dict[str, Any]:
    if pairs.roles[:2] != ("left", "right"):
        return {}
    geometry = load_sonar(pairs.recipe["recipe"]["sonar"])
    matchings: tuple[Matching, ...] = ("one_to_one", "median")
    places = {m: locate(found.rows[:, :2], found.truth, truth, threshold, offset_m, geometry, m) for m in matchings}
    squared = places["one_to_one"].position_error_m ** 2
    squared = squared[~np.isnan(squared)]
    return {
        "position_rmse_m": float(np.sqrt(squared.mean())) if squared.size else NAN,
        "position_rmse_interval_m": intervals.bootstrap(squared.size, lambda i: float(np.sqrt(squared[i].mean()))),
        "azimuth": {m: _azimuth(np.abs(place.azimuth_error_deg)) for m, place in places.items()},
    }


def _azimuth(error_deg: NDArray[np.float64]) -> AzimuthScore:
    wide = int((error_deg > WIDE_DEG).sum())
    return AzimuthScore(error_deg.size, _median(error_deg), intervals.median(error_deg), _rate(wide, error_deg.size),
                        intervals.wilson(wide, error_deg.size))


def _rate(count: int, of: int) -> float:
    return count / of if of else NAN


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if values.size else NAN
