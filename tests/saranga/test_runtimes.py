"""The network behind `Denoiser`: same edges from every runtime, the same bits every time."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from synthetic_images import PEAK_S, Reflector, SyntheticImage, image, noise
from tiny_network import expected, onnx_bytes, track_onnx_bytes, write_model

from saranga.denoise import load_denoiser
from saranga.denoise.network_denoiser import EDGE_WEIGHT, EVIDENCE_REACH, HALF_EVIDENCE, _peaks
from saranga.denoise.peaks import put_peak
from saranga.input_kinds import MADE
from saranga.localise import edges
from saranga.network_input import normalised
from saranga.quantise import calibration_inputs, quantised

PACKAGES = {"saranga-onnx": "onnxruntime", "saranga-openvino": "openvino", "saranga-torch": "torch"}
PEAK_M = PEAK_S * 343.2 / 2


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> str:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    fp32 = onnx_bytes()
    int8 = quantised(fp32, calibration_inputs("envelope", 16))
    return str(write_model(tmp_path_factory.mktemp("model"), fp32=fp32, int8=int8))


@pytest.fixture(params=[("saranga-onnx", "int8"), ("saranga-onnx", "fp32"), ("saranga-openvino", "int8"),
                        ("saranga-openvino", "fp32"), ("saranga-torch", None)], ids=lambda p: f"{p[0]}-{p[1]}")
def denoiser(request: pytest.FixtureRequest, model: str):
    name, precision = request.param
    pytest.importorskip(PACKAGES[name])
    return load_denoiser(name, weights=model, **({"precision": precision} if precision else {}))


def _picture(seed: int = 3, range_m: float = 0.8, psnr_db: float = 25.0) -> SyntheticImage:
    return image([Reflector(range_m)], psnr_db, np.random.default_rng(seed))


def test_edge_at_the_peak_of_the_echo(denoiser) -> None:
    for seed, range_m in enumerate(np.linspace(0.3, 1.4, 8)):
        row = denoiser(_picture(seed, float(range_m)))
        assert row.shape == (512,) and row.dtype == np.float32 and np.isfinite(row).all()
        found, strength = edges(row, 0.5)
        assert found.size == 1 and found[0] / 2 == pytest.approx(range_m + PEAK_M, abs=0.004)
        assert 0.5 < strength[0] <= 1.0


def test_strengths_of_the_runtimes_agree(model: str) -> None:
    pictures = [_picture(seed) for seed in range(4)]
    for precision, within in (("fp32", 1e-4), ("int8", 1e-2)):
        rows = []
        for name, package in PACKAGES.items():
            if precision == "int8" and name == "saranga-torch":
                continue
            pytest.importorskip(package)
            options = {} if name == "saranga-torch" else {"precision": precision}
            denoise = load_denoiser(name, weights=model, **options)
            rows.append([np.max(denoise(picture)) for picture in pictures])
        np.testing.assert_allclose(rows, np.broadcast_to(rows[0], np.shape(rows)), atol=within)


def test_the_network_is_computed_as_written(model: str) -> None:
    """Against the same formula in NumPy, edge strengths included."""
    pytest.importorskip("onnxruntime")
    picture = _picture()
    given = np.empty((32, 512), dtype=np.float32)
    normalised(picture.envelope, given)
    probability = expected(given)
    top = int(np.argmax(probability))
    row = load_denoiser("saranga-onnx", weights=model, precision="fp32")(picture)
    assert row.max() == pytest.approx(_strength(probability[top - EVIDENCE_REACH:top + EVIDENCE_REACH + 1]), abs=0.02)
    assert abs(int(np.argmax(row)) - top) <= 1


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf], ids=["empty", "nan", "inf"])
def test_no_edges_where_nothing_was_measured(denoiser, value: float) -> None:
    nothing = SyntheticImage(np.full((32, 512), value, dtype=np.complex64))
    assert not denoiser(nothing).any()


def test_nan_rows_do_not_spoil_the_others(denoiser) -> None:
    picture = _picture()
    picture.iq[5:20] = np.nan
    picture.envelope = np.abs(picture.iq)
    found, _ = edges(denoiser(picture), 0.5)
    assert found.size == 1 and found[0] / 2 == pytest.approx(0.8 + PEAK_M, abs=0.004)


def test_ring_down_is_no_edge(denoiser) -> None:
    picture = image([Reflector(0.05), Reflector(0.8)], 25.0, np.random.default_rng(1))
    found, _ = edges(denoiser(picture), 0.2)
    assert found.size == 1 and found[0] / 2 > 0.7


def test_same_bits_every_time(denoiser) -> None:
    pictures = [_picture(seed, psnr_db=5.0) for seed in range(6)]
    first = [denoiser(picture).tobytes() for picture in pictures]
    again = [denoiser(picture).tobytes() for picture in reversed(pictures)]
    assert first == again[::-1]
    assert any(np.frombuffer(row, np.float32).any() for row in first)


def test_two_instances_give_the_same_bits(model: str) -> None:
    for name in ("saranga-onnx", "saranga-openvino"):
        pytest.importorskip(PACKAGES[name])
        one, other = load_denoiser(name, weights=model), load_denoiser(name, weights=model)
        for seed in range(4):
            picture = _picture(seed, psnr_db=5.0)
            assert one(picture).tobytes() == other(picture).tobytes()


def test_weights_are_named_by_their_hash(denoiser, model: str) -> None:
    hashes = {hashlib.sha256(path.read_bytes()).hexdigest() for path in Path(model).parent.glob("*.onnx")}
    assert len(hashes) == 2 and denoiser.weights_sha256 in hashes


def test_network_that_gives_the_whole_image(tmp_path: Path, model: str) -> None:
    pytest.importorskip("openvino")
    whole = write_model(tmp_path, fp32=onnx_bytes(whole_image=True))
    for name in ("saranga-onnx", "saranga-openvino"):
        row = load_denoiser(name, weights=str(whole), precision="fp32")(_picture())
        newest = load_denoiser(name, weights=model, precision="fp32")(_picture())
        np.testing.assert_allclose(row, newest, atol=1e-6)


@pytest.mark.parametrize("name", list(PACKAGES))
def test_network_that_takes_the_track_map(tmp_path: Path, name: str) -> None:
    pytest.importorskip(PACKAGES[name])
    options = {} if name == "saranga-torch" else {"precision": "fp32"}
    model = write_model(tmp_path, {"input": MADE["tracks"]}, fp32=track_onnx_bytes())
    denoise = load_denoiser(name, weights=str(model), **options)
    for seed, range_m in enumerate((0.4, 0.8, 1.2)):
        reflector = Reflector(range_m, closing_m_s=1.0)
        found, _ = edges(denoise(image([reflector], 5.0, np.random.default_rng(seed))), 0.2)
        assert np.abs(found / 2 - range_m - PEAK_M).min() < 0.01
    for value in (0.0, np.nan):
        assert not denoise(SyntheticImage(np.full((32, 512), value, dtype=np.complex64))).any()


def test_few_false_edges_in_noise(denoiser) -> None:
    empty = [SyntheticImage(noise(np.random.default_rng(i))) for i in range(20)]
    assert sum(edges(denoiser(picture), 0.5)[0].size for picture in empty) == 0


def _bump(centre: float, sigma: float = 2.0, height: float = 1.0) -> np.ndarray:
    return (height * np.exp(-((np.arange(512) - centre) ** 2) / (2 * sigma**2))).astype(np.float32)


def _strength(probability: np.ndarray) -> float:
    p = np.clip(probability.astype(float), 0.0, 0.999)
    evidence = float(-np.log1p(-p / (p + EDGE_WEIGHT * (1.0 - p))).sum())
    return evidence / (evidence + HALF_EVIDENCE)


@pytest.mark.parametrize("centre", [200.0, 200.3, 200.49, 200.8])
def test_position_between_columns(centre: float) -> None:
    (column, strength), = _peaks(_bump(centre), 40)
    assert column == pytest.approx(centre, abs=0.05)
    assert strength == pytest.approx(_strength(_bump(centre)), abs=0.01)
    row = np.zeros(512, dtype=np.float32)
    put_peak(row, column, strength)
    found, _ = edges(row, 0.5)
    assert found[0] / 2 / (1.66 / 512) == pytest.approx(centre, abs=0.05)


def test_two_edges_keep_their_own_places() -> None:
    found = _peaks(_bump(200.0) + _bump(212.0, height=0.5), 40)
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found[:, 0], [200.0, 212.0], atol=0.2)


def test_a_long_echo_seen_as_two_doubtful_edges_is_surer_than_each() -> None:
    one, = _peaks(_bump(200.0, height=0.5), 40)
    both = _peaks(_bump(200.0, height=0.5) + _bump(215.0, height=0.45), 40)
    assert both[1, 1] < one[1] + 0.01  # the lower of the two does not borrow from the higher
    far = _peaks(_bump(200.0, height=0.5) + _bump(260.0, height=0.5), 40)
    assert both[0, 1] > one[1] + 0.05 and far[0, 1] == pytest.approx(one[1], abs=1e-6)


def test_spread_probability_adds_up_but_does_not_pass_for_certainty() -> None:
    """An edge of uncertain range, 0.25 in each of nine columns, is nine times the evidence of one such column."""
    spread = np.zeros(512, dtype=np.float32)
    spread[296:305] = 0.25
    spread[300] = 0.2501
    (column, strength), = _peaks(spread, 40)
    assert column == pytest.approx(300.0, abs=0.01)
    evidence = -9 * np.log(1.0 - 0.25 / (0.25 + EDGE_WEIGHT * 0.75))
    assert strength == pytest.approx(evidence / (evidence + HALF_EVIDENCE), abs=0.001)
    broad_doubt = _peaks(_bump(300.0, sigma=4.0, height=0.7), 40)[0, 1]
    certainty = _peaks(_bump(300.0), 40)[0, 1]
    assert strength < broad_doubt < certainty


def test_not_finite_output_is_refused() -> None:
    row = _bump(200.0)
    row[300] = np.nan
    assert _peaks(row, 40) is None
