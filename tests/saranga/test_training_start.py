"""Starting a training from a published network: the same function, with its normalisation taken apart again."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch: pip install 'saranga-bench[train]'")
pytest.importorskip("onnx", reason="reading published networks needs onnx: pip install 'saranga-bench[train]'")

from test_training_data import small  # noqa: E402

from saranga.errors import UsageError  # noqa: E402
from saranga.fixtures import fixture_dir  # noqa: E402
from saranga.network import build_network  # noqa: E402
from saranga.training.feed import Feed  # noqa: E402
from saranga.training.start import start_from  # noqa: E402

MODELS = fixture_dir() / "models"


def some_inputs() -> torch.Tensor:
    feed = Feed(small(pairs=64))
    try:
        return torch.cat([torch.from_numpy(b.inputs) for b in feed])
    finally:
        feed.close()


def test_the_shipped_network_computes_the_same_and_is_normalised() -> None:
    import onnxruntime

    inputs = some_inputs()
    network = build_network("tracks")
    origin = start_from(Path("saranga"), "tracks", network, inputs)
    about = json.loads((MODELS / "saranga.json").read_text())
    assert origin["recipe_sha256"] == about["training"]["recipe_sha256"]
    assert origin["file_sha256"] == about["files"]["fp32"]["sha256"]
    session = onnxruntime.InferenceSession(str(MODELS / "saranga.onnx"), providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    wanted = np.concatenate([session.run(None, {name: one[None].numpy()})[0].reshape(1, -1) for one in inputs])
    with torch.inference_mode():
        mine = torch.sigmoid(network.eval()(inputs)).numpy()
        trained = torch.sigmoid(network.train()(inputs)).numpy()
    assert np.abs(mine - wanted).max() < 1e-4
    assert np.abs(trained - wanted).max() < 1e-2, "batch statistics of the same images must change little"


def test_what_cannot_be_started_from_is_named(tmp_path: Path) -> None:
    inputs = some_inputs()
    with pytest.raises(UsageError, match=r"saranga.*tracks.*paper"):
        start_from(Path("saranga"), "paper", build_network("paper"), inputs)
    with pytest.raises(UsageError, match="did you mean 'saranga'"):
        start_from(Path("sarang"), "tracks", build_network("tracks"), inputs)
    shutil.copy(MODELS / "saranga.json", tmp_path / "mine.json")
    (tmp_path / "mine.onnx").write_bytes(b"not a network")
    with pytest.raises(UsageError, match="cannot be read as ONNX"):
        start_from(tmp_path / "mine.onnx", "tracks", build_network("tracks"), inputs)
    shutil.copy(MODELS / "saranga-int8.onnx", tmp_path / "mine.onnx")
    with pytest.raises(UsageError, match="fp32 file"):
        start_from(tmp_path / "mine.onnx", "tracks", build_network("tracks"), inputs)
    (tmp_path / "mine.json").unlink()
    with pytest.raises(UsageError, match=r"mine\.json"):
        start_from(tmp_path / "mine.onnx", "tracks", build_network("tracks"), inputs)
