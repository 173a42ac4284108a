"""Disparity from complex echoes against Pythagoras: echoes made at the native rate from points that move."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from echo_pairs import Point, frames, images, paths_m

from saranga.denoise import load_denoiser
from saranga.disparity import Matches, calibrate, match
from saranga.echo import EchoCycle, EchoFrame, EchoImage
from saranga.errors import UsageError
from saranga.localise import positions
from saranga.navigate import load_policy
from saranga.resample import sound_speed_m_s
from saranga.sonar_geometry import SensorCalibration, load_sonar
from saranga.stack import Stack

PAIR = load_sonar("pair")
C = sound_speed_m_s(20.0)
LIMIT_M = 0.115
WAVELENGTH_M = C / PAIR.fop_hz
QUIET = 40.0


def at(range_m: float, azimuth_deg: float, **motion: float) -> Point:
    a = np.radians(azimuth_deg)
    return Point(range_m * np.cos(a), range_m * np.sin(a), **motion)


def found(points: list[Point], method: str = "phase", edge_error_m: tuple[float, float] = (0.0, 0.0),
          calibration: SensorCalibration | None = None, **options: object) -> Matches:
    """Matches of points by their true paths, the edges wrong by `edge_error_m` left and right."""
    left, right = images(points, PAIR, **options)  # type: ignore[arg-type]
    ways = np.array([paths_m(p, PAIR) for p in points])
    return match(left, right, ways[:, 0] + edge_error_m[0], ways[:, 1] + edge_error_m[1], LIMIT_M, PAIR, C,
                 method=method, calibration=calibration)  # type: ignore[arg-type]


def true_disparity(point: Point) -> float:
    left, right = paths_m(point, PAIR)
    return left - right


@pytest.mark.parametrize("azimuth_deg", [-60, -31, 0, 17, 45, 60])
@pytest.mark.parametrize("range_m", [0.5, 1.0, 1.45])
def test_of_a_still_point_to_a_tenth_of_a_millimetre(range_m: float, azimuth_deg: float) -> None:
    point = at(range_m, azimuth_deg)
    # both edges a column off, each to its own side: 13 mm of disparity or two wavelengths together
    result = found([point], edge_error_m=(0.0064, -0.0064), noise_counts=QUIET)
    assert result.on_carrier[0] and result.coherence[0] > 0.99
    assert result.disparity_m[0] == pytest.approx(true_disparity(point), abs=1e-4)
    rough = found([point], "envelope", (0.0064, -0.0064), noise_counts=QUIET)
    assert not rough.on_carrier[0]
    assert rough.disparity_m[0] == pytest.approx(true_disparity(point), abs=1e-3)


@pytest.mark.parametrize("vx,vy", [(-1.5, 0.0), (-1.0, 0.8), (0.3, -1.0), (0.0, 1.5)])
def test_of_a_point_that_moves_ahead_and_sideways(vx: float, vy: float) -> None:
    point = at(1.0, 20.0, vx_m_s=vx, vy_m_s=vy)
    result = found([point], noise_counts=QUIET)
    # within the 0.41 s that count, the disparity of the fastest one changes by 60 mm, and not quite evenly
    assert result.disparity_m[0] == pytest.approx(true_disparity(point), abs=1e-3)


def test_carrier_beats_envelope_beats_edges_in_noise() -> None:
    rng = np.random.default_rng(4)
    miss: dict[str, list[float]] = {"phase": [], "envelope": [], "edges": []}
    for seed in range(40):
        point = at(1.0, float(rng.uniform(-50, 50)), vx_m_s=-1.0)
        error = rng.normal(0.0, 0.006, 2)
        for method in ("phase", "envelope"):
            result = found([point], method, tuple(error), noise_counts=1265.0, seed=seed)  # 10 dB
            miss[method].append(abs(result.disparity_m[0] - true_disparity(point)))
        miss["edges"].append(abs(error[0] - error[1]))
    median_mm = {k: 1e3 * float(np.median(v)) for k, v in miss.items()}
    assert median_mm["phase"] < 0.5 < median_mm["envelope"] < 2.0 < median_mm["edges"]
    assert np.mean(np.array(miss["phase"]) > WAVELENGTH_M / 2) < 0.2


def test_pairs_cross_where_the_echoes_say_so() -> None:
    """Left order A, B and right order B, A, which no matching by order can find."""
    a, b = at(1.0, -60.0, vx_m_s=-0.5), at(0.957, 60.0, vx_m_s=-1.4)
    (a_left, a_right), (b_left, b_right) = paths_m(a, PAIR), paths_m(b, PAIR)
    left, right = images([a, b], PAIR, noise_counts=QUIET)
    assert (a_left < b_left) and (b_right < a_right)
    result = match(left, right, [a_left, b_left], [b_right, a_right], LIMIT_M, PAIR, C, method="phase")
    assert list(result.partner) == [1, 0]
    assert result.disparity_m == pytest.approx([true_disparity(a), true_disparity(b)], abs=3e-3)


def test_each_edge_has_one_partner_and_the_limit_holds() -> None:
    point = at(1.0, 10.0)
    way_left, way_right = paths_m(point, PAIR)
    left, right = images([point], PAIR, noise_counts=QUIET)
    result = match(left, right, [way_left - 0.03, way_left], [way_right], LIMIT_M, PAIR, C)
    assert list(result.partner) == [-1, 0] and np.isnan(result.disparity_m[0]) and result.coherence[0] == 0.0
    far = match(left, right, [way_left], [way_right + 0.2], LIMIT_M, PAIR, C)
    assert list(far.partner) == [-1] and np.isnan(far.disparity_m).all()


@pytest.mark.parametrize("ways", [([], []), ([1.0], []), ([], [1.0])])
def test_no_edges_no_matches(ways: tuple[list[float], list[float]]) -> None:
    left, right = images([at(1.0, 0.0)], PAIR)
    assert match(left, right, *ways, LIMIT_M, PAIR, C).disparity_m.size == len(ways[0])


def test_lost_rows_and_rows_of_one_sensor_only() -> None:
    point = at(1.0, 25.0, vx_m_s=-1.0)

    def lossy(role: str, age: int, frame: EchoFrame) -> EchoFrame | None:
        return None if age in ((0, 3, 4, 9) if role == "left" else (0, 1, 2, 5)) else frame

    result = found([point], change=lossy, noise_counts=QUIET)
    # the last row that both have is 3 cycles old: its disparity is carried on to now
    assert result.disparity_m[0] == pytest.approx(true_disparity(point), abs=1.5e-3)


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_an_image_that_only_begins(rows: int) -> None:
    point = at(1.0, 25.0)
    result = found([point], rows=rows, noise_counts=QUIET)
    assert result.disparity_m[0] == pytest.approx(true_disparity(point), abs=1e-3)


@pytest.mark.parametrize("dead", ["left", "right"])
def test_a_dead_sensor_leaves_the_edges_disparity(dead: str) -> None:
    point = at(1.0, 25.0)
    result = found([point], edge_error_m=(0.002, 0.0), noise_counts=QUIET,
                   change=lambda role, age, frame: None if role == dead else frame)
    assert result.coherence[0] == 0.0 and not result.on_carrier[0]
    assert result.disparity_m[0] == pytest.approx(true_disparity(point) + 0.002, abs=1e-9)


def test_amplitudes_alone_leave_the_edges_disparity() -> None:
    point = at(1.0, 25.0)
    left, right = images([point], PAIR, noise_counts=QUIET)
    for image in (left, right):
        image.iq[:] = np.abs(image.iq)
    way_left, way_right = paths_m(point, PAIR)
    result = match(left, right, [way_left], [way_right + 0.002], LIMIT_M, PAIR, C, method="phase")
    assert result.coherence[0] == 0.0 and not result.on_carrier[0]
    assert result.disparity_m[0] == pytest.approx(way_left - way_right - 0.002, abs=1e-9)


def test_nan_rows_are_left_out() -> None:
    point = at(1.0, 25.0)
    left, right = images([point], PAIR, noise_counts=QUIET)
    left.iq[-2, 100] = np.nan
    right.iq[-5] = np.inf
    way_left, way_right = paths_m(point, PAIR)
    result = match(left, right, [way_left], [way_right], LIMIT_M, PAIR, C, method="phase")
    assert result.disparity_m[0] == pytest.approx(true_disparity(point), abs=1e-4)
    left.iq[:] = np.nan
    edges_only = match(left, right, [way_left], [way_right], LIMIT_M, PAIR, C, method="phase")
    assert edges_only.disparity_m[0] == pytest.approx(way_left - way_right, abs=1e-9)


@pytest.mark.parametrize("ahead_rad", [-3.0, -1.0, 2.0, 3.1])
def test_an_uncalibrated_phase_costs_half_a_wavelength_at_most_and_calibration_takes_it_away(ahead_rad: float) -> None:
    point = at(1.0, 30.0)
    faulty = {"ahead_rad": ahead_rad, "late_m": 0.004, "noise_counts": QUIET}
    envelope = found([point], "envelope", **faulty).disparity_m[0]
    wrong = found([point], "phase", **faulty).disparity_m[0]
    assert envelope == pytest.approx(true_disparity(point) - 0.004, abs=5e-4)  # the delay alone
    assert 1e-4 < abs(wrong - envelope) <= WAVELENGTH_M / 2 + 1e-9
    ahead = at(0.8, 0.0)
    pairs = [(*images([ahead], PAIR, seed=seed, **faulty), *paths_m(ahead, PAIR)) for seed in range(3)]
    known = calibrate(pairs, 0.0, PAIR, C)
    assert known.delay_m == pytest.approx(0.004, abs=3e-4)
    assert np.angle(np.exp(1j * (known.phase_rad - ahead_rad))) == pytest.approx(0.0, abs=0.05)
    right = found([point], "phase", calibration=known, **faulty)
    assert right.disparity_m[0] == pytest.approx(true_disparity(point), abs=2e-4)


def test_calibration_refuses_noise_and_nothing() -> None:
    ahead = at(1.0, 0.0, counts=1.0)
    noisy = (*images([ahead], PAIR, noise_counts=1000.0), *paths_m(ahead, PAIR))
    with pytest.raises(UsageError, match="0 of 1 pairs of images are coherent"):
        calibrate([noisy], 0.0, PAIR, C)
    with pytest.raises(UsageError, match="0 of 0"):
        calibrate([], 0.0, PAIR, C)


def test_unknown_methods_name_the_known_ones() -> None:
    left, right = images([at(1.0, 0.0)], PAIR, rows=1)
    with pytest.raises(UsageError, match="phase, envelope"):
        match(left, right, [2.0], [2.0], LIMIT_M, PAIR, C, method="carrier")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="auto, phase, envelope, edges"):
        Stack(load_denoiser("gaussian"), load_policy("none"), PAIR, disparity="carrier")


def test_the_sonar_file_says_what_is_calibrated(tmp_path: Path) -> None:
    assert PAIR.calibration == {}
    text = (Path(__file__).parents[2] / "fixtures/sonars/pair.toml").read_text()

    def load(extra: str) -> dict[str, SensorCalibration]:
        path = tmp_path / "own.toml"
        path.write_text(text + extra)
        return load_sonar(str(path)).calibration

    assert load("[calibration.right]\ndelay_m = 0.001\nphase_rad = -0.4\n") == {"right": SensorCalibration(0.001, -0.4)}
    for wrong, word in (("[calibration.right]\ndelay_m = 0.001\n", "calibration.right.phase_rad is missing"),
                        ("[calibration.right]\ndelay_m = 1.0\nphase_rad = 0\n", "delay_m is 1.0"),
                        ("[calibration.down]\ndelay_m = 0.0\nphase_rad = 0\n", "does not have"),
                        ("[calibration.left]\ndelay_m = 0.0\nphase_rad = 0\n", "unknown key calibration.left"),
                        ("[calibration.right]\ndelay = 0.0\n", "delay_m and phase_rad")):
        with pytest.raises(UsageError, match=word):
            load(wrong)


class Edges:
    """A denoiser that knows: one edge at the whole column next to each true path."""

    name, threshold, edge_offset_m = "edges", 0.5, 0.0

    def __init__(self, columns: dict[int, int]) -> None:
        self.columns, self.turn = columns, 0

    def __call__(self, image: EchoImage) -> np.ndarray:
        row = np.zeros(512, dtype=np.float32)
        row[self.columns[self.turn % 2]] = 1.0
        self.turn += 1
        return row


@pytest.mark.parametrize("disparity,limit_deg,least_deg", [("phase", 0.2, 0.0), ("envelope", 0.5, 0.0),
                                                           ("edges", 4.0, 1.0)])
def test_the_stack_uses_it(disparity: str, limit_deg: float, least_deg: float) -> None:
    point = at(1.0, 33.0)
    columns = {k: round(way / 2 / (1.66 / 512)) for k, way in enumerate(paths_m(point, PAIR))}
    geometry = replace(PAIR, calibration={"right": SensorCalibration()}) if disparity == "phase" else PAIR
    stack = Stack(Edges(columns), load_policy("none"), geometry,
                  disparity="edges" if disparity == "edges" else "auto")
    rng = np.random.default_rng(0)
    cycles = [EchoCycle(k, k * PAIR.cycle_us, frames([point], PAIR, 31 - k, k, noise_counts=QUIET, rng=rng))
              for k in range(32)]
    (obstacle,) = stack.step(cycles, 0).obstacles
    assert least_deg <= abs(np.degrees(obstacle.azimuth_rad) - 33.0) < limit_deg


def test_in_space_each_pair_has_its_own() -> None:
    triple = load_sonar("triple")
    (obstacle,) = positions([2.4], [0.5 * triple.baseline_h_m], [-0.5 * triple.baseline_v_m], triple, [0.7])
    assert (obstacle.y_m, obstacle.z_m, obstacle.score) == (pytest.approx(0.6), pytest.approx(-0.6), 0.7)
    assert positions([2.4], [np.nan], [0.0], triple) == [] and positions([2.4], [0.0], [np.nan], triple) == []
