"""Fits, intervals by blocks, insertion loss, comparisons, heights and ranges, on data whose truth is known."""

import math

import numpy as np
import pytest

from bench.procedures.blocks import blocks_needed, bootstrap_blocks, mean_of_blocks
from bench.procedures.fits import (
    Points,
    fit_power_law,
    fit_quadratic,
    interpolated_db,
    joined,
    prediction_error_db,
)
from bench.procedures.heights import optimum_height
from bench.procedures.hover import hover_level, newton
from bench.procedures.insertion_loss import difference, insertion_loss
from bench.procedures.prediction import detection_range_m, psnr_db, thresholds

THRUST = np.linspace(0.4, 4.5, 8)


def blocks(loss_db: float = 0.0, spread_db: float = 0.0, count: int = 3, seed: int = 0, slope: float = 0.0,
           noise_db: float = 0.0) -> dict[int, Points]:
    """Blocks of a power law less a loss, each block mounted with its own error."""
    rng = np.random.default_rng(seed)
    out = {}
    for b in range(count):
        shift = loss_db + spread_db * rng.standard_normal()
        thrust = THRUST * (1 + 0.02 * rng.standard_normal(8))
        level = 0.09 * (thrust / 1.128) ** 1.25 * 10 ** (-(shift + slope * (thrust - 1.128)) / 20)
        level *= 10 ** (noise_db * rng.standard_normal(8) / 20)
        out[b] = Points.of(list(zip(thrust.tolist(), level.tolist(), strict=True)))
    return out


def test_fits_find_the_curves_they_were_made_from() -> None:
    quadratic = Points.of([(t, 0.002 * t * t + 0.03 * t + 0.01) for t in THRUST])
    assert fit_quadratic(quadratic).coefficients == pytest.approx((0.002, 0.03, 0.01))
    assert fit_power_law(joined(list(blocks().values()))).coefficients[1] == pytest.approx(1.25, abs=1e-9)
    with pytest.raises(ValueError, match="three different"):
        fit_quadratic(Points.of([(1.0, 0.1), (2.0, 0.2)]))
    law = list(blocks(noise_db=0.2, seed=4).values())
    assert prediction_error_db("power_law", law) < prediction_error_db("quadratic", law)
    assert prediction_error_db("power_law", law[:1]) is None


def test_interpolation_never_leaves_the_measured_thrusts() -> None:
    points = Points.of([(1.0, 0.1), (4.0, 0.4), (2.0, 0.2), (math.nan, 0.3), (3.0, 0.0)])
    assert len(points) == 3
    at = interpolated_db(points, np.array([0.5, 1.0, math.sqrt(2.0), 4.1]))
    assert np.isnan(at[[0, 3]]).all()
    assert at[1:3] == pytest.approx([-20.0, 20 * math.log10(0.1 * math.sqrt(2.0))])


def test_a_single_block_has_a_value_and_no_interval() -> None:
    one = mean_of_blocks([12.0])
    assert one.value == 12.0
    assert one.interval is None
    assert not one.excludes_zero
    with pytest.raises(ValueError, match="finite"):
        mean_of_blocks([1.0, math.nan])


def test_the_bootstrap_of_a_mean_is_students_interval() -> None:
    values = [11.2, 12.9, 12.1]
    boot, student = bootstrap_blocks(values, lambda v: float(np.mean(v))), mean_of_blocks(values)
    assert (boot.low, boot.high) == (pytest.approx(student.low), pytest.approx(student.high))


def test_intervals_of_three_blocks_cover_at_the_nominal_rate() -> None:
    rng = np.random.default_rng(11)
    runs = 4000
    hits = sum(e.low <= 0.0 <= e.high for e in (mean_of_blocks(rng.standard_normal(3).tolist()) for _ in range(runs))
               if e.low is not None and e.high is not None)
    assert abs(hits / runs - 0.95) < 4 * math.sqrt(0.95 * 0.05 / runs)


def test_insertion_loss_is_taken_at_equal_thrust() -> None:
    loss = insertion_loss("foam", blocks(seed=1), blocks(12.0, seed=2), newton(0.115))
    assert loss is not None
    assert loss.overall.value == pytest.approx(12.0, abs=0.05)
    assert loss.at_target is not None
    assert loss.at_target.value == pytest.approx(12.0, abs=0.05)
    sloped = insertion_loss("foam", blocks(seed=1), blocks(12.0, slope=1.0, seed=2), newton(0.3))
    assert sloped is not None and sloped.at_target is not None
    assert sloped.at_target.value == pytest.approx(12.0 + newton(0.3) - 1.128, abs=0.05)
    beyond = insertion_loss("foam", blocks(), blocks(12.0), newton(0.9))
    assert beyond is not None
    assert beyond.at_target is None
    assert insertion_loss("foam", blocks(), {}) is None


def test_what_cannot_be_told_apart_is_said_so_and_what_can_is_too() -> None:
    far = difference("foam", "plastic", blocks(15.0, 0.2, seed=1), blocks(10.0, 0.2, seed=2))
    assert far is not None and far.answer == "quieter"
    assert far.estimate.value == pytest.approx(5.0, abs=0.6)
    near = difference("foam", "plastic", blocks(12.0, 0.8, seed=3), blocks(12.5, 0.8, seed=4))
    assert near is not None and near.answer == "cannot distinguish"
    assert near.blocks_needed is not None and near.blocks_needed > 3
    assert "cannot distinguish foam from plastic" in near.sentence
    same = difference("foam", "plastic", blocks(12.0, 0.02, seed=5), blocks(12.1, 0.02, seed=6))
    assert same is not None and same.answer == "equal"
    one = difference("foam", "plastic", blocks(12.0, count=1), blocks(6.0, count=1))
    assert one is not None and one.answer == "cannot distinguish"
    assert blocks_needed(0.5, 1.0) == 4


def test_the_optimum_height_is_the_lowest_that_no_higher_one_betters() -> None:
    law = {0.025: 7.0, 0.045: 11.0, 0.0635: 14.0, 0.080: 14.2, 0.100: 14.3}
    answer = optimum_height({h: blocks(loss, 0.1, seed=k) for k, (h, loss) in enumerate(law.items())})
    assert answer.optimum_m == 0.0635
    assert answer.by_height[0.025] == answer.by_height[0.045] == "too low"
    assert "63.5 mm is the lowest" in answer.sentence
    vague = optimum_height({h: blocks(loss, 3.0, seed=k) for k, (h, loss) in enumerate(law.items())})
    assert vague.optimum_m is None
    assert "no height of the sweep is shown to be enough" in vague.sentence


def test_hover_is_reported_where_it_was_measured_and_never_extrapolated() -> None:
    level = hover_level(blocks(), 0.115)
    assert level.rms == pytest.approx(0.09, rel=0.01)
    outside = hover_level(blocks(), 0.60)
    assert outside.rms is None
    assert "0.6 kgf lies outside" in outside.why


def test_predicted_ranges_follow_the_sonar_equation() -> None:
    assert psnr_db("60 mm pole", 1.0, 0.0) == pytest.approx(-4.9)
    assert detection_range_m("60 mm pole", 0.0, -4.9) == pytest.approx(1.0, abs=1e-6)
    # acoustics.md, "Shield": going from 1 m to 2 m needs about 12.5 dB for the pole, 9.5 for a flat target.
    assert detection_range_m("60 mm pole", 12.5, -4.9) == pytest.approx(2.0, abs=0.08)
    need = psnr_db("flat", 1.0, 0.0) - psnr_db("flat", 2.0, 0.0)
    assert need == pytest.approx(9.5, abs=0.5)
    assert detection_range_m("25 mm pole", -60.0, 0.0) == 0.1
    assert {t.name for t in thresholds()} == {"as in the paper", "shipped network, 9 of 10 images"}
    assert 0.0 < thresholds()[1].psnr_db < 10.0
