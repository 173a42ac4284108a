"""Motion, path lengths and strengths against formulae that are not the module's own."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import j1
from synthesis_helpers import C_M_S, COLUMN_M, FOP_HZ, draw, fit_row, only, path

from saranga.localise import localise
from saranga.sonar_geometry import load_sonar
from saranga.synthesis import paths
from sitl.acoustics.doppler import band_loss, doppler_shift_hz, moving_delay_s

LEFT, RIGHT = np.array([0.0, -0.05, 0.0]), np.array([0.0, 0.05, 0.0])
K = 2 * math.pi * FOP_HZ / C_M_S


@pytest.mark.parametrize("theta", [-0.9, -0.2, 0.0, 0.4])
def test_arc_is_the_papers_equation_3(theta):
    """The obstacle lies `l` outside the arc on the radius of the newest place; errata: rho = 2, l = 1, 0 gives 1."""
    rho, l_m = 2.0, 1.0
    x, y = paths.arc_displacement(rho * theta, 0.0, 1.0 / rho)
    d = math.hypot(x, y + l_m)
    assert d == pytest.approx(math.sqrt(rho**2 + (rho + l_m) ** 2 - 2 * (rho + l_m) * rho * math.cos(theta)), rel=1e-12)
    if abs(theta) < 0.3:
        assert d == pytest.approx(l_m + rho * (rho + l_m) * (1 - math.cos(theta)) / l_m, rel=0.02)


def test_arc_of_no_curvature_is_straight():
    assert paths.arc_displacement(-0.8, 0.3, 1e-9) == pytest.approx((-0.8 * math.cos(0.3), -0.8 * math.sin(0.3)))


@pytest.mark.parametrize(("x", "y", "radius"), [(1.0, 0, 0.03), (0.5, 0.6, 0.23), (0.25, -0.2, 0.1), (1.5, 0.9, 0.01)])
def test_cylinder_path_is_the_shortest_one(x, y, radius):
    """Fermat: the mirror point of a convex body makes the path shortest."""
    def way(angle: float) -> float:
        p = np.array([x + radius * math.cos(angle), y + radius * math.sin(angle), 0.0])
        return float(np.linalg.norm(p - LEFT) + np.linalg.norm(p - RIGHT))
    toward = math.atan2(-y, -x)
    best = minimize_scalar(way, bounds=(toward - 0.5, toward + 0.5), method="bounded", options={"xatol": 1e-9})
    assert sum(paths.cylinder_legs(x, y, radius, LEFT, RIGHT)) == pytest.approx(best.fun, abs=2e-5)
    assert sum(paths.cylinder_legs(x, y, radius, LEFT, LEFT)) == pytest.approx(
        2 * (math.hypot(x, y + 0.05) - radius), abs=1e-12)


@pytest.mark.parametrize(("azimuth", "distance"), [(0.0, 1.0), (0.7, 0.6), (-1.0, 0.4)])
def test_plane_path_is_the_shortest_one(azimuth, distance):
    n, along = np.array([math.cos(azimuth), math.sin(azimuth), 0]), np.array([-math.sin(azimuth), math.cos(azimuth), 0])
    best = minimize_scalar(lambda t: float(np.linalg.norm(distance * n + t * along - LEFT)
                                           + np.linalg.norm(distance * n + t * along - RIGHT)), bounds=(-1, 1),
                           method="bounded", options={"xatol": 1e-9})
    assert sum(paths.plane_legs(n[0], n[1], distance, LEFT, RIGHT)) == pytest.approx(best.fun, abs=1e-9)


def test_strengths_are_those_of_the_fact_sheet():
    """dB re a plane at 1 m (acoustics.md): cylinders by diameter, Keller's edge at 45 degrees."""
    def db(kind: int, size: float, r: float = 1.0) -> float:
        return 20 * math.log10(paths.strength(kind, r, r, size, K) / 0.5)
    for diameter, level in ((0.025, -19.1), (0.04, -17.1), (0.06, -15.4), (0.25, -9.5), (0.46, -7.3)):
        assert db(paths.CYLINDER, diameter / 2) == pytest.approx(level, abs=0.06)
    assert db(paths.EDGE, 1 + math.sqrt(2)) == pytest.approx(-33, abs=0.6)
    sphere = 0.02
    assert db(paths.POINT, sphere, 0.7) == pytest.approx(20 * math.log10(2 * sphere / (1.4 * 0.72)), abs=1e-9)
    assert db(paths.PLANE, 0, 0.5) == pytest.approx(6.02, abs=0.01)


def test_strengths_off_axis_are_those_of_the_flown_world():
    echoes = pytest.importorskip("sitl.acoustics.echoes")
    d1, d2 = 0.9, 1.1
    assert paths.strength(paths.PLANE, d1, d2, 0, K) == pytest.approx(echoes.plane_amplitude(d1, d2))
    pole = echoes.cylinder_amplitude(d1, d2, 0.03, 1.0)
    assert paths.strength(paths.CYLINDER, d1, d2, 0.03, K) == pytest.approx(pole)
    edge = echoes.edge_amplitude(d1, d2, math.cos(1.0), math.cos(1.0), K)
    assert paths.strength(paths.EDGE, d1, d2, 1 + 1 / math.cos(1.0), K) == pytest.approx(edge, rel=0.02)


def test_piston_against_scipy():
    for h, v in ((0.3, 0.0), (0.94, 0.0), (0.2, 0.48), (0.9, 0.4)):
        x = K * math.hypot(1.8e-3 * h, 3.5e-3 * v)
        assert paths.piston(h, v, K * 1.8e-3, K * 3.5e-3) == pytest.approx(2 * j1(x) / x, abs=1e-3)


@pytest.mark.parametrize("kind", ["plane", "cylinder", "point"])
def test_delay_amplitude_and_phase_of_every_echo(kind):
    """Fitting the closed-form pulse at the closed-form delay gives the drawn strength and exp(-2j pi fop tau)."""
    batch = draw(only(kind) | path("hover") | {"motion.sway_m": [0, 0]}, 60)
    t = batch.truth
    r, az, size = (t[key][:, 0].astype(float) for key in ("range_m", "azimuth_rad", "size"))
    x, y = r * np.cos(az), r * np.sin(az)
    if kind == "plane":
        left = 2 * (r + 0.05 * np.sin(az))
        right = np.hypot(left * np.cos(az), left * np.sin(az) - 0.10)
    else:
        reach = r + (size if kind == "cylinder" else 0)
        x, y, body = reach * np.cos(az), reach * np.sin(az), size if kind == "cylinder" else 0
        left = 2 * (np.hypot(x, y + 0.05) - body)
        right = np.hypot(x, y + 0.05) + np.hypot(x, y - 0.05) - 2 * body
    assert np.allclose(t["path_m"][:, 0, 0], left, atol=1e-6)
    assert np.allclose(t["path_m"][:, 1, 0], right, atol=2e-3 if kind == "cylinder" else 1e-6)
    for k in range(60):
        for role in (0, 1):
            way = float(t["path_m"][k, role, 0])
            got = fit_row(batch.iq[k, role, -1], way / (2 * COLUMN_M))
            want = 10 ** (t["snr_db"][k, role, 0] / 20) * t["noise_rms"][k]
            turn = np.exp(2j * np.pi * FOP_HZ * way / C_M_S)
            assert got * turn == pytest.approx(want, rel=0.01)
    assert np.allclose(t["psnr_db"], 60, atol=1e-4) and np.allclose(t["snr_db"][:, 0, 0], 60, atol=1e-4)


def test_strength_over_range_is_spreading_and_absorption():
    """A plane flown at: amplitude * 2 r * 10^(2 alpha r / 20) is the same in every cycle (acoustics.md)."""
    steady = {"motion.closing_m_s": [1.0, 1.0], "motion.sideways_m_s": [0, 0], "motion.acceleration_m_s2": [0, 0]}
    batch = draw(only("plane") | path("straight") | steady | {"obstacles.range_m": [0.3, 0.6]}, 10)
    for k in range(10):
        ways = batch.truth["path_m"][k, 0, 0] + 2 * 0.0256 * np.arange(31, -1, -1)
        size = [abs(fit_row(row, w / (2 * COLUMN_M))) for row, w in zip(batch.iq[k, 0], ways, strict=True)]
        flat = np.array(size) * ways * 10 ** (1.5 * ways / 20)
        assert np.ptp(flat) / flat.mean() < 0.02


@pytest.mark.parametrize("azimuth_deg", [-50.0, -20.0, 0.0, 35.0, 60.0])
def test_disparity_between_the_sensors_gives_the_azimuth(azimuth_deg):
    """Path lengths go through Algorithm 1, which assumes points, and come out where the point was."""
    batch = draw(only("point") | {"obstacles.azimuth_deg": [azimuth_deg, azimuth_deg]}, 20)
    for truth in batch.truth:
        left, right = (np.array([float(p)]) for p in truth["path_m"][:, 0])
        assert np.sign(left - right) == np.sign(azimuth_deg)
        found = localise(left, right, None, load_sonar("pair"))[0]
        assert math.degrees(found.azimuth_rad) == pytest.approx(azimuth_deg, abs=0.35)
        assert found.range_m == pytest.approx(truth["range_m"][0], abs=4e-3)


def test_label_columns_of_both_sensors_carry_the_disparity():
    batch = draw(only("cylinder") | path("arc"), 200)
    for role in (0, 1):
        rows, columns = np.nonzero(batch.labels[:, role, -1])
        assert (columns == np.floor(batch.truth["path_m"][rows, role, 0] / (2 * COLUMN_M))).mean() > 0.995
        assert len(rows) == 200


def test_doppler_delay_and_loss_as_in_the_flown_world():
    values = only("plane") | path("straight") | {"motion.closing_m_s": [3, 3], "motion.sideways_m_s": [0, 0],
                                                 "motion.acceleration_m_s2": [0, 0], "obstacles.azimuth_deg": [0, 0],
                                                 "obstacles.range_m": [0.5, 0.5]}
    still, moving = (draw(values | {"motion.doppler": flag}, 1) for flag in (False, True))
    delay = moving_delay_s(0.5, 0.5, 3.0, C_M_S) * C_M_S / (2 * COLUMN_M)
    fine = np.linspace(delay - 2, delay + 2, 401)
    best = fine[np.argmax([abs(fit_row(moving.iq[0, 0, -1], d)) for d in fine])]
    assert best == pytest.approx(delay, abs=0.06) and 0.5 / COLUMN_M - best > 1.0
    # PSNR is drawn after the loss, so it shows where the speed changes: 3 m/s now, none eleven cycles ago
    values["motion.acceleration_m_s2"] = [10.6, 10.6]
    still, moving = (draw(values | {"motion.doppler": flag}, 1) for flag in (False, True))
    rows = [31, 20]
    t = -0.0256 * (31 - np.array(rows))
    speed = 3.0 + 10.6 * t
    ratio = [np.abs(moving.iq[0, 0, m]).max() / np.abs(still.iq[0, 0, m]).max() for m in rows]
    loss = [band_loss(doppler_shift_hz(FOP_HZ, C_M_S, v, v), 3980.0) for v in speed]
    assert ratio[1] / ratio[0] == pytest.approx(loss[1] / loss[0], rel=0.02) and loss[1] / loss[0] > 1.05
