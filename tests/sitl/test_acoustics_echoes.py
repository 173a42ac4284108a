"""Echo amplitudes and mirror points against acoustics.md, brute force, and exact Fresnel integrals."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import fresnel

from sitl.acoustics.echoes import (
    arc_radius,
    cylinder_amplitude,
    edge_amplitude,
    fresnel_radius,
    mirror_share,
    plane_amplitude,
)
from sitl.acoustics.mirrors import cylinder_point, facet_point

WAVELENGTH = 6.47e-3
WAVENUMBER = 971.0


def db(ratio: float) -> float:
    return float(20 * np.log10(ratio))


@pytest.mark.parametrize(("diameter_m", "level_db"),
                         [(0.025, -19.1), (0.040, -17.1), (0.060, -15.4), (0.250, -9.5), (0.460, -7.3)])
def test_cylinder_re_plane_at_1_m(diameter_m: float, level_db: float) -> None:
    ratio = cylinder_amplitude(1, 1, diameter_m / 2, 1.0) / plane_amplitude(1, 1)
    assert db(ratio) == pytest.approx(level_db, abs=0.06)


@pytest.mark.parametrize("r", [0.3, 1.0, 1.6])
def test_monostatic_laws(r: float) -> None:
    assert plane_amplitude(r, r) == pytest.approx(1 / (2 * r))
    assert cylinder_amplitude(r, r, 0.03, 1.0) == pytest.approx(np.sqrt(0.03 / (0.03 + r)) / (2 * r))
    assert cylinder_amplitude(r, r, 1e9, 1.0) == pytest.approx(plane_amplitude(r, r))


@pytest.mark.parametrize(("absorption_db_m", "total_db"), [(4.7 / 3, 16.7), (5.3 / 3, 17.3)])
def test_the_papers_17_db_is_a_flat_target(absorption_db_m: float, total_db: float) -> None:
    spreading = db(plane_amplitude(0.5, 0.5) / plane_amplitude(2.0, 2.0))
    assert spreading == pytest.approx(12.04, abs=0.01)
    assert spreading + 3.0 * absorption_db_m == pytest.approx(total_db, abs=0.05)
    pole = db(cylinder_amplitude(0.5, 0.5, 0.03, 1.0) / cylinder_amplitude(2.0, 2.0, 0.03, 1.0))
    assert 22.4 < pole + 3.0 * absorption_db_m < 23.3


def test_hard_edge_is_33_db_under_the_plane() -> None:
    cosine = np.cos(np.radians(45.0))
    edge = edge_amplitude(1.0, 1.0, cosine, cosine, WAVENUMBER)
    keller = abs(1 + 1 / cosine) / (2 * np.sqrt(2 * np.pi * WAVENUMBER)) * np.sqrt(0.5)
    assert edge == pytest.approx(keller, rel=1e-6)
    assert db(edge / 0.5) == pytest.approx(-33.2, abs=0.3)


@pytest.mark.parametrize(("corner_m", "level_db"), [(0.003, -25.2), (0.005, -23.0)])
def test_rounded_box_corner(corner_m: float, level_db: float) -> None:
    assert db(cylinder_amplitude(1, 1, corner_m, 1.0) / 0.5) == pytest.approx(level_db, abs=0.1)


def test_edge_stays_small_where_the_face_mirrors() -> None:
    # Keller's own law is unbounded at phi = 90 degrees.
    phi = np.radians(np.linspace(60, 120, 4001))
    level = np.array([edge_amplitude(1.0, 1.0, c, c, WAVENUMBER) for c in np.cos(phi)])
    assert np.abs(level).max() < 0.5 * plane_amplitude(1.0, 1.0)
    assert np.abs(np.diff(level)).max() < 0.02


@pytest.mark.parametrize(("r", "radius_m"), [(0.5, 0.040), (1.0, 0.057), (1.66, 0.073)])
def test_fresnel_radius(r: float, radius_m: float) -> None:
    assert fresnel_radius(WAVELENGTH, r, r) == pytest.approx(radius_m, abs=0.0005)
    assert arc_radius(WAVELENGTH, r, r, 1e9, 1.0) == pytest.approx(fresnel_radius(WAVELENGTH, r, r), rel=1e-6)


def exact_share(low: float, high: float) -> float:
    """|Kirchhoff| of a mirror that ends `low` and `high` Fresnel radii from the mirror point."""
    s1, c1 = fresnel(np.sqrt(2) * high)
    s0, c0 = fresnel(-np.sqrt(2) * low)
    return float(abs((c1 - c0) + 1j * (s1 - s0)) / np.sqrt(2))


def test_border_of_a_mirror_against_the_fresnel_integral() -> None:
    assert mirror_share(0.0, 50.0, 1.0) == 0.5
    assert exact_share(0.0, 50.0) == pytest.approx(0.5, abs=0.01)
    assert mirror_share(6.0, 6.0, 1.0) == pytest.approx(1.0, abs=1e-6)
    for half in (0.02, 0.1, 0.2):
        assert mirror_share(half, half, 1.0) == pytest.approx(exact_share(half, half), rel=0.05)
    # Away from the border it is the ripple's mean.
    inside = np.linspace(1.0, 4.0, 400)
    assert np.mean([exact_share(x, 80.0) for x in inside]) == pytest.approx(
        np.mean([mirror_share(x, 80.0, 1.0) for x in inside]), abs=0.03)


def test_facet_mirror_point_is_the_shortest_way() -> None:
    row = np.array([1.5, 0.2, -1.0, 0, 1, 0, 0, 0, 1, 0.6, 0.5, 1.0], dtype=float)
    tx, rx, point = np.array([0.1, -0.3, -1.1]), np.array([0.3, 0.4, -0.9]), np.empty(3)
    d1, d2, u, v = facet_point(row, tx, rx, point)
    mirrored = rx.copy()
    mirrored[0] = 2 * 1.5 - rx[0]
    assert d1 + d2 == pytest.approx(np.linalg.norm(tx - mirrored))
    assert d1 == pytest.approx(np.linalg.norm(point - tx))
    assert (1.5, 0.2 + u, -1.0 + v) == pytest.approx(tuple(point))
    assert facet_point(row, tx, np.array([2.0, 0, -1.0]), point)[0] == 0.0


def test_cylinder_mirror_point_is_the_shortest_way() -> None:
    rng = np.random.default_rng(11)
    for _ in range(200):
        radius = rng.uniform(0.005, 0.4)
        bearing, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(-0.6, 0.6)
        w = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
        a = rng.uniform(-1, 1, 3)
        away = np.cross(w, [np.cos(bearing), np.sin(bearing), 0.0])
        away /= np.linalg.norm(away)
        tx = a + (radius + rng.uniform(0.1, 1.5)) * away + rng.uniform(-0.5, 0.5) * w
        rx = tx + rng.uniform(-0.06, 0.06, 3)
        point = np.empty(3)
        d1, d2, z, cosine = cylinder_point(a, w, radius, tx, rx, point)
        offset = point - a - z * w
        assert np.linalg.norm(offset) == pytest.approx(radius)
        assert abs(offset @ w) < 1e-9
        assert d1 == pytest.approx(np.linalg.norm(point - tx))
        assert d2 == pytest.approx(np.linalg.norm(point - rx))
        e1 = offset / radius
        e2 = np.cross(w, e1)

        def path(angle: float, e1: np.ndarray = e1, e2: np.ndarray = e2, a: np.ndarray = a, w: np.ndarray = w,
                 tx: np.ndarray = tx, rx: np.ndarray = rx, radius: float = radius) -> float:
            ring = a + radius * (np.cos(angle) * e1 + np.sin(angle) * e2)

            def length(s: float) -> float:
                return float(np.linalg.norm(ring + s * w - tx) + np.linalg.norm(ring + s * w - rx))

            return float(minimize_scalar(length, bounds=(-4, 4), method="bounded", options={"xatol": 1e-10}).fun)

        best = minimize_scalar(path, bounds=(-0.5, 0.5), method="bounded", options={"xatol": 1e-9})
        assert d1 + d2 == pytest.approx(best.fun, abs=1e-7)
        assert 0 < cosine <= 1
