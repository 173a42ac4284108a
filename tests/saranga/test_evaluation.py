"""Measures of `saranga.evaluation` against figures worked out another way."""

from collections.abc import Iterator

import numpy as np
import pytest
from scipy import stats

from saranga.denoise import load_denoiser
from saranga.denoise.peaks import put_peak
from saranga.errors import BenchError, UsageError
from saranga.evaluation import common_sets, equal_rate_threshold, intervals, pair_set, score
from saranga.evaluation.answering import Answers, Nothing, answers
from saranga.evaluation.comparison import Comparison
from saranga.evaluation.detections import Truth, detect, f1, matched, truth_of
from saranga.evaluation.measures import score_rows
from saranga.evaluation.pictures import compensated, mse, ssim
from saranga.evaluation.positions import apparent_azimuth, locate
from saranga.evaluation.sets import QUADRATURE_DB, PairSet
from saranga.resample import COLUMN_M
from saranga.sonar_geometry import load_sonar


def row(*peaks: tuple[float, float]) -> np.ndarray:
    """Edges (range m, strength)."""
    made = np.zeros(512, np.float32)
    for range_m, strength in peaks:
        put_peak(made, range_m / COLUMN_M, strength)
    return made


def truth(*ranges_m: float, sought: tuple[bool, ...] | None = None) -> Truth:
    padded = np.full((1, 4), np.nan)
    padded[0, :len(ranges_m)] = ranges_m
    wanted = ~np.isnan(padded)
    if sought is not None:
        wanted[0, :len(sought)] = sought
    return Truth(padded, wanted)


class Knowing:
    """Answers from the truth: edges exactly at the paths, `late_m` behind; one call an image and sensor, in order."""

    name, threshold = "knowing", 0.5

    def __init__(self, pairs: PairSet, late_m: float) -> None:
        self.edge_offset_m = late_m
        self._rows = self._play(pairs)
        next(self._rows)

    def _play(self, pairs: PairSet) -> Iterator[np.ndarray]:
        yield row()  # of the warm-up
        yield row()
        for batch in pairs.batches():
            for k, r in np.ndindex(batch.images.shape[:2]):
                there = batch.truth["kind"][k] >= 0
                yield row(*((p / 2 + self.edge_offset_m, 0.9) for p in batch.truth["path_m"][k, r][there]))

    def __call__(self, image: object) -> np.ndarray:
        return next(self._rows)


def test_hits_false_alarms_and_the_strongest_edge() -> None:
    rows = np.stack([row((0.52, 0.6), (0.90, 0.9)), row((0.31, 0.4)), row((1.0, 0.7), (1.2, 0.8)), row()])
    padded = np.concatenate([truth(*r).range_m for r in ((0.5, 1.2), (0.3,), (0.96, 1.2), (0.7,))])
    sought = ~np.isnan(padded)
    sought[2, 1] = False
    seen = detect(rows, Truth(padded, sought), 0.5, 0.0)
    assert seen.error_m[0, 0] == pytest.approx(0.02, abs=1e-4) and np.isnan(seen.error_m[0, 1])
    assert np.isnan(seen.error_m[1]).all()  # under the threshold
    assert seen.error_m[2, 0] == pytest.approx(0.04, abs=1e-4) and np.isnan(seen.error_m[2, 1])
    assert list(seen.false) == [1, 0, 0, 0]  # the edge at 1.2 m of the third is at an obstacle that is not sought
    assert list(seen.strongest) == [False, True, False, False]
    late = detect(rows, Truth(padded, sought), 0.5, 0.03)
    assert late.error_m[0, 0] == pytest.approx(-0.01, abs=1e-4)


def test_f1_pairs_one_to_one() -> None:
    column = COLUMN_M
    one = truth(0.5, 0.5 + 3 * column, 1.0, sought=(True, True, False))
    rows = row((0.5 + 1.6 * column, 0.9), (0.8, 0.9), (1.0, 0.9))[None]
    assert matched(rows, one, 0.5, 0.0).tolist() == [[1, 1, 1]]  # one edge serves one of two obstacles
    assert f1(matched(rows, one, 0.5, 0.0)) == pytest.approx(0.5)
    apart = row((0.5 + 2.2 * column, 0.9))[None]
    assert matched(apart, truth(0.5), 0.5, 0.0).tolist() == [[0, 1, 1]]
    assert matched(apart, truth(0.5), 0.5, 0.0, 0.05).tolist() == [[1, 0, 0]]
    assert np.isnan(f1(np.zeros((3, 3), np.int64)))


def test_threshold_of_equal_false_alarms() -> None:
    """Of 400 frames with one edge of strength k / 400 each, 4 are over 0.99."""
    noise = np.stack([row((0.8, (k + 0.5) / 400)) for k in range(400)])
    nobody = Truth(np.full((400, 4), np.nan), np.zeros((400, 4), bool))
    assert equal_rate_threshold([(noise, nobody)], 0.0) == pytest.approx(0.98875, abs=1e-4)
    # an obstacle's own edge and the tail behind it do not count, what is before it does
    there = Truth(np.tile([0.7, np.nan, np.nan, np.nan], (400, 1)), np.ones((400, 4), bool))
    assert equal_rate_threshold([(noise, there)], 0.0) < 1e-6
    behind = Truth(np.tile([0.9, np.nan, np.nan, np.nan], (400, 1)), np.ones((400, 4), bool))
    assert equal_rate_threshold([(noise, behind)], 0.0) == pytest.approx(0.98875, abs=1e-4)


def test_intervals() -> None:
    for k, n in ((0, 20), (3, 20), (20, 20), (98, 100)):
        expected = stats.binomtest(k, n).proportion_ci(method="wilson")
        assert intervals.wilson(k, n) == pytest.approx((expected.low, expected.high), abs=1e-9)
    assert intervals.wilson(0, 0) == (0.0, 1.0)
    for k in (0, 1, 12):
        low = stats.chi2.ppf(0.025, 2 * k) / 2 if k else 0.0
        assert intervals.poisson(k, 50) == pytest.approx((low / 50, stats.chi2.ppf(0.975, 2 * k + 2) / 100))
    rng = np.random.default_rng(1)
    inside = [low <= 0.0 <= high for low, high in (intervals.median(rng.standard_normal(41)) for _ in range(1500))]
    assert 0.94 <= np.mean(inside) <= 0.985
    x = rng.standard_normal(400)
    low, high = intervals.bootstrap(400, lambda i: float(x[i].mean()))
    assert (high - low) == pytest.approx(2 * 1.96 * x.std() / 20, rel=0.12) and low < x.mean() < high
    assert np.isnan(intervals.bootstrap(0, lambda i: 1.0)).all() and np.isnan(intervals.median(np.zeros(0))).all()


def test_mse_and_ssim_and_that_nothing_scores_well() -> None:
    label = np.zeros((1, 512), np.float32)
    label[0, 200] = 1.0
    other = np.random.default_rng(2).random((1, 512)).astype(np.float32)
    assert mse(np.zeros_like(label), label)[0] == pytest.approx(1 / 512)
    assert ssim(label, label)[0] == pytest.approx(1.0)
    assert ssim(np.zeros_like(label), label)[0] > 0.97
    w = np.exp(-np.arange(-5, 6) ** 2 / (2 * 1.5**2))
    w /= w.sum()
    each = []
    for c in range(5, 507):  # Wang et al., eq. 13, written out
        x, y = other[0, c - 5:c + 6].astype(float), label[0, c - 5:c + 6].astype(float)
        mx, my = w @ x, w @ y
        cov, vx, vy = w @ ((x - mx) * (y - my)), w @ (x - mx) ** 2, w @ (y - my) ** 2
        each.append((2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    assert ssim(other, label)[0] == pytest.approx(np.mean(each), rel=1e-6)
    moved = compensated(label, 10.4 * COLUMN_M)
    assert np.flatnonzero(moved[0]).tolist() == [190]
    assert np.flatnonzero(compensated(label, -3 * COLUMN_M)[0]).tolist() == [203]


@pytest.mark.parametrize("kind", ["single", "multiple"])
def test_perfect_edges_score_perfectly(kind: str) -> None:
    """Every obstacle hit, nothing false, errors of rounding, at any PSNR; azimuth by geometry alone."""
    pairs = pair_set(kind, 60, -10.0)
    found = score(Knowing(pairs, 0.02), pairs)
    drawn = np.concatenate([b.truth for b in pairs.batches()])
    sought = truth_of(drawn, pairs.recipe["label"]["least_snr_db"]).sought
    assert found.obstacles == sought.sum() and found.images == 60
    if kind == "single":
        assert found.hit_rate == found.hit_rate_strongest == 1.0
        assert found.azimuth["one_to_one"].hits >= 58
        assert found.position_rmse_m < 0.02
        assert found.mse < 3 / 512
    assert found.hit_rate > 0.97 and found.false_alarms_per_frame <= 0.02  # echoes within a pulse may run together
    assert found.median_error_m < 5e-4
    assert found.azimuth["one_to_one"].median_deg < 1.5


@pytest.mark.parametrize("columns", [-1, 0, 1])
def test_azimuth_against_points_placed_by_hand(columns: int) -> None:
    """A point at 1 m and 30 degrees, paths by the cosine law; a column at one sensor is 6.5 mm of the 0.10 m baseline,
    about 4.3 degrees there (perception.md)."""
    there = next(pair_set("single", 1, 10.0).batches()).truth.copy()
    azimuth, r, b = np.radians(30.0), 1.0, 0.10
    left = np.sqrt(r**2 + (b / 2) ** 2 + r * b * np.sin(azimuth))
    right = np.sqrt(r**2 + (b / 2) ** 2 - r * b * np.sin(azimuth))
    there["azimuth_rad"][0, 0], there["elevation_rad"][0, 0], there["range_m"][0, 0] = azimuth, 0.0, r
    rows = np.stack([row((left, 0.9)), row(((left + right) / 2 + columns * COLUMN_M, 0.9))])[None]
    found = locate(rows, there, truth_of(there, -100.0), 0.5, 0.0, load_sonar("pair"))
    expected = np.degrees(np.arcsin(0.5 - columns * 2 * COLUMN_M / b)) - 30.0
    assert found.azimuth_error_deg == pytest.approx([expected], abs=0.15)
    assert abs(expected) == pytest.approx(4.3 * abs(columns), abs=0.2)
    assert found.position_error_m[0] == pytest.approx(abs(np.radians(expected)), abs=0.006)


def test_nothing_is_told_from_something_by_everything_but_mse_and_ssim() -> None:
    pairs = pair_set("single", 50, 5.0)
    nothing = score(Nothing(), pairs)
    tbd = score(load_denoiser("tbd"), pairs)
    assert (nothing.hit_rate, nothing.hit_rate_strongest, nothing.false_alarms_per_frame) == (0.0, 0.0, 0.0)
    assert np.isnan(nothing.rmse_m) and nothing.ssim > 0.97 and nothing.mse < tbd.mse
    drawn = np.concatenate([b.truth for b in pairs.batches()])
    r, az = drawn["range_m"][:, 0].astype(float), apparent_azimuth(drawn)[:, 0]
    guess = np.sqrt(np.mean((r * np.cos(az) - 0.9) ** 2 + (r * np.sin(az)) ** 2))
    assert nothing.position_rmse_m == pytest.approx(guess, rel=1e-6)
    assert tbd.position_rmse_m < guess


def test_psnr_means_what_it_says() -> None:
    """Power at the echo's peak in the newest row, less that of noise, over the mean |IQ|^2 of noise far from it; over
    the mean square of one quadrature 3.01 dB more."""
    batches = list(pair_set("constant", 384, 6.0).batches())
    iq = np.concatenate([batch.iq[:, 0, -1] for batch in batches if batch.iq is not None])
    drawn = np.concatenate([batch.truth for batch in batches])
    iq /= drawn["noise_rms"][:, None]
    columns = drawn["path_m"][:, 0, 0] / 2 / COLUMN_M
    noise = np.concatenate([iq[columns > 250, 10:200].ravel(), iq[columns < 250, 330:].ravel()])
    power = np.mean(np.abs(noise) ** 2)
    peak_columns = 2.5 * 66.6e-6 * 343.2 / 2 / COLUMN_M
    peak = np.mean(np.abs(iq[np.arange(384), np.rint(columns + peak_columns).astype(int)]) ** 2) - power
    assert 10 * np.log10(peak / power) == pytest.approx(6.0, abs=0.5)
    assert 10 * np.log10(peak / np.mean(noise.real**2)) == pytest.approx(6.0 + QUADRATURE_DB, abs=0.5)
    assert pytest.approx(3.0103, abs=1e-4) == QUADRATURE_DB


def test_sets_are_common_and_differ_only_in_psnr() -> None:
    sets = common_sets(5, (10.0, 0.0), ("single",))
    assert [(s.kind, s.psnr_db, s.frames) for s in sets] == [("single", 10.0, 10), ("single", 0.0, 10)]
    a, b, again = (next(s.batches()) for s in (*sets, sets[0]))
    assert np.array_equal(a.images, again.images)
    assert np.array_equal(a.truth["path_m"], b.truth["path_m"]) and not np.array_equal(a.images, b.images)
    with pytest.raises(UsageError, match="did you mean 'constant'"):
        pair_set("constnat", 5)
    with pytest.raises(UsageError, match=r"outside -30\.\.60 dB"):
        pair_set("single", 5, 90.0)


def test_track_before_detect_is_where_the_prototype_was() -> None:
    """perception.md, one set of constant reflectors: strongest edge within 5 cm 1.00 / .96 / .61 at 10 / 5 / 0 dB."""
    tbd = load_denoiser("tbd")
    for psnr_db, least, most in ((10.0, 0.97, 1.0), (5.0, 0.88, 1.0), (0.0, 0.45, 0.8)):
        found = score(tbd, pair_set("constant", 150, psnr_db))
        assert least <= found.hit_rate_strongest <= most
        assert found.hit_rate <= found.hit_rate_strongest + 0.02


def test_a_denoiser_that_answers_rubbish_is_named() -> None:
    class Broken(Nothing):
        def __init__(self, answer: np.ndarray) -> None:
            self._answer = answer

        def __call__(self, image: object) -> np.ndarray:
            return self._answer

    pairs = pair_set("noise", 2)
    with pytest.raises(BenchError, match="'nothing' answered with values that are not finite"):
        score(Broken(np.full(512, np.nan, np.float32)), pairs)
    with pytest.raises(BenchError, match=r"answered with shape \(511,\)"):
        score(Broken(np.zeros(511, np.float32)), pairs)


def test_rows_made_in_batches_score_as_calls_do() -> None:
    pairs = pair_set("single", 20, 10.0)
    gaussian = load_denoiser("gaussian")
    one = answers({"gaussian": gaussian}, pairs)["gaussian"]
    batched = Answers(one.rows.copy(), np.zeros(0), one.truth, one.labels)
    assert score_rows(batched, pairs, gaussian.threshold, gaussian.edge_offset_m) == score(gaussian, pairs)


def test_comparison_is_paired_and_keeps_what_is_finished() -> None:
    comparison = Comparison({"gaussian": load_denoiser("gaussian"), "again": load_denoiser("gaussian")}, 12,
                            (15.0, 0.0), ("constant",))
    counted = []

    def stop_at_the_last(pairs: PairSet, frames: int) -> None:
        counted.append(frames)
        if pairs.psnr_db == 0.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        comparison.run(stop_at_the_last)
    assert [(p.kind, p.psnr_db) for p in comparison.finished] == [("noise", None), ("mix", None), ("constant", 15.0)]
    first, second = comparison.results["gaussian"], comparison.results["again"]
    assert first.points == second.points and first.f1 == second.f1 and first.equal_threshold == second.equal_threshold
    assert list(first.points["constant"]) == [15.0] and first.points["constant"][15.0].hit_rate > 0.7
    assert sum(counted) == comparison.frames
