"""Shapes: distance, lowering and mesh against surfaces sampled here, by other formulae."""

import json
import math

import numpy as np
import pytest

from saranga.errors import UsageError
from sitl.materials import load_material
from sitl.primitives import Primitives
from sitl.shapes import shape_from_table, shape_kinds
from sitl.solids import gaps_m, surface_points

UPRIGHT = {"kind": "cylinder", "x_m": 4.0, "y_m": -0.5, "diameter_m": 0.06, "height_m": 1.8}
OBLIQUE = {"kind": "cylinder", "end_a_m": [2.0, -1.0, 0.2], "end_b_m": [3.0, 1.0, 2.2], "diameter_m": 0.1}
BOX = {"kind": "box", "x_m": 5.0, "y_m": 0.4, "yaw_deg": 30.0, "length_m": 0.6, "width_m": 0.2, "height_m": 1.2}
WALL = {"kind": "wall", "from_m": [3.0, -1.0], "to_m": [4.0, 1.0], "height_m": 2.0, "thickness_m": 0.02}


def shape(table, **changes):
    return shape_from_table({**table, **changes})


def surface_of_oblique(rng, count):
    """Random points on the surface of OBLIQUE, built from its end points (heights up) with an own frame."""
    a, b = np.array([2.0, -1.0, -0.2]), np.array([3.0, 1.0, -2.2])
    axis = (b - a) / np.linalg.norm(b - a)
    first = np.cross(axis, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    turn = rng.uniform(0, 2 * np.pi, count)[:, None]
    round_it = np.cos(turn) * first + np.sin(turn) * second
    side = a + rng.uniform(0, 1, count)[:, None] * (b - a) + 0.05 * round_it
    cap = np.where(rng.random(count)[:, None] < 0.5, a, b) + 0.05 * np.sqrt(rng.random(count))[:, None] * round_it
    return np.concatenate([side, cap[: count // 5]])


def surface_of_box(rng, count):
    """Random points on the surface of BOX: its faces turned by 30 degrees from x towards y."""
    half = np.array([0.3, 0.1, 0.6])
    local = rng.uniform(-1, 1, (count, 3)) * half
    area = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    face = rng.choice(3, count, p=area / area.sum())
    local[np.arange(count), face] = np.where(rng.random(count) < 0.5, -1, 1) * half[face]
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    x = c * local[:, 0] - s * local[:, 1] + 5.0
    y = s * local[:, 0] + c * local[:, 1] + 0.4
    return np.stack([x, y, local[:, 2] - 0.6], axis=1)


@pytest.mark.parametrize(("table", "surface"), [(OBLIQUE, surface_of_oblique), (BOX, surface_of_box)])
def test_distance_is_that_to_the_nearest_surface_point(table, surface):
    rng = np.random.default_rng(5)
    skin = surface(rng, 60_000)
    centre = skin.mean(axis=0)
    points = centre + rng.uniform(-1.2, 1.2, (150, 3))
    nearest = np.array([np.linalg.norm(skin - p, axis=1).min() for p in points])
    got = shape(table).signed_distance_m(points)
    # A random sampling can only overestimate, by about the square of its spacing over the distance.
    assert np.all(np.abs(got) <= nearest + 1e-9)
    assert np.abs(np.abs(got) - nearest).max() < 0.02
    far = nearest > 0.2
    assert np.abs(np.abs(got) - nearest)[far].max() < 0.005
    assert np.median(np.abs(np.abs(got) - nearest)) < 0.001
    assert np.abs(shape(table).signed_distance_m(skin)).max() < 1e-12
    # Convex: shrunk towards the centre it lies inside, grown outside.
    assert shape(table).signed_distance_m(centre + 0.9 * (skin - centre)).max() < 0.0
    assert shape(table).signed_distance_m(centre + 1.1 * (skin - centre)).min() > 0.0


def test_distance_of_an_upright_pole_by_hand():
    points = [(4.0, -0.5, -1.0), (4.33, -0.5, -1.0), (4.0, -0.5, -2.0), (4.03, -0.5, -1.5), (4.06, -0.5, -1.84)]
    expected = [-0.03, 0.30, 0.20, 0.0, 0.05]
    assert shape(UPRIGHT).signed_distance_m(np.array(points)) == pytest.approx(expected, abs=1e-12)


def test_ends_are_flat_not_round():
    # Beside the rim, above the top: a capsule would be 0.03 m nearer.
    assert shape(UPRIGHT).signed_distance_m(np.array([[4.03, -0.5, -1.9]]))[0] == pytest.approx(0.1)


def test_wall_distance_by_hand():
    along = np.array([1.0, 2.0]) / math.sqrt(5.0)
    middle = np.array([3.5, 0.0])
    across = np.array([-along[1], along[0]])
    beside = [*(middle + 0.51 * across), -1.0]
    beyond = [*(np.array([4.0, 1.0]) + 0.3 * along), -1.0]
    over = [*middle, -2.4]
    assert shape(WALL).signed_distance_m(np.array([beside, beyond, over])) == pytest.approx([0.5, 0.3, 0.4])


def test_box_yaw_turns_from_x_towards_y():
    long_end = [5.0 + 0.3 * math.cos(math.pi / 6), 0.4 + 0.3 * math.sin(math.pi / 6), -0.6]
    mirrored = [5.0 + 0.3 * math.cos(math.pi / 6), 0.4 - 0.3 * math.sin(math.pi / 6), -0.6]
    on, off = shape(BOX).signed_distance_m(np.array([long_end, mirrored]))
    assert on == pytest.approx(0.0, abs=1e-12)
    assert off > 0.1


@pytest.mark.parametrize(("table", "volume"), [
    (UPRIGHT, 24 / 2 * math.sin(2 * math.pi / 24) * 0.03**2 * 1.8),
    (OBLIQUE, 24 / 2 * math.sin(2 * math.pi / 24) * 0.05**2 * 3.0),
    (BOX, 0.6 * 0.2 * 1.2),
    (WALL, math.sqrt(5.0) * 0.02 * 2.0),
])
def test_mesh_is_closed_outward_and_on_the_surface(table, volume):
    vertices, triangles = shape(table).mesh()
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    # Divergence theorem: the volume comes out right and positive only for a closed mesh that faces outward.
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(volume, rel=1e-9)
    assert np.abs(shape(table).signed_distance_m(vertices)).max() < 1e-9
    sides = [tuple(t[[k, (k + 1) % 3]]) for t in triangles for k in range(3)]
    assert sorted(sides) == sorted((q, p) for p, q in sides)


def test_box_lowers_to_sides_top_and_rounded_corners():
    box = shape(BOX)
    parts = box.primitives()
    assert (len(parts.facets), len(parts.cylinders), len(parts.edges)) == (5, 0, 8)
    centre = np.array([5.0, 0.4, -0.6])
    normals = np.cross(parts.facets[:, 3:6], parts.facets[:, 6:9])
    assert np.all(np.einsum("ij,ij->i", normals, parts.facets[:, :3] - centre) > 0)
    areas = 4 * parts.facets[:, 9] * parts.facets[:, 10]
    assert sorted(areas) == pytest.approx(sorted([0.12, 0.24, 0.24, 0.72, 0.72]))
    assert np.abs(box.signed_distance_m(parts.facets[:, :3])).max() < 1e-12
    # The four corners of every facet are corners of the box, so extent and axes belong together.
    corners = box.mesh()[0]
    for facet in parts.facets:
        for a in (-1, 1):
            for b in (-1, 1):
                corner = facet[:3] + a * facet[9] * facet[3:6] + b * facet[10] * facet[6:9]
                assert np.linalg.norm(corners - corner, axis=1).min() < 1e-12
    assert np.all(parts.edges[:, 10] == 0.004)
    upright = np.abs(parts.edges[:, 2] - parts.edges[:, 5]) > 1.0
    assert upright.sum() == 4
    assert len({(round(x, 6), round(y, 6)) for x, y in parts.edges[upright, :2]}) == 4
    assert np.abs(box.signed_distance_m((parts.edges[:, :3] + parts.edges[:, 3:6]) / 2)).max() < 1e-12


def test_wall_lowers_to_a_facet_with_hard_upright_edges():
    parts = shape(WALL).primitives()
    assert (len(parts.facets), len(parts.cylinders), len(parts.edges)) == (1, 0, 2)
    normal = np.cross(parts.facets[0, 3:6], parts.facets[0, 6:9])
    assert abs(normal @ [1.0, 2.0, 0.0]) < 1e-12
    assert 2 * parts.facets[0, 9] == pytest.approx(math.sqrt(5.0))
    assert np.allclose(sorted(parts.edges[:, 0]), [3.0, 4.0])
    assert np.allclose(parts.edges[:, 6:9], normal)
    assert np.all(parts.edges[:, 10] == 0.0)


def test_cylinder_lowers_to_one_cylinder_with_heights_up():
    parts = shape(OBLIQUE, material="aluminium").primitives()
    assert (len(parts.facets), len(parts.cylinders), len(parts.edges)) == (0, 1, 0)
    assert parts.cylinders[0] == pytest.approx([2, -1, -0.2, 3, 1, -2.2, 0.05, 1.0, 0.0])


def test_primitives_concatenate_in_order_and_cannot_be_written_to():
    both = Primitives.concatenate([shape(UPRIGHT).primitives(), Primitives.empty(), shape(BOX).primitives(),
                                   shape(OBLIQUE).primitives()])
    assert len(both) == 15
    assert both.cylinders[:, 6] == pytest.approx([0.03, 0.05])
    assert both.facets.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        both.cylinders[0, 0] = 1.0


@pytest.mark.parametrize("table", [UPRIGHT, OBLIQUE, BOX, WALL])
def test_table_survives_json(table):
    one = shape(table)
    again = shape_from_table(json.loads(json.dumps(one.to_table())))
    assert again == one
    assert np.array_equal(again.solids(), one.solids())


def test_gap_between_bodies_by_hand():
    pole = shape(UPRIGHT, x_m=0.0, y_m=0.0)
    oblique_box = shape(BOX, x_m=1.0, y_m=0.0, yaw_deg=0.0)
    inside = shape(UPRIGHT, x_m=1.0, y_m=0.0)
    gaps = gaps_m([s.solids() for s in (pole, oblique_box, inside)])
    assert gaps[0, 1] == pytest.approx(0.67, abs=1e-6)
    assert gaps[0, 2] == pytest.approx(0.94, abs=1e-6)
    assert gaps[1, 2] <= 0.0


def test_surface_points_are_on_the_surface_and_close_together():
    box = shape(BOX)
    points = surface_points(box.solids()[0], 0.05)
    assert np.abs(box.signed_distance_m(points)).max() < 1e-12
    probe = surface_of_box(np.random.default_rng(1), 300)
    assert max(np.linalg.norm(points - p, axis=1).min() for p in probe) < 0.05


def test_materials_follow_the_mass_law_and_roughness():
    # acoustics.md: 0.02 mm film |R| = -0.08 dB; s = 1 mm is -16 dB.
    assert 20 * math.log10(load_material("film").reflectivity) == pytest.approx(-0.08, abs=0.01)
    rough = load_material("board").model_copy(update={"roughness_m": 1e-3})
    assert 20 * math.log10(rough.reflectivity) == pytest.approx(-16.4, abs=0.1)
    assert load_material("pvc").reflectivity == 1.0
    assert 0.85 < load_material("cardboard").reflectivity < 0.95


@pytest.mark.parametrize(("table", "words"), [
    ({"kind": "sphere"}, ["'sphere'", "box, cylinder, tree, wall"]),
    ({"x_m": 1.0}, ["'kind' is missing", "cylinder"]),
    ({**UPRIGHT, "diametre_m": 0.1}, ["'diametre_m'", "did you mean 'diameter_m'", "height_m"]),
    ({**UPRIGHT, "diameter_m": -0.06}, ["diameter_m = -0.06", "greater than 0"]),
    ({**UPRIGHT, "diameter_m": math.nan}, ["diameter_m = nan", "finite"]),
    ({**UPRIGHT, "x_m": math.inf}, ["x_m = inf", "finite"]),
    ({**UPRIGHT, "x_m": "4"}, ["x_m = '4'", "number"]),
    ({**UPRIGHT, "x_m": True}, ["x_m = True", "number"]),
    ({**UPRIGHT, "material": "chrome"}, ["'chrome'", "pvc"]),
    ({"kind": "cylinder", "x_m": 1.0, "diameter_m": 0.1}, ["x_m, y_m and height_m", "given: x_m"]),
    ({**OBLIQUE, "end_b_m": [2.0, -1.0, 0.2]}, ["same point"]),
    ({**OBLIQUE, "end_b_m": [2.0, -1.0]}, ["end_b_m[2]", "missing"]),
    ({**OBLIQUE, "end_b_m": [2.0, -1.0, "up"]}, ["end_b_m[2] = 'up'", "number"]),
    ({**WALL, "to_m": [3.0, -1.0]}, ["same point"]),
    ({**BOX, "length_m": 0, "width_m": 0}, ["length_m = 0", "(and 1 more)"]),
])
def test_bad_tables_get_one_clear_line(table, words):
    with pytest.raises(UsageError) as caught:
        shape_from_table(table, "x.toml: [[obstacle]] 3:")
    text = str(caught.value)
    assert text.startswith("x.toml: [[obstacle]] 3")
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_kinds_are_found_by_their_files():
    assert shape_kinds() == ("box", "cylinder", "tree", "wall")
