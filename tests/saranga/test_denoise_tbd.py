"""Track-before-detect held to the figures a prototype reached (perception.md), with Wilson margins."""

from math import sqrt

import numpy as np
import pytest
from synthetic_images import Reflector, SyntheticImage, draw_reflector, echoes, image, noise

from saranga.denoise import load_denoiser
from saranga.denoise.likelihood import TAP_STEP, TAPS, log_likelihood_table, usable_rows, whitened_taps
from saranga.errors import UsageError
from saranga.localise import edges, localise
from saranga.resample import COLUMN_M
from saranga.sonar_geometry import load_sonar

TBD = load_denoiser("tbd")
TOLERANCE_M = 0.05


def wilson_upper(successes: int, trials: int, z: float = 1.96) -> float:
    p = successes / trials
    centre = p + z * z / (2 * trials)
    return (centre + z * sqrt(p * (1 - p) / trials + z * z / (4 * trials**2))) / (1 + z * z / trials)


def detect(picture: SyntheticImage) -> np.ndarray:
    """Ranges of the edges over the threshold."""
    return edges(TBD(picture), TBD.threshold, offset_m=TBD.edge_offset_m)[0] / 2  # type: ignore[arg-type]


def strongest(picture: SyntheticImage) -> float:
    """Range of the strongest edge, over the threshold or not (NaN: none)."""
    row = TBD(picture)  # type: ignore[arg-type]
    return np.argmax(row) * COLUMN_M - TBD.edge_offset_m if row.any() else np.nan


@pytest.mark.parametrize(("psnr_db", "rate"), [(10.0, 0.99), (5.0, 0.96), (0.0, 0.61)])
def test_strongest_edge_of_the_newest_row_is_the_obstacle(psnr_db: float, rate: float) -> None:
    """The prototype's 1.00 / .96 / .61 at 10 / 5 / 0 dB: range walk up to 2 m/s, many with a short history."""
    hits = 0
    for i in range(60):
        rng = np.random.default_rng(i + 5000)
        reflector = draw_reflector(rng)
        hits += abs(strongest(image([reflector], psnr_db, rng)) - reflector.range_m) < TOLERANCE_M
    assert wilson_upper(hits, 60) >= rate


def test_detection_at_the_threshold_in_flight_and_false_edges_beside() -> None:
    """At 5 dB, 0.3-1 m, up to 1 m/s: found, and hardly anything else."""
    hits = false = 0
    for i in range(60):
        rng = np.random.default_rng(i)
        reflector = Reflector(rng.uniform(0.3, 1.0), rng.uniform(0.0, 1.0), rng.uniform(-0.5, 0.5))
        found = np.abs(detect(image([reflector], 5.0, rng)) - reflector.range_m)
        hits += bool(np.any(found < TOLERANCE_M))
        false += int(np.sum(found >= TOLERANCE_M))
    assert hits >= 58
    assert false <= 5


@pytest.mark.parametrize(("psnr_db", "rms_deg"), [(15.0, 1.5), (10.0, 2.5), (5.0, 4.5)])
def test_azimuth_from_two_sensors(psnr_db: float, rms_deg: float) -> None:
    """Pole at a known azimuth: the disparity of left and right edges must be good to a fraction of a column."""
    geometry = load_sonar("pair")
    misses = []
    for i in range(40):
        rng = np.random.default_rng(i)
        azimuth = rng.uniform(-0.7, 0.7)
        r_left, speed = rng.uniform(0.4, 1.0), rng.uniform(0.0, 1.2)
        disparity = geometry.baseline_h_m * np.sin(azimuth)
        reflector = Reflector(r_left, speed)
        paths = [
            2 * detect(image([reflector], psnr_db, rng, path_extra_m=extra)) for extra in (0.0, -disparity)
        ]
        found = [o for o in localise(paths[0], paths[1], None, geometry) if abs(o.range_m - r_left) < 0.1]
        misses += [np.degrees(o.azimuth_rad - azimuth) for o in found]
    assert len(misses) >= 36
    assert np.sqrt(np.median(np.square(misses)) / 0.455) < rms_deg  # median of chi-square(1) is 0.455: robust RMS
    assert abs(np.mean(np.clip(misses, -20, 20))) < rms_deg


def test_hovering_in_front_of_an_obstacle() -> None:
    for i in range(10):
        rng = np.random.default_rng(i)
        assert np.min(np.abs(detect(image([Reflector(0.8)], 5.0, rng)) - 0.8)) < 0.02


@pytest.mark.parametrize(("rows", "psnr_db"), [(4, 17.0), (8, 10.0), (16, 6.0)])
def test_newly_appeared_obstacle(rows: int, psnr_db: float) -> None:
    hits = 0
    for i in range(20):
        reflector = Reflector(0.9, 1.0, rows=rows)
        found = detect(image([reflector], psnr_db, np.random.default_rng(i)))
        hits += bool(np.any(np.abs(found - 0.9) < 0.03))
    assert hits >= 18


def test_a_single_loud_row_is_no_obstacle() -> None:
    rng = np.random.default_rng(1)
    burst = noise(rng)
    burst[30] += 30 * np.exp(-((np.arange(512) - 200) ** 2) / (2 * 3.5**2))
    assert detect(SyntheticImage(burst)).size == 0


def test_an_obstacle_gone_for_half_the_history_raises_nothing() -> None:
    picture = echoes([Reflector(0.5, 0.0)])
    picture[16:] = 0
    assert detect(SyntheticImage(3.0 * picture + noise(np.random.default_rng(2)))).size == 0


def test_three_obstacles_each_found_once() -> None:
    hits = false = 0
    for i in range(20):
        rng = np.random.default_rng(i)
        truth = [Reflector(0.5, 0.9), Reflector(0.85, 0.8, amplitude=0.8), Reflector(1.2, 0.7, amplitude=0.7)]
        found = detect(image(truth, 12.0, rng))
        near = [np.abs(found - t.range_m) < 0.02 for t in truth]
        hits += sum(int(n.sum()) for n in near)
        false += found.size - sum(int(n.sum()) for n in near)
    assert hits >= 58
    assert false <= 3


def test_strong_echo_has_no_ghosts_beside_it() -> None:
    for psnr_db in (25.0, 40.0, 60.0):
        for i in range(10):
            rng = np.random.default_rng(i)
            reflector = draw_reflector(rng)
            found = detect(image([reflector], psnr_db, rng))
            assert found.size == 1 and abs(found[0] - reflector.range_m) < 0.005


def test_log_likelihood_ratio_is_one_on_average_in_noise() -> None:
    """E[exp(LLR)] over Rayleigh noise is 1: the definition of a likelihood ratio."""
    table = log_likelihood_table(1.2).astype(np.float64)
    q = np.arange(table.size) / 16
    assert np.sum(np.exp(table - q)) / 16 == pytest.approx(1.0 + 0.5 * np.exp(table[0]) / 16, rel=1e-3)


def test_filter_is_matched_in_white_noise_and_whitens_coloured_noise() -> None:
    """Against the plain matched filter and against none, in signal to noise ratio at the echo's peak."""
    rng = np.random.default_rng(3)
    white = (rng.standard_normal((32, 512)) + 1j * rng.standard_normal((32, 512))) / np.sqrt(2)
    offsets = (np.arange(TAPS) - TAPS // 2) * TAP_STEP
    pulse_at = np.exp(-(offsets**2) / (2 * 3.52**2))
    impulse = (offsets == 0).astype(float)

    def gain_db(taps: np.ndarray, sample: np.ndarray) -> float:
        kernel = np.zeros(TAPS * TAP_STEP - 1)
        kernel[::TAP_STEP] = taps
        out = np.stack([np.convolve(row, kernel, "valid") for row in sample])
        return 20 * np.log10(abs(np.sum(taps * pulse_at)) / np.sqrt(np.mean(np.abs(out) ** 2)))

    for sample, best in ((white, pulse_at), (noise(rng), impulse)):
        iq = sample.astype(np.complex64)
        taps = whitened_taps(iq, usable_rows(iq, 32), 3.52, 42)
        assert gain_db(taps, sample) >= gain_db(best, sample) - 0.15
        assert gain_db(taps, sample) >= max(gain_db(pulse_at, sample), gain_db(impulse, sample)) - 0.15


@pytest.mark.parametrize("rows", [16, 64])
def test_image_of_another_history_is_refused(rows: int) -> None:
    picture = SyntheticImage(np.ones((rows, 512), dtype=np.complex64))
    with pytest.raises(UsageError, match=rf"images of 32 rows, this one is \({rows}, 512\)"):
        load_denoiser("tbd")(picture)
