"""Air, beam and Doppler against the figures of acoustics.md."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import j1

from sitl.acoustics.atmosphere import StandardAir, absorption_db_m, atmosphere
from sitl.acoustics.beam import beam_gain, piston_gain, piston_grid
from sitl.acoustics.doppler import band_loss, doppler_shift_hz, moving_delay_s

WAVENUMBER = 971.0
A_H, A_V = 1.8e-3, 3.5e-3


@pytest.mark.parametrize(("temperature_c", "humidity_percent", "db_m"), [
    # acoustics.md prints 31 %: its figures are those of the 31.3 % that the paper read indoors.
    (20, 10, 0.65), (20, 20, 0.99), (20, 31.3, 1.37), (20, 50, 1.76), (20, 70, 1.87), (20, 90, 1.81),
    (22.5, 31.3, 1.56), (25, 50, 2.00), (10, 50, 1.07), (0, 50, 0.64), (3.9, 36, 0.64)])
def test_absorption_at_53_khz(temperature_c: float, humidity_percent: float, db_m: float) -> None:
    air = StandardAir(temperature_c, humidity_percent)
    assert absorption_db_m(53e3, air) == pytest.approx(db_m, abs=0.0051)


def test_absorption_agrees_with_the_standards_own_table() -> None:
    # ISO 9613-1, table 1: 20 C, 50 %, 101.325 kPa: 4.66 dB/km at 1 kHz, 29.2 at 4 kHz, 105 at 8 kHz.
    for frequency_hz, db_km in ((1000.0, 4.66), (3981.07, 29.2), (7943.28, 105.0)):
        assert 1e3 * absorption_db_m(frequency_hz, StandardAir()) == pytest.approx(db_km, rel=0.02)


def test_speed_and_density_of_air() -> None:
    air = atmosphere(53e3, StandardAir())
    assert air.c_m_s == pytest.approx(343.2, abs=0.1)
    assert air.impedance_pa_s_m == pytest.approx(413.0, abs=1.0)
    thin = atmosphere(53e3, SimpleNamespace(temperature_c=20.0, humidity_percent=50.0, pressure_pa=50_662.5))
    assert thin.density_kg_m3 == pytest.approx(air.density_kg_m3 / 2)


def test_horn_is_3_db_down_at_70_and_28_5_degrees() -> None:
    across = piston_gain(np.sin(np.radians(70.0)), 0.0, WAVENUMBER, A_H, A_V)
    up = piston_gain(0.0, np.sin(np.radians(28.5)), WAVENUMBER, A_H, A_V)
    assert 20 * np.log10(across) == pytest.approx(-3.0, abs=0.12)
    assert 20 * np.log10(up) == pytest.approx(-3.0, abs=0.12)


def test_grid_gives_the_piston_in_every_direction() -> None:
    grid = piston_grid(WAVENUMBER, A_H, A_V)
    rng = np.random.default_rng(5)
    for direction in rng.standard_normal((300, 3)):
        x, y, z = direction / np.linalg.norm(direction)
        v = WAVENUMBER * np.hypot(A_H * y, A_V * z)
        assert beam_gain(grid, abs(x), y, z) == pytest.approx(2 * j1(v) / v, abs=1e-3)


def test_nothing_to_speak_of_goes_backwards_and_the_beam_has_no_step() -> None:
    grid = piston_grid(WAVENUMBER, A_H, A_V)
    assert beam_gain(grid, 1.0, 0.0, 0.0) == pytest.approx(1.0, abs=1e-3)
    assert abs(beam_gain(grid, -1.0, 0.0, 0.0)) < 1e-20
    angle = np.linspace(0, np.pi, 3000)
    gain = np.array([beam_gain(grid, np.cos(a), np.sin(a), 0.0) for a in angle])
    assert np.abs(np.diff(gain)).max() < 0.01


@pytest.mark.parametrize(("speed_m_s", "shift_hz", "loss_db"), [(2.0, 622.0, -0.4), (6.3, 1983.0, -3.0)])
def test_doppler_figures_of_the_paper(speed_m_s: float, shift_hz: float, loss_db: float) -> None:
    shift = doppler_shift_hz(53e3, 343.0, speed_m_s, speed_m_s)
    assert shift == pytest.approx(shift_hz, abs=1.0)
    assert doppler_shift_hz(53e3, 343.0, -speed_m_s, -speed_m_s) < 0
    assert 20 * np.log10(band_loss(shift, 3980.0)) == pytest.approx(loss_db, abs=0.02)


def test_moving_delay_is_where_the_front_meets_the_receiver() -> None:
    d1, d2, v, c = 1.2, 1.1, 2.0, 343.0
    t = np.linspace(0, 0.01, 2_000_001)
    met = t[np.argmin(np.abs(d1 + (d2 - v * t) - c * t))]
    assert moving_delay_s(d1, d2, v, c) == pytest.approx(met, abs=1e-8)
    assert moving_delay_s(d1, d2, 0.0, c) == pytest.approx((d1 + d2) / c, rel=1e-15)
