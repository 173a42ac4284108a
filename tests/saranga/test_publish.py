"""`python -m saranga publish`: what it writes is what `load_denoiser` takes."""

import hashlib
import json
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="training needs PyTorch: pip install 'saranga-bench[train]'")

from test_training import options, quiet
from test_training_data import small

from saranga.__main__ import main
from saranga.denoise import load_denoiser
from saranga.fixtures import fixture_dir
from saranga.training.loop import train


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(small(pairs=64), options(tmp_path_factory.mktemp("training")), quiet)


def test_a_published_network_flies_by_its_path(checkpoint: Path, tmp_path: Path,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["publish", str(checkpoint), "--out", str(tmp_path), "--images", "50"]) == 0
    path = Path(capsys.readouterr().out.strip())
    metadata = json.loads(path.read_text())
    for listed in metadata["files"].values():
        assert hashlib.sha256((tmp_path / listed["file"]).read_bytes()).hexdigest() == listed["sha256"]
    assert metadata["training"]["images_seen"] == 64 and metadata["training"]["recipe"]["data"]["pairs"] == 64
    assert set(metadata["metrics"]) == {"fp32", "int8"}
    denoiser = load_denoiser("saranga", weights=str(path))
    assert denoiser.threshold == metadata["threshold"] and 0.0 < denoiser.threshold <= 1.0
    assert denoiser.edge_offset_m == metadata["edge_offset_m"]
    assert main(["publish", str(checkpoint), "--out", str(tmp_path), "--images", "50"]) == 2
    assert "never overwritten" in capsys.readouterr().err


def test_bad_input_is_one_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, words in (([str(tmp_path / "no.pt")], "does not exist"), ([__file__], "cannot be read"),
                        (["x.pt", "--images", "3"], "--images is 3"), (["x.pt", "--tflite", "no"], "--tflite no")):
        assert main(["publish", *more, "--out", str(tmp_path / "out")]) == 2
        message = capsys.readouterr().err
        assert words in message and message.count("\n") == 1


def test_shipped_weights_are_small_and_what_their_metadata_says() -> None:
    folder = fixture_dir() / "models"
    metadata = json.loads((folder / "saranga.json").read_text())
    sizes = [(folder / listed["file"]).stat().st_size for listed in metadata["files"].values()]
    assert sum(sizes) < 8_000_000
    assert 1.24e6 * 0.95 <= metadata["parameters"] <= 1.24e6 * 1.05
    for listed in metadata["files"].values():
        assert hashlib.sha256((folder / listed["file"]).read_bytes()).hexdigest() == listed["sha256"]
    assert {"recipe", "seed", "images_seen", "hardware"} <= metadata["training"].keys()
