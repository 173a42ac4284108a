"""What the network's denoisers refuse, and what they leave alone."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tiny_network import onnx_bytes, track_onnx_bytes, write_model

from saranga.denoise import denoiser_names, load_denoiser
from saranga.denoise.model_file import weights_sha256
from saranga.errors import DeviceError, UsageError

pytest.importorskip("onnx")
ROOT = Path(__file__).resolve().parents[2]
NAMES = ["saranga", "saranga-litert", "saranga-onnx", "saranga-openvino", "saranga-torch"]
RUNTIMES = [("saranga-onnx", "onnxruntime"), ("saranga-openvino", "openvino"), ("saranga-torch", "torch")]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write_model(tmp_path, fp32=onnx_bytes(), int8=onnx_bytes())


def _load(name: str, path: Path) -> Any:
    return load_denoiser(name, weights=str(path), **({} if name == "saranga-torch" else {"precision": "fp32"}))


def _rehash(path: Path) -> None:
    metadata = json.loads(path.read_text())
    for listed in metadata["files"].values():
        listed["sha256"] = hashlib.sha256((path.parent / listed["file"]).read_bytes()).hexdigest()
    path.write_text(json.dumps(metadata))


def test_all_are_found_by_name() -> None:
    assert set(NAMES) <= set(denoiser_names())


def test_edge_tpu_is_only_used_where_its_library_is(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from saranga.denoise import network_litert

    class Runtime:
        asked: list[str] = []  # noqa: RUF012

        def load_delegate(self, library: str) -> str:
            self.asked.append(library)
            return "delegate"

    runtime = Runtime()
    assert network_litert._delegate(runtime, "auto") is None and runtime.asked == []
    monkeypatch.setattr(network_litert, "EDGE_TPU", "libc.so.6")  # any library that loads
    assert network_litert._delegate(runtime, "none") is None and runtime.asked == []
    assert network_litert._delegate(runtime, "auto") == "delegate" and runtime.asked == ["libc.so.6"]


@pytest.mark.parametrize(("name", "package", "command"), [
    ("saranga-onnx", "onnxruntime", "saranga-bench[onnxruntime]"),
    ("saranga-openvino", "openvino", "saranga-bench[openvino]"),
    ("saranga-torch", "torch", "saranga-bench[train]"),
    ("saranga-litert", "ai_edge_litert.interpreter", "saranga-bench[litert]")])
def test_missing_runtime_says_how_to_install_it(
    model: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str, command: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    assert name in denoiser_names()
    with pytest.raises(UsageError) as caught:
        load_denoiser(name, weights=str(model))
    assert command in str(caught.value) and name in str(caught.value)


def test_default_takes_the_fastest_that_is_installed(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openvino")
    pytest.importorskip("onnxruntime")
    from saranga.denoise import network_fastest

    assert "ONNX Runtime" in load_denoiser("saranga", weights=str(model)).runtime
    missing = {"onnxruntime"}
    monkeypatch.setattr(network_fastest, "find_spec", lambda package: None if package in missing else object())
    denoiser = load_denoiser("saranga", weights=str(model))
    assert "OpenVINO" in denoiser.runtime and denoiser.name == "saranga"
    missing.add("openvino")
    with pytest.raises(UsageError, match=r"none of onnxruntime, openvino is installed"):
        load_denoiser("saranga", weights=str(model))


@pytest.mark.parametrize(("name", "package"), RUNTIMES)
def test_damaged_weights(model: Path, name: str, package: str) -> None:
    pytest.importorskip(package)
    file = model.parent / "tiny-fp32.onnx"
    whole = file.read_bytes()
    file.write_bytes(whole[:-50])
    with pytest.raises(UsageError) as caught:
        _load(name, model)
    assert str(file) in str(caught.value)
    assert hashlib.sha256(whole).hexdigest() in str(caught.value)
    assert hashlib.sha256(whole[:-50]).hexdigest() in str(caught.value)
    _rehash(model)
    with pytest.raises(UsageError, match=r"tiny-fp32.onnx \(\d+ bytes\): .* cannot load them"):
        _load(name, model)
    file.unlink()
    with pytest.raises(UsageError, match=r"tiny-fp32.onnx .* cannot be read"):
        _load(name, model)


@pytest.mark.parametrize(("name", "package"), RUNTIMES)
def test_weights_of_another_shape(tmp_path: Path, name: str, package: str) -> None:
    pytest.importorskip(package)
    path = write_model(tmp_path, fp32=onnx_bytes(rows=16))
    with pytest.raises(UsageError, match=r"the input is \(1, 1, 16, 512\); expected .*\(1, 1, 32, 512\) .envelope"):
        _load(name, path)


@pytest.mark.parametrize("changes", [{}, {"input": "tracks-1"}, {"input": "envelope-1"}])
def test_weights_trained_on_another_making_of_the_input(tmp_path: Path, changes: dict[str, Any]) -> None:
    pytest.importorskip("onnxruntime")
    old = write_model(tmp_path, changes, fp32=track_onnx_bytes())
    with pytest.raises(UsageError, match=r"trained on input .*this version makes 'tracks-2'.*publish"):
        _load("saranga-onnx", old)


@pytest.mark.parametrize(("name", "package"), RUNTIMES)
def test_logits_are_no_probabilities(tmp_path: Path, name: str, package: str) -> None:
    pytest.importorskip(package)
    with pytest.raises(UsageError, match=r"tiny-fp32.onnx: outputs reach from -.* expected 0..1"):
        _load(name, write_model(tmp_path, fp32=onnx_bytes(sigmoid=False)))


def test_unknown_operator_in_torch(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    with pytest.raises(UsageError, match=r"operator Unsqueeze is not known"):
        _load("saranga-torch", write_model(tmp_path, fp32=onnx_bytes(whole_image=True)))


@pytest.mark.parametrize(("changes", "said"), [
    ({"threshold": 1.5}, "threshold is 1.5; expected a number from 0 to 1"),
    ({"threshold": "high"}, "threshold is 'high'"),
    ({"edge_offset_m": 3}, "edge_offset_m is 3; expected a number from -0.5 to 0.5"),
    ({"files": {}}, "has no 'fp32' weights: it has none"),
    ({"files": {"fp32": "tiny.onnx"}}, "files.fp32 is 'tiny.onnx'"),
    ({"files": {"fp32": {"file": "tiny.onnx"}}}, "files.fp32.sha256 is missing"),
    ({"name": None}, "name is None")])
def test_malformed_metadata(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    pytest.importorskip("onnxruntime")
    path = write_model(tmp_path, changes, fp32=onnx_bytes())
    with pytest.raises(UsageError) as caught:
        _load("saranga-onnx", path)
    assert said in str(caught.value) and str(path) in str(caught.value)


def test_metadata_that_is_no_json(tmp_path: Path) -> None:
    path = tmp_path / "cut.json"
    path.write_text('{"name": "tiny", "thres')
    with pytest.raises(UsageError, match=r"cut.json: not valid JSON"):
        _load("saranga-onnx", path)


@pytest.mark.parametrize(("options", "said"), [
    ({"threads": 0}, "threads is 0; give a whole number from 1 to 64"),
    ({"precision": "int4"}, "unknown precision 'int4': known are int8, fp32"),
    ({"ring_down_m": -1.0}, "ring_down_m is -1.0; give 0..1 m"),
    ({"thread": 1}, "did you mean 'threads'"),
    ({"weights": "no/such.json"}, "'no/such.json' does not exist")])
def test_bad_options(model: Path, options: dict[str, Any], said: str) -> None:
    pytest.importorskip("onnxruntime")
    with pytest.raises(UsageError) as caught:
        load_denoiser("saranga-onnx", **({"weights": str(model)} | options))
    assert said in str(caught.value)


def test_unknown_weights_are_listed(tmp_path: Path, model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxruntime")
    fixtures = tmp_path / "fixtures"
    (fixtures / "models").mkdir(parents=True)
    for file in list(tmp_path.glob("tiny*")):
        file.rename(fixtures / "models" / file.name)
    monkeypatch.setenv("SARANGA_FIXTURES", str(fixtures))
    assert load_denoiser("saranga-onnx", weights="tiny").weights_sha256 == weights_sha256("saranga-onnx", "tiny")
    assert weights_sha256("tbd", "tiny") is None
    with pytest.raises(UsageError, match=r"unknown model 'tinny' .did you mean 'tiny'"):
        load_denoiser("saranga-onnx", weights="tinny")
    with pytest.raises(UsageError, match=r"has no 'tflite' weights: it has fp32, int8"):
        weights_sha256("saranga-litert", "tiny")


def test_image_of_another_size(model: Path) -> None:
    pytest.importorskip("onnxruntime")
    import numpy as np
    from synthetic_images import SyntheticImage

    small = SyntheticImage(np.ones((32, 256), dtype=np.complex64))
    with pytest.raises(UsageError, match=r"takes images of \(32, 512\), this one is \(32, 256\)"):
        _load("saranga-onnx", model)(small)


def test_delegate_that_does_not_load(model: Path) -> None:
    pytest.importorskip("ai_edge_litert")
    with pytest.raises(DeviceError, match=r"delegate 'libno_such.so' does not load"):
        load_denoiser("saranga-litert", weights=str(model), delegate="libno_such.so")


def _python(code: str, **environment: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True,
                          cwd=ROOT, env=os.environ | environment)
    return done.stdout.strip()


def test_discovery_imports_no_runtime() -> None:
    code = ("import sys; from saranga.denoise import denoiser_names; denoiser_names(); import saranga.__main__; "
            "print([m for m in ('torch', 'onnx', 'onnxruntime', 'openvino', 'ai_edge_litert') if m in sys.modules])")
    assert _python(code) == "[]"


def test_openvino_sends_and_writes_nothing(model: Path, tmp_path: Path) -> None:
    pytest.importorskip("openvino")
    home = tmp_path / "home"
    home.mkdir()
    code = ("import sys; from saranga.denoise import load_denoiser; "
            f"load_denoiser('saranga-openvino', weights={str(model)!r}, precision='fp32'); "
            "print(sorted(m for m in sys.modules if 'openvino_telemetry.' in m))")
    assert _python(code, HOME=str(home), NUMBA_CACHE_DIR=str(tmp_path / "numba")) == "[]"
    assert list(home.iterdir()) == []
