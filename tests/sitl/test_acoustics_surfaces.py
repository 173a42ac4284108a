"""Spheres, rough surfaces, one bounce and film under the wash, each against its closed form."""

import numpy as np
import pytest
from scipy.optimize import minimize

from saranga.echo import load_sonar
from saranga.errors import UsageError
from sitl.acoustics.arrival import BOUNCE, CYLINDER, DIFFUSE, FACET, SPHERE, STRAIGHT
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.beam import piston_gain
from sitl.acoustics.echoes import cylinder_amplitude, diffuse_amplitude, sphere_amplitude
from sitl.acoustics.flutter import MODES, mode_phases, shape_at
from sitl.acoustics.mirrors import sphere_point
from sitl.acoustics.scatter import ready_scatterers
from sitl.acoustics.shield import load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.materials import Material, load_material
from sitl.primitives import Primitives, cylinder_row, facet_row, sphere_row
from sitl.shapes.box import Box
from sitl.shapes.wall import Wall
from sitl.validation import validate

X, Y, DOWN = np.eye(3)
LEVEL, STILL, HOVER_N = np.array([1.0, 0, 0, 0]), np.zeros(3), np.full(4, 1.128)
GEOMETRY = load_sonar("pair")
LEFT = np.array(GEOMETRY.positions_m["left"])
FLOOR = Primitives.of(facets=[facet_row(np.zeros(3), Y, X, 10.0, 10.0, 0.9, closed=True)])


def model(*parts: Primitives) -> AcousticModel:
    return AcousticModel(Primitives.concatenate(parts), StandardAir(), GEOMETRY, load_shield("none"), 1)


def heard(m: AcousticModel, way: float, height_m: float = 1.0, **more: object) -> np.ndarray:
    rows = m.arrivals("left", np.array([0.0, 0.0, -height_m]), LEVEL, STILL, **more)  # type: ignore[arg-type]
    return rows[rows[:, 7] == way]


def size(rows: np.ndarray) -> np.ndarray:
    return np.hypot(rows[:, 1], rows[:, 2])


# ---- sphere --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("r", "a"), [(0.5, 0.05), (1.0, 0.1), (1.5, 0.02)])
def test_sphere_law(r: float, a: float) -> None:
    assert sphere_amplitude(r, r, a, 1.0) == pytest.approx(a / (2 * r * (r + a)))
    assert sphere_amplitude(r, r, 1e9, 1.0) == pytest.approx(1 / (2 * r))


def test_sphere_mirrors_where_the_way_is_shortest() -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        radius, centre = rng.uniform(0.02, 0.4), rng.uniform(-1, 1, 3)
        away = rng.standard_normal(3)
        tx = centre + away / np.linalg.norm(away) * (radius + rng.uniform(0.1, 1.5))
        rx = tx + rng.uniform(-0.06, 0.06, 3)
        point = np.empty(3)
        d1, d2, cosine = sphere_point(np.array([*centre, radius]), tx, rx, point)
        assert np.linalg.norm(point - centre) == pytest.approx(radius)
        assert (d1, d2) == pytest.approx((np.linalg.norm(point - tx), np.linalg.norm(point - rx)))

        def way(p: np.ndarray, c: np.ndarray = centre, a: float = radius, t: np.ndarray = tx,
                r: np.ndarray = rx) -> float:
            on = c + a * p / np.linalg.norm(p)
            return float(np.linalg.norm(on - t) + np.linalg.norm(on - r))

        assert d1 + d2 == pytest.approx(minimize(way, point - centre, tol=1e-12).fun, abs=1e-7)
        assert 0 < cosine <= 1


def test_sphere_of_a_scene_is_heard_at_its_distance() -> None:
    rows = heard(model(Primitives.of(spheres=[sphere_row(LEFT + 1.1 * X - DOWN, 0.1, 1.0)])), STRAIGHT)
    assert list(rows[:, 5]) == [SPHERE] and rows[0, 4] == pytest.approx(2.0)
    assert size(rows)[0] == pytest.approx(0.1 / (2 * 1.1) * 10 ** (-2 * 1.76 / 20), rel=0.01)


# ---- rough surfaces ------------------------------------------------------------------------------
def test_lambert_plane_returns_half_its_albedo_over_distance_squared() -> None:
    # Integral of albedo cos^2 / (pi d^4) over a plane at distance r: albedo / (2 r^2).
    points = ready_scatterers(Primitives.of(
        facets=[facet_row(np.array([1.0, 0, 0]), Y, DOWN, 5.0, 5.0, 0.0, 0.5)])).points
    assert points[:, 6].sum() == pytest.approx(0.5 * 100.0)
    for r in (0.7, 1.0):
        at = np.array([1.0 + r, 0.0, 0.0])
        d = np.linalg.norm(points[:, :3] - at, axis=1)
        power = sum(diffuse_amplitude(q, q, r / q, r / q, 1.0, p) ** 2 for q, p in zip(d, points[:, 6], strict=True))
        assert power == pytest.approx(0.5 / (2 * r * r), rel=0.05)


def test_points_of_a_trunk_lie_on_it_and_have_its_area() -> None:
    low, high = np.array([1.0, 2.0, 0.0]), np.array([1.2, 2.0, -3.0])
    scatterers = ready_scatterers(Primitives.of(cylinders=[cylinder_row(low, high, 0.125, 0.1, 0.7)]))
    length = np.linalg.norm(high - low)
    w = (high - low) / length
    away = scatterers.points[:, :3] - low
    along = away @ w
    assert np.all((along > 0) & (along < length))
    assert np.linalg.norm(away - along[:, None] * w, axis=1) == pytest.approx(0.125)
    assert scatterers.points[:, 6].sum() == pytest.approx(0.7 * 2 * np.pi * 0.125 * length)
    assert int(scatterers.patches[-1, 9]) < len(scatterers.points)


def test_turned_mossy_box_is_still_heard_and_a_smooth_one_is_not() -> None:
    level = {}
    for material in ("moss", "cardboard"):
        box = Box(x_m=1.3, y_m=-0.05, length_m=0.6, width_m=0.6, height_m=1.3, yaw_deg=25.0, material=material)
        rows = heard(model(box.primitives()), DIFFUSE)
        level[material] = np.sqrt(np.sum(size(rows) ** 2))
        assert all(rows[:, 5] == FACET)
    assert level["cardboard"] == 0.0
    # All its power, spread over some 0.3 m of range: an infinite Lambert plane gives sqrt(0.4 / 2) r^-1, -1 dB re the
    # mirror's 1/2; a third of it, the air and the beam leave some 10 dB less.
    assert -16 < 20 * np.log10(level["moss"] / 0.5) < -7


def test_rough_side_of_a_box_is_hidden_by_what_stands_before_it() -> None:
    box = Box(x_m=1.3, y_m=-0.05, length_m=0.3, width_m=0.5, height_m=1.3, material="moss").primitives()
    screen = Wall(from_m=(0.6, -1.5), to_m=(0.6, 1.5), height_m=2.5).primitives()
    alone, behind = (np.sum(size(heard(model(*parts), DIFFUSE)) ** 2) for parts in ((box,), (box, screen)))
    assert behind < 1e-3 * alone


def test_trunk_fades_from_place_to_place_as_speckle_does() -> None:
    bark = load_material("bark")
    trunk = Primitives.of(cylinders=[cylinder_row(np.array([1.2, 0, 0.0]), np.array([1.2, 0, -4.0]), 0.125,
                                                  bark.reflectivity, bark.albedo)])
    m = model(trunk)
    quiet = AcousticModel(trunk, StandardAir(), GEOMETRY, load_shield("none"), 1)
    peaks = []
    for k in range(60):
        record = quiet.cycle(np.array([0.0, 0.004 * k, -1.0 - 0.01 * k]), LEVEL, STILL, np.zeros(4), 0)["left"]
        peaks.append(np.hypot(*record[140:190].astype(float).T).max())
    assert 0.1 < np.std(peaks) / np.mean(peaks) < 0.6
    # acoustics.md: the coherent part alone is 16 dB under a smooth trunk; with the diffuse part it is some 7 dB under.
    smooth = cylinder_amplitude(0.995, 0.995, 0.125, 1.0) * 10 ** (-2 * 1.76 / 20) * m.gain_counts
    assert -12 < 20 * np.log10(np.mean(peaks) / smooth) < -3


def test_a_surface_cannot_scatter_what_it_absorbs_or_mirrors() -> None:
    table = {"name": "x", "description": "", "source": "", "absorbed": 0.5, "roughness_m": 0.001}
    assert validate(Material, table | {"albedo": 0.2}, "x").reflectivity == pytest.approx(0.5 * 0.152, abs=0.001)
    with pytest.raises(UsageError, match=r"albedo = 0.3, but roughness and absorption leave 0.244"):
        validate(Material, table | {"albedo": 0.3}, "x")
    with pytest.raises(UsageError, match=r"albedo = 0\.1"):
        validate(Material, {"name": "x", "description": "", "source": "", "albedo": 0.1}, "x")


# ---- one bounce ----------------------------------------------------------------------------------
def test_pole_and_floor_make_a_corner_echo() -> None:
    height, away = 0.6, 0.9
    foot = LEFT + (away + 0.03) * X
    pole = Primitives.of(cylinders=[cylinder_row(foot, foot - 2.0 * DOWN, 0.03, 1.0)])
    rows = heard(model(pole, FLOOR), BOUNCE, height)
    rows = rows[rows[:, 5] == CYLINDER]
    # Floor first and pole first: the same way, over the point where the pole meets the floor.
    slant = np.hypot(away, height)
    assert rows[:, 4] == pytest.approx([2 * slant, 2 * slant], abs=1e-6)
    beam = float(piston_gain(0.0, height / slant, 2 * np.pi * 53e3 / 343.2, GEOMETRY.a_h_m, GEOMETRY.a_v_m))
    wanted = 0.9 * 0.5 * cylinder_amplitude(slant, slant, 0.03, 1.0) * beam**2 * 10 ** (-2 * slant * 1.76 / 20)
    # Half of each: the mirror point is the pole's end, the bounce the same place.
    assert size(rows) == pytest.approx([wanted, wanted], rel=0.03)
    assert len(heard(model(pole), BOUNCE, height)) == 0


def test_corner_of_two_walls_is_heard_over_its_edge() -> None:
    walls = [Wall(from_m=(1.0, -1.5), to_m=(1.0, 0.5), height_m=2.5), Wall(from_m=(-1.0, 0.5), to_m=(1.0, 0.5),
                                                                           height_m=2.5)]
    rows = heard(model(*(w.primitives() for w in walls)), BOUNCE)
    corner = 2 * np.hypot(1.0 - LEFT[0], 0.5 - LEFT[1])
    assert np.abs(rows[:, 4] - corner).min() < 1e-6
    # Image over both faces: 1 / way, as from a plane.
    best = rows[np.argmin(np.abs(rows[:, 4] - corner))]
    assert best[5] == FACET


def test_faces_of_one_box_do_not_mirror_each_other() -> None:
    for yaw_deg in (0.0, 20.0, 45.0):
        box = Box(x_m=0.9, y_m=0.1, length_m=0.6, width_m=0.6, height_m=2.0, yaw_deg=yaw_deg)
        assert len(heard(model(box.primitives()), BOUNCE)) == 0


def test_a_screen_in_the_way_of_the_bounce_silences_it() -> None:
    foot = LEFT + 0.93 * X
    pole = Primitives.of(cylinders=[cylinder_row(foot, foot - 2.0 * DOWN, 0.03, 1.0)])
    low = Wall(from_m=(0.5, -1.0), to_m=(0.5, 1.0), height_m=0.45).primitives()
    open_, shut = (size(heard(model(*parts), BOUNCE, 0.6)) for parts in ((pole, FLOOR), (pole, FLOOR, low)))
    pole_rows = heard(model(pole, FLOOR, low), BOUNCE, 0.6)
    pole_rows = pole_rows[pole_rows[:, 5] == CYLINDER]
    assert size(pole_rows).sum() < 0.05 * open_.sum()
    assert np.isfinite(shut).all()


# ---- film ----------------------------------------------------------------------------------------
def film(x_m: float) -> AcousticModel:
    return model(Wall(from_m=(x_m, -0.7), to_m=(x_m, 0.6), height_m=1.5, material="film").primitives())


def test_film_is_a_mirror_and_still_without_wash() -> None:
    rest = [heard(film(1.08), STRAIGHT, t_us=t, thrust_n=np.zeros(4)) for t in (0, 50_000, 111_000)]
    assert np.array_equal(rest[0], rest[1]) and np.array_equal(rest[0], rest[2])
    echo = rest[0][rest[0][:, 5] == FACET][0]
    assert echo[4] == pytest.approx(2.0)
    assert 20 * np.log10(np.hypot(echo[1], echo[2]) / (0.5 * 10 ** (-2 * 1.76 / 20))) == pytest.approx(-0.08, abs=0.1)


def test_wash_moves_the_film_as_its_modes_say_and_by_distance_squared() -> None:
    swing = {}
    for x_m in (0.88, 1.28):
        m = film(x_m)
        ways = []
        for t_us in range(0, 2_000_000, 20_000):
            rows = heard(m, STRAIGHT, t_us=t_us, thrust_n=HOVER_N)
            ways.append(rows[rows[:, 5] == FACET][0, 4])
        swing[x_m] = np.std(ways)
        # Twice the displacement is the change of the way: some millimetres, of the order of the wavelength.
        assert 0.5e-3 < swing[x_m] < 20e-3
    assert swing[0.88] / swing[1.28] == pytest.approx((1.2 / 0.8) ** 2, rel=0.1)
    still = [heard(model(Wall(from_m=(1, -0.7), to_m=(1, 0.6), height_m=1.5).primitives()), STRAIGHT, t_us=t)
             for t in (0, 70_000)]
    assert np.array_equal(*still)


def test_bearing_of_the_film_wanders_as_its_slope() -> None:
    m, differences = film(1.08), []
    for t_us in range(0, 1_000_000, 25_600):
        way = {}
        for role in ("left", "right"):
            rows = m.arrivals(role, np.array([0.0, 0.0, -0.75]), LEVEL, STILL, t_us=t_us, thrust_n=HOVER_N)
            way[role] = rows[(rows[:, 5] == FACET)][0, 4]
        differences.append(way["left"] - way["right"])
    # asin(difference / baseline): degrees, not tenths and not tens.
    assert 0.1 < np.degrees(np.std(differences) / 0.1) < 8.0


def test_slopes_and_curvatures_are_derivatives_of_the_shape() -> None:
    row = np.array([0, 0, 0, 0, 1, 0, 0, 0, 1, 0.65, 0.7, 1.0, 0, 0.003, 0], dtype=float)
    phases, h = mode_phases(row), 1e-4
    assert len(phases) == len(MODES)
    for u, v, t in ((0.1, -0.2, 0.0), (-0.5, 0.6, 0.37)):
        w, wu, wv, wuu, wvv = shape_at(row, u, v, t, phases)
        right, left, up, down = (shape_at(row, u + du, v + dv, t, phases)[0]
                                 for du, dv in ((h, 0), (-h, 0), (0, h), (0, -h)))
        assert (wu, wv) == pytest.approx(((right - left) / 2 / h, (up - down) / 2 / h), abs=1e-5)
        assert (wuu, wvv) == pytest.approx(((right - 2 * w + left) / h**2, (up - 2 * w + down) / h**2), abs=1e-3)
    assert shape_at(row, 0.65, 0.1, 0.2, phases)[0] == pytest.approx(0.0, abs=1e-12)
