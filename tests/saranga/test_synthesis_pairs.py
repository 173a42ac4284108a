"""What pairs are like as a whole: levels, noise, labels, distributions, determinism."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.stats import kstest
from synthesis_helpers import (
    COLUMN_M,
    PEAK_COLUMNS,
    SIGMA_S,
    default_batch,
    draw,
    only,
    path,
    pulse_at,
    synthesiser,
)

from saranga.synthesis import KINDS, PATHS, Synthesiser

NO_ECHO = {"obstacles.count_weights": [1, 0, 0, 0, 0]}


@pytest.mark.parametrize(("psnr_db", "speckle"), [(-4.9, 0), (5.0, 0), (15.0, 0), (5.0, 1)])
def test_psnr_is_as_drawn(psnr_db, speckle):
    """Measured as anybody would: the mean peak over the RMS |IQ| of columns far from it, standing still."""
    made = synthesiser(only("cylinder") | {"noise.psnr_db": [psnr_db, psnr_db], "noise.level_counts": [500, 4000],
                                           "noise.speckle_probability": speckle, "motion.sway_m": [0, 0]}
                        | path("hover"), roles=("left",))
    batches = (made.batch(k, 100, iq=True) for k in range(0, 500, 100))
    peaks, powers = [], []
    for truth, rows in ((t, rows) for b in batches for t, rows in zip(b.truth, b.iq[:, 0].copy(), strict=True)):
        way = float(truth["path_m"][0, 0])
        column = round(way / (2 * COLUMN_M) + PEAK_COLUMNS)
        shape = pulse_at(np.array([column - way / (2 * COLUMN_M)]))[0]
        echo = rows[:, column] * np.exp(2j * np.pi * 53_000.0 * way / synth_c()) / shape
        far = np.abs(np.arange(512) - column) > 40
        peaks.append(echo.real.mean() / truth["noise_rms"])
        powers.append(np.mean(np.abs(rows[:, far]) ** 2) / truth["noise_rms"] ** 2)
        assert truth["psnr_db"] == pytest.approx(psnr_db, abs=1e-4)
    assert 20 * np.log10(np.mean(peaks)) - 10 * np.log10(np.mean(powers)) == pytest.approx(psnr_db, abs=0.2)


def truth_of(made: Synthesiser, count: int) -> np.ndarray:
    return np.concatenate([made.batch(k, 100).truth for k in range(0, count, 100)])


def synth_c() -> float:
    return 331.3 * float(np.sqrt(1.0 + 20.0 / 273.15))


def test_both_psnr_conventions():
    """Of a plane flown away from, the newest echo is the weakest; "image" gives the drawn PSNR to the strongest."""
    values = only("plane") | path("straight") | {"motion.closing_m_s": [-1.0, -1.0], "motion.sideways_m_s": [0, 0],
                                                 "motion.acceleration_m_s2": [0, 0], "obstacles.range_m": [1.0, 1.4]}
    newest, image = (draw(values | {"noise.psnr_reference": name}, 20) for name in ("newest", "image"))
    assert np.allclose(newest.truth["psnr_db"], 60, atol=1e-3)
    assert np.allclose(image.truth["psnr_image_db"], 60, atol=1e-3)
    assert (newest.truth["psnr_image_db"] > 63).all() and (image.truth["psnr_db"] < 57).all()
    assert np.allclose(newest.truth["psnr_image_db"] - newest.truth["psnr_db"],
                       image.truth["psnr_image_db"] - image.truth["psnr_db"], atol=1e-3)


@pytest.mark.parametrize("speckle", [0, 1])
def test_noise_alone_is_rayleigh_and_of_the_drawn_level(speckle):
    batch = draw(NO_ECHO | {"noise.speckle_probability": speckle, "noise.level_counts": [2000, 2000]}, 100)
    assert batch.images.mean() / np.sqrt(np.mean(batch.images**2)) == pytest.approx(0.886, abs=0.003)
    assert np.sqrt(np.mean(batch.images**2)) == pytest.approx(0.1, rel=0.01)
    assert abs(batch.iq.mean()) < 0.001 and (batch.labels == 0).all()
    assert (batch.truth["noise_model"] == speckle).all() and (batch.truth["psnr_db"] == -99).all()


@pytest.mark.parametrize("bandwidth_hz", [2200.0, 3980.0])
def test_noise_has_the_colour_of_the_receiver_along_range_and_none_down_the_rows(bandwidth_hz):
    iq = draw(NO_ECHO | {"echo.bandwidth_hz": [bandwidth_hz] * 2}, 100).iq
    power = np.mean(np.abs(iq) ** 2)
    for lag in (2, 5, 8):
        t = lag * 2 * COLUMN_M / synth_c()
        measured = np.mean(iq[..., lag:] * iq[..., :-lag].conj()) / power
        sigma = SIGMA_S * 3980.0 / bandwidth_hz
        assert measured == pytest.approx(np.exp(-(t**2) / (4 * sigma**2)), abs=0.02)
    assert abs(np.mean(iq[:, :, 1:] * iq[:, :, :-1].conj())) / power < 0.02
    assert abs(np.mean(iq[:, 0] * iq[:, 1].conj())) / power < 0.02


def test_noise_drifts_over_the_history_towards_the_drawn_level():
    batch = draw(NO_ECHO | {"noise.drift_db": [-6, -6], "noise.level_counts": [2000, 2000]}, 200)
    rms = np.sqrt(np.mean(batch.images**2, axis=(0, 1, 3)))
    assert 20 * np.log10(rms[0] / rms[-1]) == pytest.approx(-6, abs=0.3) and rms[-1] == pytest.approx(0.1, rel=0.03)


def test_speckle_multiplies_echoes():
    """At 60 dB the additive part is nothing: the peak scatters by sigma_m about its drawn height."""
    batch = draw(only("ideal") | {"noise.speckle_probability": 1, "noise.speckle_multiplicative": [0.2, 0.2]}, 400)
    ratio = []
    for truth, image in zip(batch.truth, batch.images[:, 0], strict=True):
        way = float(truth["path_m"][0, 0])
        column = round(way / (2 * COLUMN_M) + PEAK_COLUMNS)
        clean = pulse_at(np.array([column - way / (2 * COLUMN_M)]))[0] * 1000 * truth["noise_rms"]
        ratio.append(image[-1, column] / clean)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.04) and np.std(ratio) == pytest.approx(0.2, abs=0.03)


def test_nothing_is_out_of_bounds_in_the_shipped_recipe():
    batch = default_batch()
    for array in (batch.images, batch.labels, batch.iq.view(np.float32)):
        assert np.isfinite(array).all()
    assert batch.images.min() >= 0 and batch.images.max() <= np.float32(20984 / 20000)
    assert np.allclose(np.abs(batch.iq), batch.images, atol=2e-6)
    assert set(np.unique(batch.labels)) == {0.0, 1.0} and batch.labels.sum(axis=3).max() <= 4
    for name in batch.truth.dtype.names:
        assert np.isfinite(batch.truth[name]).all()


def test_distributions_cover_what_the_recipe_says():
    t = truth_of(synthesiser({}, 9, ("left",), plain=False), 2000)
    share = np.bincount(t["obstacles"], minlength=5) / len(t)
    assert share == pytest.approx([0.10, 0.40, 0.25, 0.15, 0.10], abs=0.035)
    assert np.bincount(t["path"], minlength=4) / len(t) == pytest.approx([0.15, 0.35, 0.50, 0], abs=0.035)
    real = t["kind"] >= 0
    kinds = np.bincount(t["kind"][real], minlength=5) / real.sum()
    assert dict(zip(KINDS, kinds, strict=True)) == pytest.approx(
        {"plane": 0.25, "cylinder": 0.45, "edge": 0.20, "point": 0.10, "ideal": 0}, abs=0.03)
    assert t["noise_model"].mean() == pytest.approx(0.15, abs=0.025)
    seen = t[t["psnr_db"] > -99]
    assert kstest((seen["psnr_db"] + 8) / 26, "uniform").pvalue > 1e-3
    assert kstest((t["range_m"][:, 0][real[:, 0]] - 0.18) / 1.44, "uniform").pvalue > 1e-3
    assert kstest(np.degrees(t["azimuth_rad"][real]) / 130 + 0.5, "uniform").pvalue > 1e-3
    moving = t["closing_m_s"][:, 0][real[:, 0] & (t["path"] != PATHS.index("hover"))]
    assert kstest((moving + 0.5) / 3.5, "uniform").pvalue > 1e-3 and (moving > 2).mean() > 0.2


def test_closing_speed_is_the_rate_of_the_range():
    """From labels of the newest rows, without jitter, of every kind of path."""
    batch = draw({"paths.cosine": 0.3, "noise.psnr_db": [60, 60]}, 200)
    columns = [np.flatnonzero(batch.labels[k, 0, m]) for k in range(200) for m in (-1, -5)]
    speed = []
    for k in range(200):
        now, before = columns[2 * k], columns[2 * k + 1]
        if len(now) == 1 and len(before) == 1:
            speed.append(((before - now)[0] * COLUMN_M / (4 * 0.0256), batch.truth["closing_m_s"][k, 0]))
    got, want = np.array(speed).T
    assert len(got) > 150 and np.abs(got - want).mean() < 0.1 and np.corrcoef(got, want)[0, 1] > 0.99


def test_same_bits_whatever_the_batch_the_threads_and_the_sensors_asked_for():
    whole = synthesiser({}, 5, plain=False)
    reference = whole.batch(100, 24, iq=True)
    for size in (1, 5, 24):
        parts = [whole.batch(100 + k, min(size, 24 - k), iq=True) for k in range(0, 24, size)]
        for name in ("images", "labels", "truth", "iq"):
            assert np.concatenate([getattr(p, name) for p in parts]).tobytes() == getattr(reference, name).tobytes()
    with ThreadPoolExecutor(3) as pool:
        again = list(pool.map(lambda k: whole.batch(100 + 8 * k, 8), range(3)))
    assert np.concatenate([p.images for p in again]).tobytes() == reference.images.tobytes()
    right = synthesiser({}, 5, ("right",), plain=False).batch(100, 24)
    assert right.images[:, 0].tobytes() == reference.images[:, 1].tobytes()
    assert right.labels[:, 0].tobytes() == reference.labels[:, 1].tobytes()
    assert not np.array_equal(synthesiser({}, 6, plain=False).batch(100, 24).images, reference.images)


def test_scenes_and_sensors_differ():
    images = default_batch().images[:50].reshape(100, -1)
    flat = images - images.mean(axis=1, keepdims=True)
    assert len({image.tobytes() for image in images}) == 100 and (flat.std(axis=1) > 0).all()


def test_labels_lie_at_the_leading_edge_in_every_row():
    """One column a row, before the envelope has risen: p lies between one column before and at its beginning."""
    batch = draw(only("ideal") | path("arc") | {"air.absorption_db_m": [0, 0]}, 100, roles=("left",))
    for image, label in zip(batch.images[:, 0], batch.labels[:, 0], strict=True):
        rows, columns = np.nonzero(label)
        assert len(set(rows)) == len(rows)
        for m, k in zip(rows, columns, strict=True):
            if k + 12 < 512:
                assert pulse_at(-1.0) - 0.003 < image[m, k] / image[m].max() < pulse_at(0.0) + 0.005
                assert np.argmax(image[m]) - k == pytest.approx(PEAK_COLUMNS + 0.5, abs=1.01)


def test_blurred_label_is_centred_on_the_exact_delay():
    batch = draw(only("point") | {"label.blur_columns": 1.5}, 50, roles=("left",))
    for truth, row in zip(batch.truth, batch.labels[:, 0, -1], strict=True):
        centre = np.sum(row * np.arange(512)) / row.sum()
        assert centre == pytest.approx(truth["path_m"][0, 0] / (2 * COLUMN_M), abs=0.02)
        assert row.sum() == pytest.approx(1.5 * np.sqrt(2 * np.pi), rel=0.01)


def test_merged_labels_are_equation_9():
    """Edges of the summed envelopes over tau, counted on a grid eight times finer than the columns."""
    values = {"label.rule": "merged", "obstacles.count_weights": [0, 0, 1, 1, 1], "rows.lost_probability": 0}
    batch = draw(values | only("ideal") | path("cosine"), 60, roles=("left",))
    each = draw(values | only("ideal") | path("cosine") | {"label.rule": "each"}, 60, roles=("left",))
    fine = np.arange(0, 512, 0.125)
    same = fewer = 0
    for k in range(60):
        ways = batch.truth["path_m"][k, 0, : batch.truth["obstacles"][k]].astype(float) / (2 * COLUMN_M)
        over = sum(pulse_at(fine - w) for w in ways) >= 0.5
        edges = int(np.sum(over[1:] & ~over[:-1]))
        same += edges == batch.labels[k, 0, -1].sum()
        fewer += edges < each.labels[k, 0, -1].sum()
    assert same == 60 and fewer >= 3


def test_faint_echoes_are_not_labelled():
    quiet = draw(only("cylinder") | {"label.least_snr_db": 21, "noise.psnr_db": [20, 20]}, 30)
    loud = draw(only("cylinder") | {"label.least_snr_db": 19, "noise.psnr_db": [20, 20]}, 30)
    assert quiet.labels[:, 0, -1].sum() == 0 and loud.labels[:, 0, -1].sum() == 30


def test_lost_cycles_and_short_histories_are_rows_of_zeros():
    batch = draw({"rows.lost_probability": 0.2, "rows.start_probability": 0.5}, 300)
    zero = (batch.images == 0).all(axis=3)
    first = batch.truth["first_row"]
    assert (first > 0).mean() == pytest.approx(0.5, abs=0.08) and not zero[:, :, -1].any()
    for k in np.flatnonzero(first):
        assert zero[k, :, : first[k]].all() and batch.labels[k, :, : first[k]].sum() == 0
    assert zero[first == 0][:, :, :-1].mean() == pytest.approx(0.2, abs=0.02)


def test_ring_down_fills_the_first_columns():
    quiet, ringing = (draw(NO_ECHO | {"ring_down.probability": p, "ring_down.gain_db": [0, 0],
                                      "image.saturation": True}, 20) for p in (0, 1))
    assert ringing.images[..., 0].mean() > 0.5
    assert np.allclose(ringing.images[..., 60:], quiet.images[..., 60:], atol=1e-3)
    # meets the quiet floor, 60 counts, after 20 samples of fop/2: 129 mm
    column = round(20 / 26_500 * synth_c() / (2 * COLUMN_M))
    level = np.sqrt(np.mean(ringing.images[..., column] ** 2) - np.mean(quiet.images[..., column] ** 2))
    assert level == pytest.approx(60 / 20000, rel=0.15)


def test_free_scale_makes_the_mean_of_every_image_one():
    batch = draw({"image.scale": "free"}, 20, plain=False)
    assert np.allclose(batch.images.mean(axis=(2, 3)), 1.0, rtol=1e-4)


def test_the_papers_recipe():
    batch = draw({}, 400, recipe="paper", plain=False)
    t = batch.truth
    assert set(t["path"]) == {PATHS.index("cosine")} and set(t["kind"][t["kind"] >= 0]) == {KINDS.index("ideal")}
    assert t["noise_model"].mean() == pytest.approx(0.5, abs=0.08)
    assert np.bincount(t["response"][t["kind"] >= 0]) / (t["kind"] >= 0).sum() == pytest.approx([1 / 3] * 3, abs=0.07)
    both = t[t["obstacles"] == 2]
    assert np.allclose(both["snr_db"][:, 0, 0], both["snr_db"][:, 0, 1], atol=1e-3)
