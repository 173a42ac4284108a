"""The record: pulse, delay to a part of a sample, phase, ring-down, noise floor, saturation, numbers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from saranga.denoise.pulse import pulse as denoiser_pulse
from saranga.echo import COLUMN_M, EchoFrame, load_sonar, resample
from saranga.pulse import pulse, pulse_peak_delay_s, pulse_sigma_s
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.receiver import add_echoes, digitise
from sitl.acoustics.shield import load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.primitives import Primitives, facet_row

FOP, RATE, BAND = 53e3, 26.5e3, 3980.0
Y, DOWN = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
POS, LEVEL, STILL = np.array([0.0, 0.0, -2.0]), np.array([1.0, 0, 0, 0]), np.zeros(3)


def plane_model(x_m: float, reflectivity: float = 1.0, **changes: Any) -> AcousticModel:
    wall = Primitives.of(facets=[facet_row(np.array([x_m, 0, -2.0]), -Y, DOWN, 2.0, 2.0, reflectivity)])
    geometry = replace(load_sonar("pair"), **changes)
    return AcousticModel(wall, StandardAir(), geometry, load_shield("none"), 1)


def record(model: AcousticModel, role: str = "left", vel: np.ndarray = STILL) -> np.ndarray:
    iq = model.cycle(POS, LEVEL, vel, np.zeros(4), 0)[role].astype(float)
    return iq[:, 1] + 1j * iq[:, 0]


def test_pulse_is_3_db_down_at_half_the_bandwidth() -> None:
    t = np.arange(-1e-3, 2e-3, 1e-7)
    p = pulse(t, BAND)
    assert t[np.argmax(p)] == pytest.approx(pulse_peak_delay_s(BAND), abs=1e-7)
    spectrum = [abs(np.sum(p * np.exp(-2j * np.pi * f * t))) for f in (0.0, BAND / 2)]
    assert 20 * np.log10(spectrum[1] / spectrum[0]) == pytest.approx(-3.01, abs=0.01)
    # It begins about at 0: little before, half way up within s of it.
    assert pulse(np.array([0.0]), BAND)[0] < 0.05


def test_denoisers_expect_the_pulse_that_is_sent() -> None:
    expected = denoiser_pulse(BAND)
    assert expected.peak_m == pytest.approx(pulse_peak_delay_s(BAND) * 343.2 / 2, abs=1e-4)
    assert expected.sigma_m == pytest.approx(pulse_sigma_s(BAND) * 343.2 / 2, abs=1e-4)


@pytest.mark.parametrize("tau_s", [1.0e-3, 1.00001e-3, 3.3333e-3])
def test_echo_is_exact_to_any_part_of_a_sample(tau_s: float) -> None:
    out = np.zeros(256, dtype=complex)
    amplitude, shift = 0.3 - 0.4j, 622.0
    row = np.array([[tau_s, amplitude.real, amplitude.imag, shift, 0, 0, 0]])
    sigma, peak = pulse_sigma_s(BAND), pulse_peak_delay_s(BAND)
    add_echoes(out, row, 1, 100.0, FOP, RATE, sigma, peak)
    t = np.arange(256) / RATE
    wanted = (100 * amplitude * pulse(t - tau_s, BAND) * np.exp(-2j * np.pi * FOP * tau_s)
              * np.exp(2j * np.pi * shift * (t - tau_s - peak)))
    assert np.abs(out - wanted).max() < 100 * 0.5 * 4e-4
    assert np.abs(out - wanted)[np.abs(wanted) > 0.1].max() < 1e-6


def test_plane_at_1_m_reads_its_calibration_at_its_delay() -> None:
    model = plane_model(1.08)
    seen = np.abs(record(model))
    assert seen[60:].max() == pytest.approx(12_000, rel=0.03)
    k = 30 + int(np.argmax(seen[30:]))
    # Centre of the parabola through the log of three samples, exact for a Gaussian.
    low, mid, high = np.log(seen[k - 1:k + 2])
    at_s = (k + 0.5 * (low - high) / (low - 2 * mid + high)) / RATE
    assert at_s == pytest.approx(2.0 / model.air.c_m_s + pulse_peak_delay_s(BAND), abs=0.01 / RATE)


def test_phase_follows_the_distance() -> None:
    # Half a wavelength of path, a quarter of range, turns the phase by half a turn.
    wavelength = plane_model(1.0).air.c_m_s / FOP
    here, there = record(plane_model(1.08)), record(plane_model(1.08 + wavelength / 4))
    k = 40 + int(np.argmax(np.abs(here[40:])))
    assert np.real(there[k] * np.conj(here[k])) / abs(there[k] * here[k]) < -0.99
    # exp(-2j pi fop tau): longer paths turn clockwise.
    nearly = record(plane_model(1.08 + wavelength / 16))
    assert np.angle(nearly[k] * np.conj(here[k])) == pytest.approx(-np.pi / 4, abs=0.05)


def test_row_on_the_range_grid_peaks_at_the_right_column() -> None:
    model = plane_model(1.08)
    iq = model.cycle(POS, LEVEL, STILL, np.zeros(4), 0)["left"]
    row = np.abs(resample(EchoFrame("left", 0, 0, 0, 0, FOP, 6, 0, iq), model.air.c_m_s))
    peak_m = 1.0 + pulse_peak_delay_s(BAND) * model.air.c_m_s / 2
    assert 60 + np.argmax(row[60:]) == pytest.approx(peak_m / COLUMN_M, abs=1.0)


def test_receiver_on_the_other_side_hears_along_the_bistatic_path() -> None:
    model = plane_model(0.58)
    path = 2 * np.hypot(0.5, 0.05)
    found = model.arrivals("right", POS, LEVEL, STILL)
    mirror = found[found[:, 5] == 0.0]
    assert mirror[:, 0] == pytest.approx([path / model.air.c_m_s], rel=1e-9)
    direct = found[found[:, 5] == 3.0]
    assert direct[:, 4] == pytest.approx([0.10])
    assert not (model.arrivals("left", POS, LEVEL, STILL)[:, 5] == 3.0).any()


def test_echo_of_a_moving_sensor_is_early_and_shifted() -> None:
    model = plane_model(1.08)
    still, moving = (model.arrivals("left", POS, LEVEL, v)[0] for v in (STILL, np.array([2.0, 0, 0])))
    assert moving[3] == pytest.approx(622.0, abs=1.0)
    # While the front returns the sensor comes 2 m/s * 5.8 ms nearer.
    assert (still[0] - moving[0]) * model.air.c_m_s == pytest.approx(2.0 * moving[0], rel=1e-6)
    assert 20 * np.log10(abs(moving[1] / still[1])) == pytest.approx(-0.4, abs=0.02)


def test_echoes_beyond_the_record_are_dropped() -> None:
    # 256 samples at fop/2 last 9.66 ms: 1.658 m.
    assert len(plane_model(0.08 + 1.65).arrivals("left", POS, LEVEL, STILL)) == 1
    assert len(plane_model(0.08 + 1.67).arrivals("left", POS, LEVEL, STILL)) == 0


def test_ring_down_fills_the_first_samples_of_the_transmitter_only() -> None:
    model = plane_model(5.0)
    left, right = np.abs(record(model)), np.abs(record(model, "right"))
    assert left[1:6].min() > 20_000
    assert left[25:].max() < 300
    # The other one hears the direct sound over 0.1 m, not the ringing.
    assert right[1:5].max() < 300
    assert right[8:16].max() > 10_000
    noise = model.cycle(POS, LEVEL, STILL, np.zeros(4), 0, receive_only=True)["left"].astype(float)
    assert np.hypot(*noise.T).max() < 300


def test_quiet_floor_saturation_and_numbers() -> None:
    model = plane_model(0.28)
    iq = model.cycle(POS, LEVEL, STILL, np.zeros(4), 0)["left"]
    assert iq.dtype == np.int16 and iq.shape == (256, 2)
    assert tuple(iq[0]) == (0, 0)
    size = np.hypot(*iq.astype(float).T)
    assert 20_983 < size[20:50].max() < 20_985
    floor = np.concatenate([model.cycle(POS, LEVEL, STILL, np.zeros(4), t)["left"][100:] for t in range(50)])
    assert np.sqrt(np.mean(np.sum(floor.astype(float) ** 2, axis=1))) == pytest.approx(60.0, rel=0.05)


def test_digitise_keeps_the_phase_rounds_and_puts_q_first() -> None:
    out = np.empty((3, 2), dtype=np.int16)
    digitise(np.array([5 + 5j, 3.6 - 7.4j, 4e6 + 3e6j]), 20_984.0, out)
    assert out[0].tolist() == [0, 0]
    assert out[1].tolist() == [-7, 4]
    assert np.abs(out[2] - 20_984 * np.array([0.6, 0.8])).max() <= 0.5


def test_lower_data_rate_samples_the_same_echo_less_often() -> None:
    fine = record(plane_model(1.08, quiet_floor_counts=0.0))
    coarse = record(plane_model(1.08, quiet_floor_counts=0.0, odr=5, samples=128))
    assert np.abs(coarse[15:] - fine[30::2]).max() < 1.5
