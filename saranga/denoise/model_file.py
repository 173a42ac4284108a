"""Trained networks on disk: one metadata file (NAME.json) and its weights beside it, checked before they are used.

The metadata names the files of each precision with their SHA-256, so that weights and the threshold that was
calibrated for them cannot drift apart:

    {"name": "saranga", "threshold": 0.6, "edge_offset_m": 0.001, "input": "tracks-2",
     "files": {"fp32": {"file": "saranga.onnx", "sha256": "..."}, "int8": {...}, "tflite": {...}}, ...}
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from saranga.errors import UsageError
from saranga.fixtures import fixture_path


@dataclass(frozen=True)
class ModelFile:
    """Weights of one precision and what the denoiser must know about them.

    `made_from` is the input it was trained on (`saranga.input_kinds.MADE`), empty where the metadata does not say.
    """

    name: str
    precision: str
    path: Path
    sha256: str
    threshold: float
    edge_offset_m: float
    made_from: str = ""

    def read(self) -> bytes:
        """The weights.

        Raises:
            UsageError: the file is missing, or is not the one that the metadata describes.
        """
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise UsageError(f"weights {self.path} of model {self.name!r} cannot be read: {error.strerror}; restore "
                             "the file") from error
        found = hashlib.sha256(data).hexdigest()
        if found != self.sha256:
            raise UsageError(f"weights {self.path}: SHA-256 is {found}, the metadata of model {self.name!r} says "
                             f"{self.sha256}: the file ({len(data)} bytes) is damaged or another one; restore it, or "
                             "export the weights and their metadata anew")
        return data


def model_file(weights: str, precision: str) -> ModelFile:
    """Look up weights; only the metadata is read.

    Args:
        weights: a name in fixtures/models or the path of a metadata file (.json).
        precision: "fp32", "int8", "tflite", as listed in the metadata.

    Raises:
        UsageError: unknown name or precision, or malformed metadata.
    """
    path = fixture_path("models", weights, ".json")
    metadata = _metadata(path)
    files = _entry(metadata, "files", dict, path)
    if precision not in files:
        raise UsageError(f"{path}: model {weights!r} has no {precision!r} weights: it has {', '.join(files) or 'none'}")
    listed = files[precision]
    if not isinstance(listed, dict):
        raise UsageError(f"{path}: files.{precision} is {listed!r}: expected {{\"file\": ..., \"sha256\": ...}}")
    file, sha256 = (_entry(listed, key, str, path, f"files.{precision}.") for key in ("file", "sha256"))
    return ModelFile(
        name=_entry(metadata, "name", str, path), precision=precision, path=path.parent / file, sha256=sha256,
        threshold=_number(metadata, "threshold", 0.0, 1.0, path),
        edge_offset_m=_number(metadata, "edge_offset_m", -0.5, 0.5, path),
        made_from=_entry(metadata, "input", str, path) if "input" in metadata else "")


def weights_sha256(denoiser: str, weights: str = "saranga") -> str | None:
    """SHA-256 of the weights that a denoiser of this name uses by default; None for one that has none, or MODULE:NAME.

    Raises:
        UsageError: unknown denoiser, or weights that are missing.
    """
    from saranga import denoise
    from saranga.plugins import plugins

    if ":" in denoiser:
        return None
    known = plugins(denoise)
    if denoiser not in known:
        raise UsageError(f"unknown denoiser {denoiser!r}: known are {', '.join(known)}")
    precision = getattr(known[denoiser], "WEIGHTS", None)
    return None if precision is None else model_file(weights, precision).sha256


def _metadata(path: Path) -> dict[str, Any]:
    try:
        metadata = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not valid JSON: {error}; restore the file") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    if not isinstance(metadata, dict):
        raise UsageError(f"{path}: holds a {type(metadata).__name__}; expected the metadata of a model (an object)")
    return metadata


def _entry(table: dict[str, Any], key: str, kind: type, path: Path, where: str = "") -> Any:
    if not isinstance(table.get(key), kind):
        found = f"is {table[key]!r}" if key in table else "is missing"
        raise UsageError(f"{path}: {where}{key} {found}; expected {'text' if kind is str else 'an object'}")
    return table[key]


def _number(table: dict[str, Any], key: str, low: float, high: float, path: Path) -> float:
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise UsageError(f"{path}: {key} is {value!r}; expected a number from {low:g} to {high:g}")
    return float(value)
