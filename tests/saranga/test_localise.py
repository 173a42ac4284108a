"""Algorithm 1 against plain geometry: true positions in, paths by Pythagoras, positions out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from saranga.errors import UsageError
from saranga.localise import edges, localise
from saranga.resample import COLUMN_M
from saranga.sonar_geometry import load_sonar

PAIR = load_sonar("pair")
TRIPLE = load_sonar("triple")


def paths(points: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Paths of points (x, y) from the middle of the pair, as the two sensors see them."""
    half = PAIR.baseline_h_m / 2
    r_left = np.array([np.hypot(x, y + half) for x, y in points])
    r_right = np.array([np.hypot(x, y - half) for x, y in points])
    return 2 * r_left, r_left + r_right


@pytest.mark.parametrize("azimuth_deg", [-60, -30, -5, 0, 10, 45, 60])
@pytest.mark.parametrize("range_m", [0.4, 1.0, 1.6])
def test_position_in_the_plane(azimuth_deg: float, range_m: float) -> None:
    x, y = range_m * np.cos(np.radians(azimuth_deg)), range_m * np.sin(np.radians(azimuth_deg))
    (found,) = localise(*paths([(x, y)]), None, PAIR)
    assert found.y_m == pytest.approx(y, abs=0.003)
    assert found.x_m == pytest.approx(x, abs=0.005)
    assert found.range_m == pytest.approx(range_m, abs=0.005)
    assert np.degrees(found.azimuth_rad) == pytest.approx(azimuth_deg, abs=0.5)
    assert found.z_m == 0.0 and found.elevation_rad == 0.0


def test_nearer_to_the_right_sensor_is_positive_y() -> None:
    (found,) = localise([2.02], [2.00], None, PAIR)
    assert found.y_m > 0.0


def test_direction_cosines_in_space_where_the_printed_equations_are_13_percent_short() -> None:
    # far field: azimuth-plane cosine 0.5 (30 deg off), elevation cosine 0.5
    r = 1.2
    (found,) = localise([2 * r], [2 * r - 0.5 * TRIPLE.baseline_h_m], [2 * r - 0.5 * TRIPLE.baseline_v_m], TRIPLE)
    assert (found.y_m, found.z_m) == (pytest.approx(0.6), pytest.approx(0.6))
    assert found.x_m == pytest.approx(r * np.sqrt(0.5))
    assert np.hypot(np.hypot(found.x_m, found.y_m), found.z_m) == pytest.approx(r)
    printed_y = r * np.cos(np.radians(30)) * np.sin(np.radians(30))
    assert printed_y / found.y_m == pytest.approx(0.866, abs=0.001)


def test_position_in_space_from_true_paths() -> None:
    rng = np.random.default_rng(3)
    left = np.array([0.0, 0.0, 0.0])
    right = left + np.array([0.0, TRIPLE.baseline_h_m, 0.0])
    down = left + np.array([0.0, 0.0, TRIPLE.baseline_v_m])
    for _ in range(50):
        point = np.array([rng.uniform(0.6, 1.4), rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6)])
        r_l, r_r, r_d = (float(np.linalg.norm(point - s)) for s in (left, right, down))
        (found,) = localise([2 * r_l], [r_l + r_r], [r_l + r_d], TRIPLE)
        # y and z are from the middles of their pairs; p_L / 2 for the mean range costs up to dp^2 / (2 b) = 1.3 cm here
        expected = point - [0.0, TRIPLE.baseline_h_m / 2, TRIPLE.baseline_v_m / 2]
        assert np.abs(np.array([found.x_m, found.y_m, found.z_m]) - expected).max() < 0.035
        assert found.range_m == pytest.approx(float(np.linalg.norm(point)), abs=1e-6)


def test_triplet_with_imaginary_root_is_rejected() -> None:
    b_h, b_v = TRIPLE.baseline_h_m, TRIPLE.baseline_v_m
    assert localise([2.0], [2.0 - 0.8 * b_h], [2.0 - 0.8 * b_v], TRIPLE) == []
    assert len(localise([2.0], [2.0 - 0.7 * b_h], [2.0 - 0.7 * b_v], TRIPLE)) == 1


@pytest.mark.parametrize("matching", ["one_to_one", "median"])
def test_disparity_over_the_baseline(matching: str) -> None:
    b = PAIR.baseline_h_m
    assert localise([2.0], [2.0 - 1.2 * b], None, PAIR, matching=matching) == []
    (clamped,) = localise([2.0], [2.0 - 1.1 * b], None, PAIR, matching=matching)
    assert np.degrees(clamped.azimuth_rad) == pytest.approx(90.0)
    assert clamped.x_m == pytest.approx(0.0, abs=1e-9)
    assert localise([2.0], [2.0 - 1.1 * b], None, PAIR, matching=matching, tolerance=0.0) == []


def test_median_is_over_the_matches_of_each_left_path() -> None:
    # left edge three columns wide, right edge three columns wide, same place: every median disparity is its own
    step = 0.00648
    wide = np.array([-step, 0.0, step])
    found = localise(2.0 + wide, 1.98 + wide, None, PAIR, matching="median")
    sines = [o.y_m / o.range_m for o in found]
    assert sines == [pytest.approx((0.02 + d) / 0.1) for d in wide]


def test_one_to_one_is_the_best_assignment() -> None:
    rng = np.random.default_rng(5)
    far = 10.0
    for _ in range(100):
        left = np.sort(rng.uniform(0.5, 1.2, rng.integers(1, 6)))
        right = np.sort(rng.uniform(0.5, 1.2, rng.integers(1, 6)))
        gap = left[:, None] - right[None, :]
        cost = np.where(np.abs(gap) <= 0.1, gap**2, far)
        rows, columns = linear_sum_assignment(cost)
        best = {i: gap[i, j] for i, j in zip(rows, columns, strict=True) if cost[i, j] < far}
        found = localise(left, right, None, PAIR, tolerance=0.0)
        assert len(found) == len(best)
        assert sum((o.y_m / o.range_m * 0.1) ** 2 for o in found) == pytest.approx(sum(g * g for g in best.values()))


def test_one_to_one_localises_better_than_the_median_among_several() -> None:
    """Perception.md: with 3 obstacles and perfect edges 10 % of the median's azimuths are off by over 10 degrees."""
    rng = np.random.default_rng(11)
    wrong = {"one_to_one": 0, "median": 0}
    for _ in range(300):
        points = [(r * np.cos(a), r * np.sin(a)) for r, a in zip(rng.uniform(0.4, 1.6, 3), rng.uniform(-1, 1, 3),
                                                                strict=True)]
        left, right = paths(points)
        for matching in wrong:
            for o in localise(left, right, None, PAIR, matching=matching):  # type: ignore[arg-type]
                miss = min(abs(np.degrees(np.arctan2(y, x) - o.azimuth_rad)) + 1e3 * (abs(np.hypot(x, y) - o.range_m)
                           > 0.03) for x, y in points)
                wrong[matching] += miss > 10.0
    assert wrong["one_to_one"] < wrong["median"]


def test_sorted_by_range_with_the_left_strengths() -> None:
    found = localise([2.4, 1.2, 1.8], [1.2, 1.8, 2.4], None, PAIR, [0.9, 0.5, 0.7])
    assert [o.range_m for o in found] == [pytest.approx(0.6), pytest.approx(0.9), pytest.approx(1.2)]
    assert [o.score for o in found] == [0.5, 0.7, 0.9]


@pytest.mark.parametrize("empty", [([], []), ([1.0], []), ([], [1.0])])
def test_nothing_seen_is_no_obstacle(empty: tuple[list[float], list[float]]) -> None:
    assert localise(*empty, None, PAIR) == []
    assert localise(*empty, [], TRIPLE) == []


def test_zero_and_negative_paths_are_no_obstacle() -> None:
    assert localise([0.0, -0.1], [0.0, -0.1], None, PAIR) == []


def test_baseline_comes_from_the_geometry() -> None:
    wide = replace(PAIR, baseline_h_m=0.2)
    (found,) = localise([2.0], [1.9], None, wide)
    assert found.y_m / found.range_m == pytest.approx(0.5)


def test_unknown_matching_names_the_known_ones() -> None:
    with pytest.raises(UsageError, match="one_to_one, median"):
        localise([1.0], [1.0], None, PAIR, matching="hungarian")  # type: ignore[arg-type]


def test_every_column_over_the_threshold_or_one_position_a_run() -> None:
    row = np.zeros(512, dtype=np.float32)
    row[100:103] = 0.6, 0.9, 0.6
    row[300] = 0.8
    columns, strengths = edges(row, 0.5, refine=False)
    assert columns == pytest.approx(2 * COLUMN_M * np.array([100, 101, 102, 300]))
    columns, strengths = edges(row, 0.5)
    assert columns == pytest.approx(2 * COLUMN_M * np.array([101, 300]))
    assert strengths == pytest.approx([0.9, 0.8])


def test_two_columns_carry_a_position_between_them() -> None:
    row = np.zeros(512, dtype=np.float32)
    row[200:202] = 0.9, 0.3  # the second is under the threshold and still counts
    columns, _ = edges(row, 0.5)
    assert columns[0] / (2 * COLUMN_M) == pytest.approx(200.25)


def test_offset_is_range_and_what_it_leaves_behind_the_sensor_is_dropped() -> None:
    row = np.zeros(512, dtype=np.float32)
    row[[5, 200]] = 1.0
    columns, strengths = edges(row, 0.5, offset_m=0.03)
    assert columns == pytest.approx([2 * (200 * COLUMN_M - 0.03)])
    assert strengths.size == 1


def test_nan_is_no_edge() -> None:
    row = np.full(512, np.nan, dtype=np.float32)
    assert edges(row, 0.5)[0].size == 0
    row[50] = 0.9
    assert edges(row, 0.5)[0] == pytest.approx([100 * COLUMN_M])
