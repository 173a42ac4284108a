"""All denoisers on all common sets, finished set by finished set, so that an interruption leaves what was measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser
from saranga.evaluation import intervals
from saranga.evaluation.answering import Answers, answers, warm_up
from saranga.evaluation.calibration import equal_rate_threshold
from saranga.evaluation.detections import HIT_M, detect, f1, matched, truth_of
from saranga.evaluation.intervals import NONE, Interval
from saranga.evaluation.measures import NAN, SetScore, score_rows
from saranga.evaluation.sets import KINDS, PSNRS_DB, SEED, PairSet, common_sets, pair_set

CALIBRATION_SEED_STEP = 1
"""Thresholds are calibrated on other frames than false alarms are counted on."""
NOISE_FRAMES_AN_IMAGE = 2
MIX_FRAMES_AN_IMAGE = 2
EXAMPLES_DB = (10.0, 0.0, -4.9)
EXAMPLES_EACH = 2


@dataclass
class MethodResult:
    """Of one denoiser; what is not measured yet is NaN, None or absent. `points` by set, then PSNR."""

    threshold: float
    edge_offset_m: float
    equal_threshold: float | None = None
    equal_false_alarms_per_frame: float = NAN
    false_alarms_per_frame: float = NAN
    false_alarms_interval: Interval = NONE
    f1: float = NAN
    f1_interval: Interval = NONE
    f1_within_5cm: float = NAN
    f1_within_5cm_interval: Interval = NONE
    points: dict[str, dict[float, SetScore]] = field(default_factory=dict)
    errors_m: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    seconds: list[NDArray[np.float64]] = field(default_factory=list)


@dataclass
class Comparison:
    """`run` fills `results`; `images` scenes a point, twice as many for noise, calibration and F1."""

    denoisers: Mapping[str, Denoiser]
    images: int = 200
    psnrs_db: Sequence[float] = PSNRS_DB
    kinds: Sequence[str] = KINDS
    seed: int = SEED
    results: dict[str, MethodResult] = field(default_factory=dict)
    finished: list[PairSet] = field(default_factory=list)
    psnr_image_db: dict[str, dict[float, float]] = field(default_factory=dict)
    examples: list[dict[str, Any]] = field(default_factory=list)

    def sets(self) -> tuple[list[PairSet], list[PairSet], list[PairSet]]:
        """Calibration sets, false alarms and F1, and the points."""
        noise, other = NOISE_FRAMES_AN_IMAGE * self.images, self.seed + CALIBRATION_SEED_STEP
        return ([pair_set("noise", noise, seed=other), pair_set("clutter", noise, seed=other)],
                [pair_set("noise", noise, seed=self.seed),
                 pair_set("mix", MIX_FRAMES_AN_IMAGE * self.images, seed=self.seed)],
                common_sets(self.images, self.psnrs_db, self.kinds, self.seed))

    @property
    def frames(self) -> int:
        """Images times denoisers."""
        return len(self.denoisers) * sum(pairs.frames for part in self.sets() for pairs in part)

    def run(self, done: Callable[[PairSet, int], None] = lambda pairs, frames: None,
            after: Callable[[], None] = lambda: None) -> None:
        """Measure all.

        Args:
            done: told which set, and how many frames times denoisers of it were just done.
            after: called when a set is finished and counted in `results`.
        """
        self.results = {name: MethodResult(d.threshold, d.edge_offset_m) for name, d in self.denoisers.items()}
        for denoiser in self.denoisers.values():
            warm_up(denoiser)
        calibration, common, points = self.sets()
        self._calibrate([(pairs, self._answers(pairs, done)) for pairs in calibration])
        for pairs in common:
            found = self._answers(pairs, done)
            (self._count_false if pairs.kind == "noise" else self._count_f1)(pairs, found)
            self.finished.append(pairs)
            after()
        for pairs in points:
            self._add_point(pairs, self._answers(pairs, done))
            self.finished.append(pairs)
            after()

    def _answers(self, pairs: PairSet, done: Callable[[PairSet, int], None]) -> dict[str, Answers]:
        found = answers(self.denoisers, pairs, lambda frames: done(pairs, frames))
        for name, one in found.items():
            self.results[name].seconds.append(one.seconds)
        return found

    def _calibrate(self, parts: list[tuple[PairSet, dict[str, Answers]]]) -> None:
        for name, result in self.results.items():
            mine = [(found[name].rows[:, 0], truth_of(found[name].truth, -np.inf)) for _, found in parts]
            result.equal_threshold = equal_rate_threshold(mine, result.edge_offset_m)

    def _count_false(self, pairs: PairSet, found: dict[str, Answers]) -> None:
        for name, result in self.results.items():
            rows, truth = found[name].rows[:, 0], truth_of(found[name].truth, -np.inf)
            false = int(detect(rows, truth, result.threshold, result.edge_offset_m).false.sum())
            result.false_alarms_per_frame = false / len(rows)
            result.false_alarms_interval = intervals.poisson(false, len(rows))
            equal = detect(rows, truth, result.equal_threshold or 0.0, result.edge_offset_m).false
            result.equal_false_alarms_per_frame = float(equal.mean())

    def _count_f1(self, pairs: PairSet, found: dict[str, Answers]) -> None:
        for name, result in self.results.items():
            rows, truth = found[name].rows[:, 0], truth_of(found[name].truth, pairs.recipe["label"]["least_snr_db"])
            narrow = matched(rows, truth, result.threshold, result.edge_offset_m)
            wide = matched(rows, truth, result.threshold, result.edge_offset_m, HIT_M)
            result.f1, result.f1_interval = f1(narrow), _f1_interval(narrow)
            result.f1_within_5cm, result.f1_within_5cm_interval = f1(wide), _f1_interval(wide)

    def _add_point(self, pairs: PairSet, found: dict[str, Answers]) -> None:
        assert pairs.psnr_db is not None
        truth = truth_of(next(iter(found.values())).truth, pairs.recipe["label"]["least_snr_db"])
        for name, result in self.results.items():
            one = found[name]
            result.points.setdefault(pairs.kind, {})[pairs.psnr_db] = score_rows(
                one, pairs, result.threshold, result.edge_offset_m, result.equal_threshold)
            error = detect(one.rows[:, 0], truth, result.threshold, result.edge_offset_m).error_m
            result.errors_m.setdefault(pairs.kind, []).append(error[~np.isnan(error)])
        gain = next(iter(found.values())).truth
        self.psnr_image_db.setdefault(pairs.kind, {})[pairs.psnr_db] = float(np.median(gain["psnr_image_db"]))
        if pairs.psnr_db in EXAMPLES_DB:
            self._keep_examples(pairs, found, truth.range_m)

    def _keep_examples(self, pairs: PairSet, found: dict[str, Answers], range_m: NDArray[np.float64]) -> None:
        batch = next(pairs.batches(EXAMPLES_EACH))
        for k in range(len(batch.images)):
            self.examples.append({
                "kind": pairs.kind, "psnr_db": pairs.psnr_db, "image": batch.images[k, 0],
                "edges": {name: found[name].rows[k, 0] for name in self.results}, "truth_range_m": range_m[k]})


def _f1_interval(counts: NDArray[np.int64]) -> Interval:
    return intervals.bootstrap(len(counts), lambda drawn: f1(counts[drawn]))
