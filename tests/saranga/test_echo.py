"""The range grid, resampling against an analytic band-limited echo, and the image of the last cycles."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saranga.echo import (
    COLUMN_M,
    FULL_SCALE,
    HISTORY_ROWS,
    RANGE_COLUMNS,
    EchoFrame,
    EchoImage,
    load_sonar,
    resample,
    sound_speed_m_s,
)
from saranga.errors import UsageError
from saranga.fixtures import fixture_path

FOP_HZ = 53_000.0
BAND_HZ = 3980.0
PEAK_COUNTS = 15_000.0


def pulse(t_s):
    """sinc^2: its spectrum is a triangle that ends exactly at +-BAND_HZ / 2."""
    return np.sinc(t_s * BAND_HZ / 2) ** 2


def echo(t_s, range_m, c_m_s):
    """Complex baseband of one echo of peak 1."""
    tau = 2 * range_m / c_m_s
    return pulse(t_s - tau) * np.exp(-2j * np.pi * FOP_HZ * tau)


def frame_of(signal, odr=6, trigger=0, role="left"):
    iq = np.round(np.stack([signal.imag, signal.real], axis=1)).astype(np.int16)
    return EchoFrame(role, 0, trigger, trigger, 25_600 * trigger, FOP_HZ, odr, 0, iq)


def recorded(range_m, c_m_s, odr=6, samples=256, trigger=0):
    t_s = np.arange(samples) * 2.0 ** (7 - odr) / FOP_HZ
    return frame_of(PEAK_COUNTS * echo(t_s, range_m, c_m_s), odr, trigger)


def peak_range_m(row):
    """Range of the highest column, refined by a parabola through its neighbours."""
    a = np.abs(row)
    k = int(np.argmax(a))
    shift = 0.5 * (a[k - 1] - a[k + 1]) / (a[k - 1] - 2 * a[k] + a[k + 1])
    return (k + shift) * COLUMN_M


def test_grid_is_the_papers():
    assert (RANGE_COLUMNS, HISTORY_ROWS) == (512, 32)
    assert abs(COLUMN_M / 3.242e-3 - 1.0) < 1e-3
    assert pytest.approx(1.66) == RANGE_COLUMNS * COLUMN_M


@pytest.mark.parametrize(("temperature_c", "c_m_s"), [(0, 331.3), (20, 343.2), (40, 354.7), (-20, 318.9)])
def test_sound_speed(temperature_c, c_m_s):
    assert sound_speed_m_s(temperature_c) == pytest.approx(c_m_s, abs=0.1)


@pytest.mark.parametrize(("odr", "samples", "limit_db"), [(6, 256, -80), (6, 340, -80), (5, 128, -80), (4, 64, -72)])
def test_resampled_echo_equals_the_analytic_one(odr, samples, limit_db):
    """Complex error over 0.1-1.5 m, echoes at 23 sub-sample ranges; int16 rounding alone is -86 dB."""
    c_m_s = sound_speed_m_s(20.0)
    ranges_m = np.arange(RANGE_COLUMNS) * COLUMN_M
    seen = (ranges_m > 0.1) & (ranges_m < 1.5)
    worst = 0.0
    for range_m in np.linspace(0.3, 1.3, 23):
        row = resample(recorded(range_m, c_m_s, odr, samples), c_m_s)
        true = echo(2 * ranges_m / c_m_s, range_m, c_m_s)
        worst = max(worst, np.abs(row * FULL_SCALE / PEAK_COUNTS - true)[seen].max())
    assert 20 * np.log10(worst) < limit_db


@pytest.mark.parametrize("odr", [3, 2])
def test_aliased_rates_still_place_the_echo(odr):
    """The 4 kHz band does not fit 3.3 and 1.7 kHz of IQ rate: the shape is lost, the place is not."""
    c_m_s = sound_speed_m_s(20.0)
    sample_m = c_m_s * 2.0 ** (7 - odr) / (2 * FOP_HZ)
    row = resample(recorded(0.9, c_m_s, odr, 64), c_m_s)
    assert abs(np.argmax(np.abs(row)) * COLUMN_M - 0.9) < sample_m


@pytest.mark.parametrize("temperature_c", [-10.0, 0.0, 20.0, 40.0])
@pytest.mark.parametrize("range_m", [0.25, 0.8127, 1.5])
def test_range_is_right_at_any_temperature(temperature_c, range_m):
    c_m_s = sound_speed_m_s(temperature_c)
    assert peak_range_m(resample(recorded(range_m, c_m_s), c_m_s)) == pytest.approx(range_m, abs=1e-4)


def test_uncompensated_temperature_shifts_the_range():
    """An echo at 0 C read with the speed of 20 C: 3.6 % too far (0.18 %/C, hardware.md)."""
    row = resample(recorded(1.0, sound_speed_m_s(0.0)), sound_speed_m_s(20.0))
    assert peak_range_m(row) == pytest.approx(1.036, abs=1e-3)


def test_phase_survives_resampling():
    """Two sensors 1 mm of path apart differ by 2 pi fop / c times 1 mm in phase."""
    c_m_s = sound_speed_m_s(20.0)
    near, far = (resample(recorded(r, c_m_s), c_m_s) for r in (0.7, 0.7005))
    k = round(0.7 / COLUMN_M)
    expected = 2 * np.pi * FOP_HZ * 1e-3 / c_m_s
    assert np.angle(near[k] * np.conj(far[k])) == pytest.approx(expected, abs=1e-3)


def test_q_comes_first():
    signal = np.full(256, 3000.0 - 1000.0j)
    row = resample(frame_of(signal), 343.0)
    assert row[200].real * FULL_SCALE == pytest.approx(3000.0, rel=1e-6)
    assert row[200].imag * FULL_SCALE == pytest.approx(-1000.0, rel=1e-6)


def test_columns_beyond_the_record_are_zero_and_sample_zero_is_ignored():
    """128 samples at fop/2 and 343 m/s end at 127 x 343 / 53000 = 0.822 m; sample 0 holds metadata."""
    iq = np.full((128, 2), 4000, np.int16)
    iq[0] = 32767
    row = resample(EchoFrame("left", 0, 0, 0, 0, FOP_HZ, 6, 0, iq), 343.0)
    last = int(127 * 343 / 53_000 / COLUMN_M)
    assert np.abs(row[last]) > 0.2 and not row[last + 1:].any()
    assert np.abs(row).max() == pytest.approx(np.hypot(0.2, 0.2), rel=1e-5)


@pytest.mark.parametrize(("fop_hz", "odr", "c_m_s", "word"),
                         [(1.0, 6, 343.0, "fop"), (FOP_HZ, 7, 343.0, "ODR"), (FOP_HZ, 6, 0.0, "speed")])
def test_impossible_settings_are_named(fop_hz, odr, c_m_s, word):
    frame = EchoFrame("left", 0, 0, 0, 0, fop_hz, odr, 0, np.zeros((256, 2), np.int16))
    with pytest.raises(UsageError, match=word):
        resample(frame, c_m_s)


# ---- image -----------------------------------------------------------------------------------------------------
C_M_S = 343.0


def constant(trigger, counts=None):
    """A frame whose level tells its trigger."""
    level = 100 + trigger % 1000 if counts is None else counts
    return frame_of(np.full(256, level + 0j), trigger=trigger)


def levels(image):
    return np.round(image.iq[:, 200].real * FULL_SCALE).astype(int).tolist()


def test_newest_row_is_last_and_rows_are_counted():
    image = EchoImage()
    assert image.rows == 0 and image.iq.shape == (32, 512) and image.envelope.dtype == np.float32
    for trigger in range(5):
        image.push(constant(trigger), C_M_S)
    assert image.rows == 5 and image.trigger == 4
    assert levels(image) == [0] * 27 + [100, 101, 102, 103, 104]
    for trigger in range(5, 100):
        image.push(constant(trigger), C_M_S)
    assert image.rows == 32 and levels(image) == list(range(168, 200))
    assert image.iq.flags.c_contiguous and image.envelope.flags.c_contiguous


def test_missing_cycles_become_zero_rows():
    image = EchoImage()
    image.push(constant(0), C_M_S)
    image.push(constant(3), C_M_S)
    assert levels(image)[-4:] == [100, 0, 0, 103] and image.rows == 4
    image.push_missing(5)
    assert levels(image)[-6:] == [100, 0, 0, 103, 0, 0]
    image.push(constant(1000), C_M_S)
    assert levels(image) == [0] * 31 + [100] and image.rows == 32


def test_late_frame_goes_to_its_own_row():
    image = EchoImage()
    for trigger in (0, 1, 3):
        image.push(constant(trigger), C_M_S)
    image.envelope  # noqa: B018
    image.push(constant(2), C_M_S)
    assert levels(image)[-4:] == [100, 101, 102, 103] and image.rows == 4
    assert image.envelope[-2, 200] * FULL_SCALE == pytest.approx(102)


def test_trigger_wraps_and_restarts():
    image = EchoImage()
    image.push(constant(0xFFFFFFFF, 7), C_M_S)
    image.push(constant(1, 9), C_M_S)
    assert levels(image)[-3:] == [7, 0, 9]
    image = EchoImage()
    image.push(constant(50_000), C_M_S)
    image.push(constant(0), C_M_S)
    assert image.rows == 1 and levels(image) == [0] * 31 + [100]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(-3, 40), st.booleans()), min_size=1, max_size=60))
def test_image_equals_a_plain_history(steps):
    """Against a dictionary of what each trigger held, through gaps, late frames and looks at odd moments."""
    image, held, now = EchoImage(), {}, 1000
    for n, (step, look) in enumerate(steps):
        trigger = max(now + step, 0) if held else now
        if trigger < min(held, default=0):
            continue
        image.push(constant(trigger, 50 + n), C_M_S)
        held[trigger] = 50 + n
        now = max(now, trigger)
        if look:
            assert np.array_equal(image.envelope, np.abs(image.iq))
    assert levels(image) == [held.get(t, 0) for t in range(now - 31, now + 1)]
    assert np.array_equal(image.envelope, np.abs(image.iq))


def test_same_input_same_bits():
    def bits():
        image = EchoImage()
        for trigger in range(40):
            image.push(recorded(0.3 + 0.02 * trigger, 343.0, trigger=trigger), 343.0 + 0.01 * trigger)
        return image.iq.tobytes() + image.envelope.tobytes()

    assert bits() == bits()


# ---- sonar files -----------------------------------------------------------------------------------------------
def test_shipped_sonars():
    pair, triple = load_sonar("pair"), load_sonar("triple")
    assert pair.roles == ("left", "right") and triple.roles == ("left", "right", "down")
    assert pair.baseline_h_m == pytest.approx(0.10) and pair.baseline_v_m == 0.0
    assert triple.baseline_v_m == pytest.approx(0.06)
    assert pair.positions_m["right"][1] > 0 > pair.positions_m["left"][1]
    assert triple.positions_m["down"][2] > triple.positions_m["left"][2]
    assert pair.iq_rate_hz == 26_500.0 and pair.transmitter == "left"
    # 256 pairs at fop / 2 cover the paper's 1.66 m
    assert pair.samples * 343.0 / (2 * pair.iq_rate_hz) == pytest.approx(1.66, abs=0.01)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("fop_hz = 53000.0 ", "fop_hz = 53.0 ", ["receiver.fop_hz", "53.0", "20000..200000"]),
    ("odr = 6 ", "odr = 6.5 ", ["receiver.odr", "6.5", "2..6"]),
    ("odr = 6 ", "odr = true ", ["receiver.odr", "True"]),
    ("samples = 256 ", "sample = 256 ", ["receiver.sample", "samples"]),
    ("bandwidth_hz = 3980.0 ", "", ["receiver.bandwidth_hz", "missing"]),
    ("bandwidth_hz = 3980.0 ", "bandwidth_hz = nan ", ["receiver.bandwidth_hz", "nan"]),
    ('transmitter = "left"', 'transmitter = "down"', ["sonar.transmitter", "'down'", "left, right"]),
    ("horizontal = 0.10", "horizontal = 0.11", ["baselines_m.horizontal", "0.11", "0.1000 m"]),
    ("right = [0.08, 0.05, 0.0]", "right = [0.08, -0.15, 0.0]", ["positions_m.right", "right of"]),
    ("right = [0.08, 0.05, 0.0]", "right = [0.07, 0.05, 0.0]", ["positions_m.right", "straight"]),
    ("right = [0.08, 0.05, 0.0]", "right = [0.08, 50]", ["positions_m.right", "[x, y, z]"]),
    ("right = [0.08, 0.05, 0.0]", "", ["positions_m.right", "missing"]),
    ("saturation_counts = 20984.0", "saturation_counts = 19000.0", ["saturation_counts", "19000", "20000"]),
    ("[horn]", "[trumpet]", ["[trumpet]", "horn"]),
    ("[horn]", "[horn", ["not valid TOML"]),
])
def test_bad_sonar_file_is_named(tmp_path: Path, old, new, words):
    text = fixture_path("sonars", "pair").read_text()
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new + "#" if not new.strip() else new, 1))
    with pytest.raises(UsageError) as caught:
        load_sonar(str(path))
    for word in [str(path), *words]:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_sonar_lists_the_known():
    with pytest.raises(UsageError, match="did you mean 'triple'"):
        load_sonar("tripel")
