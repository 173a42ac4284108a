"""What every classical denoiser owes: its place, its range, a calm answer to rubbish."""

import numpy as np
import pytest
from synthetic_images import Reflector, SyntheticImage, echoes, image, noise

from saranga.denoise import Denoiser, denoiser_names, load_denoiser
from saranga.denoise.peaks import put_peak
from saranga.denoise.pulse import pulse
from saranga.echo import EchoFrame, EchoImage
from saranga.errors import UsageError
from saranga.localise import edges
from saranga.resample import COLUMN_M

CLASSICAL = ["gaussian", "tbd"]


def ranges(denoiser: Denoiser, picture: SyntheticImage) -> np.ndarray:
    row = np.atleast_2d(denoiser(picture))[-1]  # type: ignore[arg-type]
    return edges(row, denoiser.threshold, offset_m=denoiser.edge_offset_m)[0] / 2


def test_pulse_has_the_bandwidth_it_claims() -> None:
    """-3 dB of amplitude spectrum at half the bandwidth, by a Fourier transform of the pulse itself."""
    shape = pulse(3980.0)
    column_s = 2 * COLUMN_M / 343.2
    t = np.arange(-400, 401) * column_s
    p = np.exp(-(t**2) / (2 * (shape.sigma_columns * column_s) ** 2))
    spectrum = [abs(np.sum(p * np.exp(-2j * np.pi * f * t))) for f in (0.0, 1990.0)]
    assert 20 * np.log10(spectrum[1] / spectrum[0]) == pytest.approx(-3.0, abs=0.05)
    assert shape.peak_m == pytest.approx(2.5 * 66.6e-6 * 343.2 / 2, abs=2e-4)


@pytest.mark.parametrize("name", CLASSICAL)
def test_reported_range_is_the_true_range(name: str) -> None:
    denoiser = load_denoiser(name)
    errors = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        reflector = Reflector(rng.uniform(0.3, 1.4), rng.uniform(0.0, 1.5))
        found = ranges(denoiser, image([reflector], 25.0, rng))
        errors.append(found[np.argmin(np.abs(found - reflector.range_m))] - reflector.range_m)
    assert abs(np.mean(errors)) < 0.002
    assert np.max(np.abs(errors)) < 0.01


@pytest.mark.parametrize("name", CLASSICAL)
def test_false_edges_in_noise_are_rare_at_the_threshold(name: str) -> None:
    # calibrated for 0.02 a frame; with 150 frames that is 3, and 9 or more has a probability under 0.5 %
    denoiser = load_denoiser(name)
    false = sum(ranges(denoiser, SyntheticImage(noise(np.random.default_rng(70_000 + i)))).size for i in range(150))
    assert false <= 8


@pytest.mark.parametrize("name", CLASSICAL)
@pytest.mark.parametrize("level", [1e-3, 1.0, 30.0])
def test_noise_level_does_not_matter(name: str, level: float) -> None:
    denoiser = load_denoiser(name)
    picture = image([Reflector(0.8, 0.5)], 15.0, np.random.default_rng(2))
    expected = denoiser(picture)  # type: ignore[arg-type]
    assert denoiser(SyntheticImage(picture.iq * level)) == pytest.approx(expected, abs=1e-3)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", CLASSICAL)
def test_ring_down_is_blanked(name: str) -> None:
    picture = image([Reflector(0.8, 0.5)], 20.0, np.random.default_rng(3))
    ringing = picture.iq.copy()
    ringing[:, :36] += 1.0  # steady, far over the echo, ends at 0.12 m
    found = ranges(load_denoiser(name), SyntheticImage(ringing))
    assert np.min(np.abs(found - 0.8)) < 0.01
    assert not np.any(found < 0.15)


@pytest.mark.parametrize("name", CLASSICAL)
def test_all_zero_and_noise_free_images(name: str) -> None:
    denoiser = load_denoiser(name)
    assert not np.any(denoiser(SyntheticImage(np.zeros((32, 512)))))  # type: ignore[arg-type]
    found = ranges(denoiser, SyntheticImage(echoes([Reflector(0.9)])))
    assert np.min(np.abs(found - 0.9)) < 0.005


@pytest.mark.parametrize("name", CLASSICAL)
@pytest.mark.parametrize("rubbish", [np.nan, np.inf, complex(0.0, np.nan)])
def test_rubbish_in_a_row_is_no_detection_and_never_comes_out(name: str, rubbish: complex) -> None:
    denoiser = load_denoiser(name)
    picture = image([Reflector(0.8)], 20.0, np.random.default_rng(4))
    for rows in (slice(5, 6), slice(31, 32), slice(0, 32)):
        broken = picture.iq.copy()
        broken[rows, 100:110] = rubbish
        row = denoiser(SyntheticImage(broken))  # type: ignore[arg-type]
        assert np.all(np.isfinite(row)) and row.min() >= 0.0 and row.max() <= 1.0
        if rows == slice(0, 32):
            assert not row.any()
        else:
            assert np.min(np.abs(edges(row, 0.5, offset_m=denoiser.edge_offset_m)[0] / 2 - 0.8)) < 0.01


@pytest.mark.parametrize("name", CLASSICAL)
def test_rows_before_the_history_is_filled_do_not_count(name: str) -> None:
    denoiser = load_denoiser(name)
    picture = image([Reflector(0.7)], 20.0, np.random.default_rng(5))
    picture.rows = 0
    assert not np.any(denoiser(picture))  # type: ignore[arg-type]
    picture.rows = 6
    old_is_rubbish = SyntheticImage(picture.iq.copy(), rows=6)
    old_is_rubbish.iq[:26] = np.random.default_rng(6).standard_normal((26, 512))
    old_is_rubbish.envelope[:26] = np.abs(old_is_rubbish.iq[:26])
    assert np.array_equal(denoiser(picture), denoiser(old_is_rubbish))  # type: ignore[arg-type]
    assert np.min(np.abs(ranges(denoiser, picture) - 0.7)) < 0.01


@pytest.mark.parametrize("name", CLASSICAL)
def test_lost_cycles_do_not_hide_an_obstacle(name: str) -> None:
    picture = image([Reflector(0.7, 1.0)], 20.0, np.random.default_rng(8))
    holes = picture.iq.copy()
    holes[[3, 9, 20, 29]] = 0
    assert np.min(np.abs(ranges(load_denoiser(name), SyntheticImage(holes)) - 0.7)) < 0.01


@pytest.mark.parametrize("name", CLASSICAL)
def test_works_on_the_image_the_stack_builds(name: str) -> None:
    """Native int16 records of a pole 1 m away, Q first, through EchoImage."""
    c, fop = 343.2, 53_000.0
    t = np.arange(256) / (fop / 2)
    rng = np.random.default_rng(9)
    picture = EchoImage()
    for trigger in range(40):
        r = 1.0 + 0.5 * 0.0256 * (39 - trigger)
        tau = 2 * r / c
        echo = 4000 * np.exp(-((t - tau - 2.5 * 66.58e-6) ** 2) / (2 * 66.58e-6**2) - 2j * np.pi * fop * tau)
        record = echo + 200 * (rng.standard_normal(256) + 1j * rng.standard_normal(256))
        iq = np.stack([record.imag, record.real], axis=1).round().astype(np.int16)
        picture.push(EchoFrame("left", 0, trigger, trigger, trigger * 25_600, fop, 6, 0, iq), c)
    denoiser = load_denoiser(name)
    found = edges(denoiser(picture), denoiser.threshold, offset_m=denoiser.edge_offset_m)[0] / 2
    assert np.min(np.abs(found - 1.0)) < 0.005


@pytest.mark.parametrize("name", CLASSICAL)
def test_same_image_same_edges_and_the_image_is_left_alone(name: str) -> None:
    picture = image([Reflector(0.8, 0.5)], 5.0, np.random.default_rng(7))
    before = picture.iq.copy()
    first = load_denoiser(name)(picture)  # type: ignore[arg-type]
    assert np.array_equal(first, load_denoiser(name)(picture))  # type: ignore[arg-type]
    assert np.array_equal(before, picture.iq)


@pytest.mark.parametrize("position", [10.0, 10.2, 10.5, 10.9, 200.25])
def test_a_peak_is_read_back_where_it_was_put(position: float) -> None:
    row = np.zeros(512, dtype=np.float32)
    put_peak(row, position, 0.8)
    columns, strength = edges(row, 0.5)
    assert columns[0] / (2 * COLUMN_M) == pytest.approx(position, abs=1e-5)
    assert strength[0] == pytest.approx(0.8)


def test_a_peak_off_the_record_is_left_out() -> None:
    row = np.zeros(512, dtype=np.float32)
    for position in (-0.5, 511.2, 600.0):
        put_peak(row, position, 0.8)
    assert not row.any()


def test_names() -> None:
    assert set(CLASSICAL) <= set(denoiser_names())


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("gausian", {}, ["gausian", "'gaussian'", "tbd"]),
        ("tbd", {"obstacle": 3}, ["obstacle", "'obstacles'"]),
        ("tbd", {"obstacles": 0}, ["obstacles", "1..32"]),
        ("gaussian", {"ring_down_m": 9.0}, ["ring_down_m", "0..1"]),
        ("tbd", {"bandwidth_hz": float("nan")}, ["bandwidth_hz", "500..20000"]),
    ],
)
def test_bad_names_and_options_say_what_is_wrong(name: str, options: dict[str, float], words: list[str]) -> None:
    with pytest.raises(UsageError) as caught:
        load_denoiser(name, **options)
    assert all(word in str(caught.value) for word in words)
