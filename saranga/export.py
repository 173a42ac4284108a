"""From a trained network (PyTorch) to the ONNX file that every runtime starts from."""

import io
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from saranga.denoise.network_denoiser import OUTPUT_SHAPES
from saranga.errors import UsageError
from saranga.input_kinds import SHAPES, input_kind

OPSET = 17
"""ONNX operator set: the newest whose every operator ONNX Runtime, OpenVINO and the quantiser know."""


def need_packages(*packages: str) -> None:
    """Raises: UsageError: one of the `packages` of the "train" extra is not installed."""
    for package in packages:
        try:
            import_module(package)
        except ImportError as error:
            raise UsageError(f"export needs the package {package} ({error}): pip install 'saranga-bench[train]'"
                             ) from error


def onnx_from_module(module: Any) -> bytes:
    """The ONNX model of a network whose forward gives logits: sigmoid inside, normalisation folded, batch of one.

    Args:
        module: `torch.nn.Module`, input of `saranga.input_kinds` (its attribute `input_kind`, or the envelope) to
            logits (1, N) or (1, M, N); it is left in its mode.

    Raises:
        UsageError: PyTorch or onnx is not installed, or the output has another shape.
    """
    need_packages("torch", "onnx")
    import onnx
    import torch

    class Probabilities(torch.nn.Module):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            super().__init__()
            self.network = module

        def forward(self, image: Any) -> Any:
            return torch.sigmoid(self.network(image))

    training = module.training
    example = torch.zeros(SHAPES[getattr(module, "input_kind", "envelope")])
    file = io.BytesIO()
    try:
        wrapped = Probabilities().eval()
        with warnings.catch_warnings():
            # the newer exporter needs another package and gives the same graph
            warnings.simplefilter("ignore", DeprecationWarning)
            torch.onnx.export(wrapped, (example,), file,  # type: ignore[arg-type, unused-ignore]  # any writable file
                              input_names=["image"], output_names=["edges"], opset_version=OPSET, dynamo=False)
    finally:
        module.train(training)
    model = onnx.load_from_string(file.getvalue())
    shape = tuple(d.dim_value for d in model.graph.output[0].type.tensor_type.shape.dim)
    if shape not in OUTPUT_SHAPES:
        raise UsageError(f"the network's output is {shape}; expected {' or '.join(map(str, OUTPUT_SHAPES))}")
    return tidied(model.SerializeToString())


def tidied(data: bytes) -> bytes:
    """The same ONNX model with constants as initialisers, aliases gone and every normalisation after a transposed
    convolution folded into it (exporters fold only those after ordinary ones), names of machines and paths dropped.
    """
    import onnx
    from onnx import numpy_helper

    model = onnx.load_from_string(data)
    graph = model.graph
    constants = {item.name: numpy_helper.to_array(item) for item in graph.initializer}
    alias: dict[str, str] = {}
    nodes = []
    for node in graph.node:
        node.input[:] = [alias.get(name, name) for name in node.input]
        if node.op_type == "Constant" and node.attribute[0].name == "value":
            constants[node.output[0]] = numpy_helper.to_array(node.attribute[0].t)
        elif node.op_type == "Identity" and node.output[0] != graph.output[0].name:
            alias[node.output[0]] = node.input[0]
        else:
            nodes.append(node)
    uses: dict[str, int] = {}
    for node in nodes:
        for name in node.input:
            uses[name] = uses.get(name, 0) + 1
    made = {node.output[0]: node for node in nodes}
    kept = []
    for node in nodes:
        source = made.get(node.input[0])
        if node.op_type == "BatchNormalization" and source is not None and uses[node.input[0]] == 1 and (
                source.op_type == "ConvTranspose"):
            _fold(source, node, constants)
            source.output[0] = node.output[0]
            made[node.output[0]] = source
        else:
            kept.append(node)
    del graph.node[:]
    graph.node.extend(kept)
    for node in graph.node:
        node.doc_string = ""
    used = {name for node in kept for name in node.input}
    del graph.initializer[:]
    graph.initializer.extend(numpy_helper.from_array(np.array(value), name)
                             for name, value in constants.items() if name in used)
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def _fold(convolution: Any, normalisation: Any, constants: dict[str, Any]) -> None:
    """Multiply the weights of a transposed convolution (in, out, h, w) by its normalisation's gain."""
    gain, bias, mean, variance = (constants[name].astype(np.float64) for name in normalisation.input[1:5])
    epsilon = next((a.f for a in normalisation.attribute if a.name == "epsilon"), 1e-5)
    gain = gain / np.sqrt(variance + epsilon)
    name = convolution.input[1]
    groups = next((a.i for a in convolution.attribute if a.name == "group"), 1)
    if groups != 1:
        raise UsageError("a transposed convolution in groups cannot be exported: use one group")
    folded = f"{name}.folded"
    constants[folded] = (constants[name] * gain[None, :, None, None]).astype(np.float32)
    before = constants[convolution.input[2]] if len(convolution.input) > 2 else 0.0
    constants[f"{folded}.bias"] = ((before - mean) * gain + bias).astype(np.float32)
    convolution.input[:] = [convolution.input[0], folded, f"{folded}.bias"]


def read_source(path: Path) -> bytes:
    """The fp32 ONNX model of a checkpoint (.pt), or of an .onnx file as it is.

    Raises:
        UsageError: the file is missing, no checkpoint of this project or no ONNX model; packages are missing.
    """
    if not path.is_file():
        raise UsageError(f"{path} does not exist: give a checkpoint (.pt) or an fp32 .onnx file")
    if path.suffix == ".onnx":
        need_packages("onnx")
        import onnx

        data = path.read_bytes()
        try:
            onnx.checker.check_model(onnx.load_from_string(data))
        except Exception as error:  # protobuf's and the checker's errors
            reason = str(error).strip().splitlines()[0][:200]
            raise UsageError(f"{path} ({len(data)} bytes) is no usable ONNX model: {reason}") from error
        return data
    need_packages("torch", "onnx")
    from saranga.network import load_checkpoint

    return onnx_from_module(load_checkpoint(path))


def source_kind(data: bytes, path: Path) -> str:
    """What an ONNX model takes (`saranga.input_kinds`); `path` is named in errors.

    Raises:
        UsageError: an input of another shape.
    """
    import onnx

    model = onnx.load_from_string(data)
    shape = tuple(d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim)
    kind = input_kind(shape)
    if kind is None:
        raise UsageError(f"{path}: the network's input is {shape}; expected {' or '.join(map(str, SHAPES.values()))}")
    return kind
