"""`python -m saranga export`: what is written computes what was trained."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_network import expected, onnx_bytes

from saranga import export_command
from saranga.__main__ import main
from saranga.quantise import calibration_inputs

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    return calibration_inputs("envelope", 16, seed=9)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.onnx"
    path.write_bytes(onnx_bytes())
    return path


def _run(data: bytes, images: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    return np.concatenate([session.run(None, {"image": image[None]})[0] for image in images])


def _network() -> Any:
    """Layers of every kind the shipped network has, with normalisation far from the identity."""
    torch = pytest.importorskip("torch")
    nn = torch.nn

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.down = nn.Sequential(nn.Conv2d(1, 6, (3, 4), (1, 2), (1, 1), bias=False), nn.BatchNorm2d(6), nn.ReLU())
            self.up = nn.Sequential(nn.ConvTranspose2d(12, 4, (1, 4), (1, 2), (0, 1), bias=False), nn.BatchNorm2d(4),
                                    nn.ReLU())
            self.last = nn.ConvTranspose2d(4, 1, (1, 3), (1, 1), (0, 1))

        def forward(self, x: Any) -> Any:
            x = self.down(x)
            x = torch.cat([x[:, :, -2:-1], x[:, :, -1:]], 1)
            return self.last(self.up(x))[:, 0, 0]

    torch.manual_seed(3)
    network = Network()
    for layer in network.modules():
        if isinstance(layer, nn.BatchNorm2d):
            layer.running_mean.uniform_(-0.5, 0.5)
            layer.running_var.uniform_(0.3, 3.0)
            layer.weight.data.uniform_(0.5, 2.0)
            layer.bias.data.uniform_(-0.5, 0.5)
    return network.eval()


def test_onnx_of_a_module(images: np.ndarray) -> None:
    torch = pytest.importorskip("torch")
    from saranga.export import onnx_from_module

    network = _network()
    with torch.no_grad():
        wanted = torch.sigmoid(network(torch.from_numpy(images))).numpy()
    assert wanted.std() > 0.01
    network.train()
    data = onnx_from_module(network)
    assert network.training
    np.testing.assert_allclose(_run(data, images), wanted, atol=1e-5)
    model = onnx.load_from_string(data)
    kinds = {node.op_type for node in model.graph.node}
    assert not kinds & {"BatchNormalization", "Identity", "Constant"}
    assert [o.version for o in model.opset_import] == [17]
    assert [d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim] == [1, 1, 32, 512]
    assert str(Path(__file__).parents[2]).encode() not in data


def test_network_of_another_size_is_refused() -> None:
    torch = pytest.importorskip("torch")
    from saranga.errors import UsageError
    from saranga.export import onnx_from_module

    with pytest.raises(UsageError, match=r"output is \(1, 255\); expected \(1, 512\) or \(1, 32, 512\)"):
        onnx_from_module(torch.nn.Sequential(torch.nn.Conv2d(1, 1, (32, 4), (1, 2)), torch.nn.Flatten()))


def test_tidied_folds_normalisation_of_a_transposed_convolution(images: np.ndarray) -> None:
    from saranga.export import tidied

    data = tidied(onnx_bytes())
    assert "BatchNormalization" not in {node.op_type for node in onnx.load_from_string(data).graph.node}
    np.testing.assert_allclose(_run(data, images), [expected(image[0]) for image in images], atol=1e-5)


def _transposed(height: int) -> bytes:
    """Strides 2, 4 and 1 in a row, the second without bias, on maps of this height."""
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(2)
    nodes, weights, at, channels, width = [], {}, "image", 1, 512
    for stride, size, out, bias in ((2, 4, 5, True), (4, 8, 3, False), (1, 3, 2, True)):
        weights[f"w{size}"] = rng.normal(size=(channels, out, 1, size))
        weights |= {f"b{size}": rng.normal(size=out)} if bias else {}
        nodes.append(helper.make_node("ConvTranspose", [at, f"w{size}", *([f"b{size}"] if bias else [])], [f"x{size}"],
                                      kernel_shape=[1, size], strides=[1, stride], pads=[0, (size - stride) // 2] * 2))
        at, channels, width = f"x{size}", out, width * stride
    given, wanted = (helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in (
        ("image", [1, 1, height, 512]), (at, [1, channels, height, width])))
    graph = helper.make_graph(nodes, "up", [given], [wanted], [
        numpy_helper.from_array(value.astype(np.float32), name) for name, value in weights.items()])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    return model.SerializeToString()


def test_transposed_convolutions_as_ordinary_ones(images: np.ndarray) -> None:
    """Against ONNX Runtime's own transposed convolutions; what is of another kind stays."""
    from saranga.subpixel import without_transposed

    row = _transposed(1)
    changed = without_transposed(row)
    assert [node.op_type for node in onnx.load_from_string(changed).graph.node].count("ConvTranspose") == 1
    np.testing.assert_allclose(_run(changed, images[:4, :, -1:]), _run(row, images[:4, :, -1:]), rtol=1e-5, atol=1e-4)
    whole = onnx.load_from_string(without_transposed(_transposed(32)))
    assert [node.op_type for node in whole.graph.node] == ["ConvTranspose"] * 3


def test_torch_from_onnx_is_the_same_network(images: np.ndarray) -> None:
    torch = pytest.importorskip("torch")
    from saranga.denoise.network_torch import module_from_onnx
    from saranga.export import onnx_from_module

    for data in (onnx_bytes(), onnx_from_module(_network())):
        module, shape = module_from_onnx(data)
        assert shape == (1, 1, 32, 512)
        with torch.no_grad():
            found = np.concatenate([module(torch.from_numpy(image[None])).numpy() for image in images])
        np.testing.assert_allclose(found, _run(data, images), atol=1e-5)


def test_calibration_inputs_repeat_and_hold_loud_echoes() -> None:
    first, again = (calibration_inputs("envelope", 12, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert first.shape == (12, 1, 32, 512) and first.dtype == np.float32
    assert not np.array_equal(first, calibration_inputs("envelope", 12, seed=5))
    assert first.max() > np.log1p(10 ** (30 / 20)) and first.min() == 0.0


def test_int8_on_both_runtimes(source: Path, tmp_path: Path, images: np.ndarray, capsys) -> None:
    out = tmp_path / "tiny-int8.onnx"
    assert main(["export", "--format", "int8", "--images", "32", str(source), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert str(out) in said.out and "sha256" in said.out and "RMS difference" in said.err
    kinds = [node.op_type for node in onnx.load(out).graph.node]
    assert kinds.count("QuantizeLinear") >= 4
    weights = [i for i in onnx.load(out).graph.initializer if i.data_type == onnx.TensorProto.INT8 and len(i.dims) == 4]
    assert weights and all(np.abs(onnx.numpy_helper.to_array(w).astype(int)).max() <= 64 for w in weights)
    found = _run(out.read_bytes(), images)
    wanted = np.array([expected(image[0]) for image in images])
    assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.03
    pytest.importorskip("openvino")
    from saranga.denoise.network_openvino import import_openvino

    openvino = import_openvino()
    network = openvino.Core().compile_model(out, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    other = np.concatenate([network([image[None]])[0].copy() for image in images])
    assert np.abs(other - found).max() <= 3 / 255


def test_openvino_files(source: Path, tmp_path: Path, images: np.ndarray) -> None:
    pytest.importorskip("openvino")
    from saranga.denoise.network_openvino import import_openvino

    openvino = import_openvino()
    out = tmp_path / "tiny.xml"
    assert main(["export", "--format", "openvino", str(source), "--out", str(out)]) == 0
    network = openvino.Core().compile_model(out, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    found = np.concatenate([network([image[None]])[0].copy() for image in images])
    np.testing.assert_allclose(found, [expected(image[0]) for image in images], atol=1e-5)


@pytest.mark.parametrize("architecture", ["tracks", "paper"])
def test_checkpoint_of_each_architecture(architecture: str, tmp_path: Path) -> None:
    """Checkpoint to fp32 to int8; every step gives the probabilities of the network it came from."""
    torch = pytest.importorskip("torch")
    from saranga.denoise.network_torch import module_from_onnx
    from saranga.network import build_network

    torch.manual_seed(5)
    network = build_network(architecture)
    inputs = calibration_inputs(network.input_kind, 8, seed=9)
    network.train()
    with torch.no_grad():
        for _ in range(3):
            network(torch.from_numpy(inputs))  # normalisation away from its first state
        list(network.parameters())[-1].fill_(0.0)  # about one half, where errors show
        wanted = torch.sigmoid(network.eval()(torch.from_numpy(inputs))).numpy()
    assert wanted.std() > 1e-3
    checkpoint, fp32, int8 = (tmp_path / name for name in ("new.pt", "new.onnx", "new-int8.onnx"))
    torch.save({"architecture": architecture, "weights": network.state_dict()}, checkpoint)
    assert main(["export", "--format", "onnx", str(checkpoint), "--out", str(fp32)]) == 0
    np.testing.assert_allclose(_run(fp32.read_bytes(), inputs), wanted, atol=1e-5)
    module, _ = module_from_onnx(fp32.read_bytes())
    with torch.no_grad():
        again = np.concatenate([module(torch.from_numpy(one[None])).numpy() for one in inputs])
    np.testing.assert_allclose(again, wanted, atol=1e-5)
    assert main(["export", "--format", "int8", "--images", "16", str(fp32), "--out", str(int8)]) == 0
    assert int8.stat().st_size < 0.35 * fp32.stat().st_size
    assert np.sqrt(np.mean((_run(int8.read_bytes(), inputs) - wanted) ** 2)) < 0.02


def test_litert(source: Path, tmp_path: Path, images: np.ndarray) -> None:
    pytest.importorskip("litert_torch", reason="litert-torch is not installed: the extra litert-export")
    from synthetic_images import PEAK_S, Reflector, image
    from tiny_network import write_model

    from saranga.denoise import load_denoiser
    from saranga.export_formats import tflite_edges
    from saranga.localise import edges

    out = tmp_path / "tiny.tflite"
    assert main(["export", "--format", "tflite", "--images", "32", str(source), "--out", str(out)]) == 0
    found = tflite_edges(out.read_bytes(), images)[:, 0]
    assert np.sqrt(np.mean((found - [expected(image[0]) for image in images]) ** 2)) < 0.03
    denoiser = load_denoiser("saranga-litert", weights=str(write_model(tmp_path, tflite=out.read_bytes())))
    picture = image([Reflector(0.8)], 25.0, np.random.default_rng(0))
    paths, _ = edges(denoiser(picture), 0.5)
    assert paths.size == 1 and paths[0] / 2 == pytest.approx(0.8 + PEAK_S * 343.2 / 2, abs=0.004)
    assert denoiser(picture).tobytes() == denoiser(picture).tobytes()


def test_litert_converter_missing(source: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "litert_torch", None)
    out = tmp_path / "tiny.tflite"
    assert main(["export", "--format", "tflite", "--images", "4", str(source), "--out", str(out)]) == 2
    assert "saranga-bench[train,litert-export]" in capsys.readouterr().err
    assert not out.exists()


def test_pytorch_missing(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    checkpoint = tmp_path / "trained.pt"
    checkpoint.write_bytes(b"x")
    assert main(["export", "--format", "onnx", str(checkpoint), "--out", str(tmp_path / "a.onnx")]) == 2
    assert "pip install 'saranga-bench[train]'" in capsys.readouterr().err


def test_network_that_lost_its_accuracy_is_not_written(
    source: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "bad.onnx"
    monkeypatch.setattr(export_command, "MOST_RMS", 1e-9)
    assert main(["export", "--format", "int8", "--images", "4", str(source), "--out", str(out)]) == 4
    assert "was not written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize(("arguments", "said"), [
    (["--format", "onnx", "{source}", "--out", "{folder}/a.tflite"], "writes .onnx files"),
    (["--format", "openvino", "{source}", "--out", "{folder}/a.onnx"], "writes .xml files"),
    (["--format", "onnx", "{source}", "--out", "{folder}/none/a.onnx"], "there is no folder"),
    (["--format", "onnx", "{folder}/none.pt", "--out", "{folder}/a.onnx"], "none.pt does not exist"),
    (["--format", "onnx", "{source}", "--out", "{source}"], "exists: networks are never overwritten"),
    (["--format", "int8", "{source}", "--out", "{folder}/a.onnx", "--images", "2"], "--images is 2: give at least 4"),
    (["--format", "int8", "{source}", "--out", "{folder}/a.onnx", "--recipe", "no"], "'no': known are default"),
    (["--format", "int8", "{cut}", "--out", "{folder}/a.onnx"], "is no usable ONNX model")])
def test_refusals(source: Path, tmp_path: Path, capsys, arguments: list[str], said: str) -> None:
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(source.read_bytes()[:-40])
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    filled = [text.format(source=source, folder=tmp_path, cut=cut) for text in arguments]
    assert main(["export", *filled]) == 2
    assert said in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_second_file_of_openvino_is_not_overwritten(source: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "a.bin").write_bytes(b"mine")
    assert main(["export", "--format", "openvino", str(source), "--out", str(tmp_path / "a.xml")]) == 2
    assert "a.bin exists" in capsys.readouterr().err
    assert (tmp_path / "a.bin").read_bytes() == b"mine" and not (tmp_path / "a.xml").exists()
