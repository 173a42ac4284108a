"""The network in PyTorch, rebuilt from the ONNX file: a reference for the runtimes, and the way to other formats.

Only operators that encoder-decoder networks are made of are known; another one is refused by name.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.denoise.base import Denoiser
from saranga.denoise.network_denoiser import (
    NetworkDenoiser,
    need,
    need_threads,
    open_weights,
    unreadable,
)
from saranga.denoise.pulse import RING_DOWN_M

NAME = "saranga-torch"
WEIGHTS = "fp32"


def build(weights: str = "saranga", threads: int = 1, ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """The fp32 weights, run operator by operator on so many threads; `weights` is a name or a metadata path.

    Raises:
        UsageError: PyTorch, onnx or the weights are missing or wrong. ValueError: an option out of its bounds.
    """
    torch = need(NAME, "torch", "torch", "train")
    need(NAME, "onnx", "onnx", "train")
    need_threads(threads)
    model, data = open_weights(weights, "fp32", ("fp32",))
    try:
        network, shape = module_from_onnx(data)
    except ValueError as error:
        raise unreadable(model, "PyTorch", error) from error

    def infer(image: NDArray[np.float32]) -> NDArray[np.float32]:
        before = torch.get_num_threads()  # one setting for the whole process: leave it as it was
        torch.set_num_threads(threads)
        try:
            with torch.inference_mode():
                return network(torch.from_numpy(image)).numpy()
        finally:
            torch.set_num_threads(before)

    return NetworkDenoiser(NAME, f"PyTorch {torch.__version__} fp32", model, shape, infer, ring_down_m)


def module_from_onnx(data: bytes) -> tuple[Any, tuple[int, ...]]:
    """A `torch.nn.Module` that computes what the ONNX graph does, and the shape of its input.

    Raises:
        ValueError: not an ONNX model, or an operator that is not known here.
    """
    import onnx
    import torch
    from onnx import numpy_helper

    try:
        graph = onnx.load_from_string(data).graph
    except Exception as error:  # protobuf's decoding error
        raise ValueError(f"not an ONNX model: {error}") from error
    if not graph.node:
        raise ValueError("the graph is empty")
    constants = {item.name: numpy_helper.to_array(item) for item in graph.initializer}
    steps: list[tuple[Callable[..., Any], list[str], str]] = []
    for node in graph.node:
        settings = {item.name: onnx.helper.get_attribute_value(item) for item in node.attribute}
        if node.op_type == "Constant":
            constants[node.output[0]] = numpy_helper.to_array(settings["value"])
        elif node.op_type == "Identity" and node.input[0] in constants:
            constants[node.output[0]] = constants[node.input[0]]
        elif node.op_type in _OPERATORS:
            static = [constants.get(name) for name in node.input]
            operator, used = _OPERATORS[node.op_type](settings, static)
            steps.append((operator, [node.input[i] for i in used], node.output[0]))
        else:
            raise ValueError(f"operator {node.op_type} is not known: known are {', '.join(sorted(_OPERATORS))}")
    entry = next(item for item in graph.input if item.name not in constants)
    result = graph.output[0].name

    class Graph(torch.nn.Module):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            super().__init__()
            self.names: dict[str, str] = {}
            for name in {name for _, names, _ in steps for name in names if name in constants}:
                self.names[name] = f"w{len(self.names)}"
                self.register_buffer(self.names[name], torch.from_numpy(constants[name].copy()))

        def forward(self, image: Any) -> Any:
            values = {entry.name: image} | {name: getattr(self, own) for name, own in self.names.items()}
            for operator, names, output in steps:
                values[output] = operator(*(values[name] for name in names))
            return values[result]

    shape = tuple(d.dim_value for d in entry.type.tensor_type.shape.dim)
    return Graph().eval(), shape


Settings = dict[str, Any]
Static = Sequence[NDArray[Any] | None]


def _convolution(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    from torch.nn import functional

    top, left, bottom, right = settings.get("pads", [0, 0, 0, 0])
    even = (top, left) == (bottom, right)
    rest = (settings.get("strides", [1, 1]), (top, left) if even else 0, settings.get("dilations", [1, 1]),
            settings.get("group", 1))

    def run(x: Any, weight: Any, bias: Any = None) -> Any:
        padded = x if even else functional.pad(x, (left, right, top, bottom))
        return functional.conv2d(padded, weight, bias, *rest)

    return run, list(range(len(static)))


def _transposed(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    from torch.nn import functional

    top, left, bottom, right = settings.get("pads", [0, 0, 0, 0])
    if (top, left) != (bottom, right):
        raise ValueError(f"ConvTranspose with uneven pads {settings['pads']}")
    stride, groups = settings.get("strides", [1, 1]), settings.get("group", 1)
    extra, dilation = settings.get("output_padding", [0, 0]), settings.get("dilations", [1, 1])

    def run(x: Any, weight: Any, bias: Any = None) -> Any:
        return functional.conv_transpose2d(x, weight, bias, stride, (top, left), extra, groups, dilation)

    return run, list(range(len(static)))


def _pool(name: str) -> Callable[[Settings, Static], tuple[Callable[..., Any], list[int]]]:
    def make(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
        from torch.nn import functional

        if any(settings.get("pads", [])) or settings.get("ceil_mode", 0) or set(settings.get("dilations", [1])) != {1}:
            raise ValueError(f"{name} with pads, dilations or ceil_mode")
        window, stride = settings["kernel_shape"], settings.get("strides", [1] * len(settings["kernel_shape"]))
        operator = getattr(functional, name)
        return (lambda x: operator(x, window, stride)), [0]

    return make


def _reshape(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    if static[1] is None:
        raise ValueError("Reshape to a computed shape")
    shape = [int(v) for v in static[1]]
    if 0 in shape:
        raise ValueError(f"Reshape to {shape}")
    return (lambda x: x.reshape(shape)), [0]


def _normalisation(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    from torch.nn import functional

    epsilon = settings.get("epsilon", 1e-5)
    return (lambda x, gain, bias, mean, variance:
            functional.batch_norm(x, mean, variance, gain, bias, False, 0.0, epsilon)), [0, 1, 2, 3, 4]


def _slice(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    if any(item is None for item in static[1:]):
        raise ValueError("Slice with computed bounds")
    starts, stops, axes = ([int(v) for v in np.ravel(item)] for item in static[1:4])  # type: ignore[arg-type]
    steps = [int(v) for v in np.ravel(static[4])] if len(static) > 4 else [1] * len(starts)  # type: ignore[arg-type]

    def run(x: Any) -> Any:
        for start, stop, axis, step in zip(starts, stops, axes, steps, strict=True):
            where = [slice(None)] * x.dim()
            where[axis] = slice(start, min(stop, x.shape[axis]), step)
            x = x[tuple(where)]
        return x

    return run, [0]


def _gather(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    if static[1] is None or static[1].ndim:
        raise ValueError("Gather of more than one index")
    axis, index = settings.get("axis", 0), int(static[1])
    return (lambda x: x.select(axis, index)), [0]


def _squeeze(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    axes = tuple(int(v) for v in np.ravel(static[1] if len(static) > 1 else settings["axes"]))  # type: ignore[arg-type]
    return (lambda x: x.squeeze(axes)), [0]


def _concat(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
    import torch

    return (lambda *parts: torch.cat(parts, settings["axis"])), list(range(len(static)))


def _plain(name: str) -> Callable[[Settings, Static], tuple[Callable[..., Any], list[int]]]:
    def make(settings: Settings, static: Static) -> tuple[Callable[..., Any], list[int]]:
        import torch

        return getattr(torch, name), list(range(len(static)))

    return make


_OPERATORS: dict[str, Callable[[Settings, Static], tuple[Callable[..., Any], list[int]]]] = {
    "Add": _plain("add"), "AveragePool": _pool("avg_pool2d"), "BatchNormalization": _normalisation, "Concat": _concat,
    "Conv": _convolution, "ConvTranspose": _transposed, "Gather": _gather, "Identity": _plain("clone"),
    "MaxPool": _pool("max_pool2d"), "Mul": _plain("mul"), "Relu": _plain("relu"), "Reshape": _reshape,
    "Sigmoid": _plain("sigmoid"), "Slice": _slice, "Squeeze": _squeeze,
}
