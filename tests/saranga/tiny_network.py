"""A network small enough to be understood, in every form that a runtime reads: bright columns of the last four rows."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROWS_USED = 4
GAIN, MIDDLE = 6.0, 1.8
"""Edge probability = sigmoid(GAIN (mean over rows and five columns - MIDDLE)); noise alone has a mean of 0.6."""


def expected(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """What `onnx_bytes` computes, (N,), from the normalised image (M, N)."""
    mean = image[-ROWS_USED:].astype(np.float64).mean(axis=0)
    smooth = np.convolve(np.pad(mean, 2), np.full(5, 0.2), mode="valid")
    return 1.0 / (1.0 + np.exp(-GAIN * (smooth - MIDDLE)))


def onnx_bytes(rows: int = 32, columns: int = 512, sigmoid: bool = True, whole_image: bool = False) -> bytes:
    """The network, with the operators that the real one has: slice, convolution, transposed one, batch norm, concat."""
    from onnx import TensorProto, checker, helper, numpy_helper

    def constant(name: str, value: Any, kind: type = np.float32) -> Any:
        return numpy_helper.from_array(np.array(value, dtype=kind), name)

    rng = np.random.default_rng(7)
    depth = 8
    spread = rng.uniform(0.5, 1.5, depth)
    spread /= spread.sum()
    scale = rng.uniform(0.5, 2.0, depth)
    down = np.zeros((depth, 1, ROWS_USED, 1))
    down[:, 0, :, 0] = (scale / ROWS_USED)[:, None]
    smooth = np.zeros((2 * depth, 1, 1, 5))
    smooth[:, 0, 0, :] = (0.1 * GAIN * np.concatenate([spread / scale] * 2))[:, None]
    variance = 4.0
    initialisers = [
        constant("starts", [rows - ROWS_USED], np.int64), constant("stops", [rows], np.int64),
        constant("axes", [2], np.int64), constant("down", down), constant("smooth", smooth),
        constant("gain", [np.sqrt(variance + 1e-5)]), constant("bias", [-GAIN * MIDDLE]), constant("mean", [0.0]),
        constant("variance", [variance]), constant("zero", 0, np.int64)]
    nodes = [
        helper.make_node("Slice", ["image", "starts", "stops", "axes"], ["newest"]),
        helper.make_node("Conv", ["newest", "down"], ["a"], kernel_shape=[ROWS_USED, 1]),
        helper.make_node("Relu", ["a"], ["b"]),
        helper.make_node("Concat", ["b", "a"], ["c"], axis=1),
        helper.make_node("ConvTranspose", ["c", "smooth"], ["d"], kernel_shape=[1, 5], pads=[0, 2, 0, 2]),
        helper.make_node("BatchNormalization", ["d", "gain", "bias", "mean", "variance"], ["e"], epsilon=1e-5),
        helper.make_node("Gather", ["e", "zero"], ["f"], axis=1),
        helper.make_node("Gather", ["f", "zero"], ["logits"], axis=1),
        helper.make_node("Sigmoid", ["logits"], ["edges"])]
    result, shape = ("edges" if sigmoid else "logits"), [1, columns]
    if whole_image:
        initialisers.append(constant("one", [1], np.int64))
        nodes += [helper.make_node("Unsqueeze", ["edges", "one"], ["row"]),
                  helper.make_node("Concat", ["row"] * rows, ["rows"], axis=1)]
        result, shape = "rows", [1, rows, columns]
    graph = helper.make_graph(
        nodes if sigmoid else nodes[:-1], "tiny",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 1, rows, columns])],
        [helper.make_tensor_value_info(result, TensorProto.FLOAT, shape)], initialisers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    checker.check_model(model, full_check=True)
    return model.SerializeToString()


def track_onnx_bytes() -> bytes:
    """A network that takes the track map: the best track over all speeds through all 32 rows, from 1.1 on an edge."""
    from onnx import TensorProto, checker, helper, numpy_helper

    spread = np.zeros((8, 1, 1, 4), dtype=np.float32)
    spread[6, 0, 0, :2] = spread[7, 0, 0, 2:] = 8.0  # the two halves of a bin of four columns
    graph = helper.make_graph(
        [helper.make_node("MaxPool", ["image"], ["best"], kernel_shape=[32, 1], strides=[32, 1]),
         helper.make_node("ConvTranspose", ["best", "spread", "bias"], ["wide"], strides=[1, 4], kernel_shape=[1, 4]),
         helper.make_node("Reshape", ["wide", "shape"], ["logits"]),
         helper.make_node("Sigmoid", ["logits"], ["edges"])],
        "tiny", [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 8, 32, 128])],
        [helper.make_tensor_value_info("edges", TensorProto.FLOAT, [1, 512])],
        [numpy_helper.from_array(value, name) for name, value in (
            ("spread", spread), ("bias", np.array([-8.8], np.float32)), ("shape", np.array([1, 512])))])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    checker.check_model(model, full_check=True)
    return model.SerializeToString()


def write_model(folder: Path, changes: dict[str, Any] | None = None, **files: bytes) -> Path:
    """Weights by precision (fp32=..., int8=...) and their metadata; returns the path of the metadata."""
    metadata: dict[str, Any] = {"name": "tiny", "threshold": 0.5, "edge_offset_m": 0.0, "files": {}}
    for precision, data in files.items():
        name = f"tiny-{precision}.{'tflite' if precision == 'tflite' else 'onnx'}"
        (folder / name).write_bytes(data)
        metadata["files"][precision] = {"file": name, "sha256": hashlib.sha256(data).hexdigest()}
    path = folder / "tiny.json"
    path.write_text(json.dumps(metadata | (changes or {})))
    return path
