"""The network's input: peaks stand where range and closing speed say."""

import numpy as np
import pytest
from synthetic_images import Reflector, image, noise

from saranga.denoise.pulse import pulse
from saranga.input_kinds import MADE
from saranga.resample import COLUMN_M
from saranga.track_map import HALVES, RANGE_BINS, SHAPE, SPEED_BINS, TrackMap

BIN_M = COLUMN_M * 512 / RANGE_BINS
SPEED_STEP_M_S = 3.0 / SPEED_BINS
"""-0.5 to 2.5 m/s (columns a row of 3.24 mm and 25.6 ms)."""
CYCLE_S = 0.0256


def track_map(iq: np.ndarray, rows: int = 32, **options: float) -> np.ndarray:
    out = np.full(SHAPE, np.nan, dtype=np.float32)
    assert TrackMap(**options).fill(np.ascontiguousarray(iq, dtype=np.complex64), rows, out)
    return out


def by_range(out: np.ndarray, depth: int) -> np.ndarray:
    """(speeds, 256): halves of the bins put side by side."""
    return out.reshape(4, HALVES, SPEED_BINS, RANGE_BINS)[depth].transpose(1, 2, 0).reshape(SPEED_BINS, -1)


@pytest.mark.parametrize(("range_m", "closing_m_s"), [(0.5, 0.0), (0.9, 1.0), (1.2, -0.3), (0.7, 2.0)])
@pytest.mark.parametrize("depth", [1, 3])
def test_the_peak_is_at_range_and_speed(range_m: float, closing_m_s: float, depth: int) -> None:
    rng = np.random.default_rng(5)
    picture = image([Reflector(range_m, closing_m_s)], 10.0, rng)
    cells = by_range(track_map(picture.iq), depth)
    speed, cell = np.unravel_index(np.argmax(cells), cells.shape)
    assert abs((cell + 0.5) * BIN_M / 2 - pulse().peak_m - range_m) < 0.012
    found_m_s = (-4.0 + 0.25 * (3 * speed + 1)) * COLUMN_M / CYCLE_S
    assert abs(found_m_s - closing_m_s) < 1.5 * SPEED_STEP_M_S + 0.05


def test_a_faint_echo_stands_out_only_over_many_rows() -> None:
    right = {0: 0, 3: 0}
    for seed in range(12):
        rng = np.random.default_rng(seed)
        picture = image([Reflector(0.8, 0.7)], 2.0, rng)
        out = track_map(picture.iq)
        for depth in right:
            cell = np.argmax(by_range(out, depth).max(axis=0))
            right[depth] += abs((cell + 0.5) * BIN_M / 2 - pulse().peak_m - 0.8) < 0.05
    assert right[3] >= 10
    assert right[0] <= right[3] - 2


def test_amplitudes_without_phase_are_taken_as_such() -> None:
    rng = np.random.default_rng(3)
    picture = image([Reflector(1.0, 0.5)], 10.0, rng)
    out = track_map(picture.envelope.astype(np.complex64))
    cell = np.argmax(by_range(out, 3).max(axis=0))
    assert abs((cell + 0.5) * BIN_M / 2 - pulse().peak_m - 1.0) < 0.02
    many = np.empty((2, *SHAPE), dtype=np.float32)
    both = np.stack([picture.iq, picture.iq])
    TrackMap().fill_many(both, np.array([True, False]), many)
    np.testing.assert_allclose(many[0], out, atol=2e-3)
    np.testing.assert_array_equal(many[1], track_map(picture.iq))


def test_values_are_small_at_any_level_and_do_not_depend_on_it() -> None:
    rng = np.random.default_rng(8)
    picture = image([Reflector(0.6, 0.2)], 60.0, rng).iq
    loud, quiet = track_map(picture * 1e3), track_map(picture * 1e-3)
    np.testing.assert_allclose(loud, quiet, rtol=1e-3, atol=1e-3)
    assert 5.0 < loud.max() < 12.0
    assert loud.min() > -4.0


def test_nothing_measured_is_all_zero_and_says_so() -> None:
    out = np.full(SHAPE, 7.0, dtype=np.float32)
    assert not TrackMap().fill(np.zeros((32, 512), dtype=np.complex64), 32, out)
    assert not out.any()
    broken = np.full((32, 512), np.nan, dtype=np.complex64)
    assert not TrackMap().fill(broken, 32, out)
    assert not out.any()


def test_lost_and_broken_rows_leave_the_rest_as_it_was() -> None:
    rng = np.random.default_rng(2)
    iq = image([Reflector(0.9, 0.4)], 8.0, rng).iq
    holes = iq.copy()
    holes[5] = 0.0
    holes[11] = np.nan
    out = track_map(holes)
    assert np.isfinite(out).all()
    cell = np.argmax(by_range(out, 3).max(axis=0))
    assert abs((cell + 0.5) * BIN_M / 2 - pulse().peak_m - 0.9) < 0.012
    # rows before the start of the history do not count, whatever they hold
    short = track_map(iq, rows=8)
    np.testing.assert_allclose(by_range(short, 0), by_range(track_map(np.where(np.arange(32)[:, None] < 24, 0, iq)), 0))


def test_ringing_is_not_looked_at() -> None:
    iq = noise(np.random.default_rng(4))
    iq[:, :30] += 40.0
    calm = noise(np.random.default_rng(4))
    np.testing.assert_allclose(track_map(iq), track_map(calm), atol=1e-4)
    assert by_range(track_map(iq, ring_down_m=0.0), 3).max() > 2.0 * by_range(track_map(calm), 3).max()


def test_the_map_is_the_one_that_networks_were_trained_on() -> None:
    """Another map of the same shape would make every trained network wrong without a word: whoever changes it on
    purpose counts `saranga.input_kinds.MADE` on, trains anew, and only then changes these values."""
    assert MADE["tracks"] == "tracks-2"
    picture = image([Reflector(0.7, 0.8), Reflector(1.1, -0.2)], 8.0, np.random.default_rng(7))
    out = track_map(picture.iq)
    np.testing.assert_allclose(
        out.mean(axis=(1, 2)), [-0.1255, -0.1246, -0.0657, -0.065, -0.0304, -0.0299, 0.01, 0.0128], atol=2e-3)
    np.testing.assert_allclose(
        out[6].mean(axis=0)[::16], [-0.096, -0.12, -0.131, 0.258, 0.195, 0.221, -0.088, -0.05], atol=5e-3)
