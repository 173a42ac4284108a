"""The contract of a denoiser (`saranga.denoise.base.Denoiser`): image in, edge strengths 0..1 out."""

from collections.abc import Callable
from math import isfinite

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.contract import echoes
from bench.contract.latency import TICK_MS, latency_check, latency_text
from bench.contract.subject import Subject
from saranga.denoise import Denoiser
from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS, EchoImage, load_sonar
from saranga.navigate import load_policy
from saranga.stack import HOLD, Stack


@pytest.fixture
def denoiser(denoiser_subject: Subject) -> Denoiser:
    return denoiser_subject.make()


def newest(denoiser: Denoiser, image: EchoImage) -> NDArray[np.float32]:
    return np.atleast_2d(denoiser(image))[-1]


def test_it_says_its_name_threshold_and_offset(denoiser: Denoiser) -> None:
    assert isinstance(denoiser.name, str) and denoiser.name
    assert isfinite(denoiser.threshold) and 0.0 < denoiser.threshold <= 1.0, "threshold: edges over it are obstacles"
    assert isfinite(denoiser.edge_offset_m) and abs(denoiser.edge_offset_m) < 0.5, "edge_offset_m is in metres"


def test_it_returns_edge_strengths_of_the_right_shape_and_type(denoiser: Denoiser) -> None:
    out = denoiser(echoes.pole_image())
    assert isinstance(out, np.ndarray), f"a {type(out).__name__} came back, not an array"
    assert out.shape in ((RANGE_COLUMNS,), (HISTORY_ROWS, RANGE_COLUMNS)), f"shape {out.shape}: (N,) or (M, N)"
    assert out.dtype == np.float32, f"dtype {out.dtype}: float32"
    assert np.isfinite(out).all() and out.min() >= 0.0 and out.max() <= 1.0, f"{out.min()} to {out.max()}: 0..1"


def test_it_sees_a_strong_echo_where_it_is(denoiser: Denoiser) -> None:
    edges = newest(denoiser, echoes.pole_image())
    near = edges[echoes.columns_near(echoes.POLE_M + denoiser.edge_offset_m, 0.10)]
    assert near.max() > denoiser.threshold, f"a pole {echoes.POLE_M} m away, 36 dB over the noise, is not found"


def test_it_finds_nothing_where_there_was_no_echo_yet(denoiser: Denoiser) -> None:
    edges = newest(denoiser, EchoImage())
    assert np.isfinite(edges).all() and not (edges > denoiser.threshold).any(), "obstacles from no data"


def test_it_finds_nothing_in_zeros(denoiser: Denoiser) -> None:
    edges = newest(denoiser, echoes.constant_image(0))
    assert np.isfinite(edges).all() and not (edges > denoiser.threshold).any(), "obstacles from a receiver that is off"


@pytest.mark.parametrize("make", [
    pytest.param(lambda: echoes.constant_image(32767), id="saturated"),
    pytest.param(lambda: echoes.constant_image(-32768), id="saturated the other way"),
    pytest.param(echoes.broken_image, id="not a number"),
    pytest.param(lambda: echoes.pole_image(count=1), id="the first cycle only"),
    pytest.param(lambda: echoes.pole_image(range_m=None), id="noise only")])
def test_it_stays_finite_and_within_bounds(denoiser: Denoiser, make: Callable[[], EchoImage]) -> None:
    edges = newest(denoiser, make())
    assert np.isfinite(edges).all() and edges.min() >= 0.0 and edges.max() <= 1.0


def test_it_survives_lost_rows(denoiser: Denoiser) -> None:
    lost = [k for k in range(HISTORY_ROWS - 1) if k % 4 == 1]
    edges = newest(denoiser, echoes.pole_image(lost=lost))
    near = edges[echoes.columns_near(echoes.POLE_M + denoiser.edge_offset_m, 0.10)]
    assert np.isfinite(edges).all() and near.max() > denoiser.threshold, "one cycle in four lost, and the pole with it"


def test_it_leaves_its_input_alone(denoiser: Denoiser) -> None:
    image = echoes.pole_image()
    iq, envelope = image.iq.copy(), image.envelope.copy()
    denoiser(image)
    assert np.array_equal(image.iq, iq) and np.array_equal(image.envelope, envelope), "the image was changed"


def test_it_is_deterministic(denoiser_subject: Subject) -> None:
    one, two = denoiser_subject.make(), denoiser_subject.make()
    for count in (8, 16, HISTORY_ROWS):
        image = echoes.pole_image(count=count)
        first = np.array(one(image), copy=True)
        assert np.array_equal(first, two(image)), f"two of it differ after {count} cycles"
        assert np.array_equal(first, one(image)), "the same image again gives another answer"


def test_it_keeps_the_sensors_apart(denoiser_subject: Subject) -> None:
    """One denoiser serves all sensors in turn: what it saw of one must not show in another."""
    geometry = load_sonar("pair")
    alone, shared = denoiser_subject.make(), denoiser_subject.make()
    near, far = (echoes.pole_cycles(geometry, range_m=r) for r in (0.6, 1.3))
    for count in (16, HISTORY_ROWS):
        left, right = (echoes.images(geometry, cycles[:count])["left"] for cycles in (near, far))
        expected = np.array(alone(left), copy=True)
        shared(right)
        assert np.array_equal(expected, shared(left)), "the other sensor's echoes change the answer"


def test_it_is_quick_enough(
    denoiser_subject: Subject, denoiser: Denoiser, report_latency: Callable[[str], None]
) -> None:
    image = echoes.pole_image()
    found = latency_check("one image", lambda: denoiser(image), TICK_MS / 2, "two sensors share the tick")
    report_latency(latency_text(denoiser_subject.spec, found))
    assert found.verdict.accepted, found.why


def test_a_stack_with_it_commands_nothing_before_there_are_echoes(denoiser: Denoiser) -> None:
    stack = Stack(denoiser, load_policy("saranga"), load_sonar("pair"))
    for tick in range(8):
        assert stack.step([], tick * 62_500).command == HOLD
    stack.step(echoes.pole_cycles(load_sonar("pair"), 4), 8 * 62_500)
    for tick in range(14, 20):
        assert stack.step([], tick * 62_500).command == HOLD, "and holds when they stop"
