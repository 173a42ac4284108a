"""The network on LiteRT, in whole numbers throughout: what small computers and the Edge TPU run."""

import ctypes
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.denoise.base import Denoiser
from saranga.denoise.model_file import ModelFile, model_file
from saranga.denoise.network_denoiser import (
    NetworkDenoiser,
    Runtime,
    need,
    need_threads,
    open_weights,
    unreadable,
)
from saranga.denoise.pulse import RING_DOWN_M
from saranga.errors import DeviceError, UsageError

NAME = "saranga-litert"
WEIGHTS = "tflite"
EDGE_TPU = "libedgetpu.so.1"


def build(weights: str = "saranga", delegate: str = "auto", threads: int = 1,
          ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """The full-integer weights ("tflite" in the metadata) on so many threads, or on an Edge TPU.

    Args:
        delegate: "auto" takes the Edge TPU where its library is installed and a device answers, "none" never does;
            or the path of a delegate's library, which must load.

    Raises:
        UsageError: the runtime or the weights are missing or wrong. ValueError: an option out of its bounds.
        DeviceError: a delegate that was asked for does not load.
    """
    runtime = need(NAME, "ai_edge_litert.interpreter", "ai-edge-litert", "litert")
    need_threads(threads)
    loaded = _delegate(runtime, delegate)
    model, data = _weights(weights, loaded is not None)
    try:
        interpreter = runtime.Interpreter(model_content=data, num_threads=threads,
                                          experimental_delegates=[loaded] if loaded else None)
        interpreter.allocate_tensors()
    except (RuntimeError, ValueError) as error:
        raise unreadable(model, "LiteRT", error) from error
    given, wanted = interpreter.get_input_details()[0], interpreter.get_output_details()[0]
    for kind, detail in (("input", given), ("output", wanted)):
        if detail["dtype"] is not np.int8:
            raise UsageError(f"weights {model.path}: the {kind} is {np.dtype(detail['dtype']).name}; expected int8 "
                             "(python -m saranga export --format tflite)")
    infer = whole_number_runner(interpreter)
    shape = [int(v) for v in given["shape"]]
    where = "Edge TPU" if loaded else "CPU"
    return NetworkDenoiser(NAME, f"LiteRT int8 on {where}", model, shape, infer, ring_down_m)


def whole_number_runner(interpreter: Any) -> Runtime:
    """Call of a LiteRT interpreter with int8 input and output in the units of the fp32 network."""
    interpreter.allocate_tensors()
    given, wanted = interpreter.get_input_details()[0], interpreter.get_output_details()[0]
    (in_scale, in_zero), (out_scale, out_zero) = given["quantization"], wanted["quantization"]
    gain, step, zero = np.float32(1.0 / in_scale), np.float32(out_scale), np.float32(out_zero)

    def infer(image: NDArray[np.float32]) -> NDArray[np.float32]:
        whole = np.clip(np.rint(image * gain) + in_zero, -128, 127).astype(np.int8)
        interpreter.set_tensor(given["index"], whole)
        interpreter.invoke()
        return (interpreter.get_tensor(wanted["index"]).astype(np.float32) - zero) * step

    return infer


def _delegate(runtime: Any, name: str) -> Any:
    if name == "none":
        return None
    library = EDGE_TPU if name == "auto" else name
    try:
        ctypes.CDLL(library)  # LiteRT itself complains at length about a library that is not there
        return runtime.load_delegate(library)
    except (OSError, ValueError) as error:
        if name == "auto":
            return None
        raise DeviceError(f"delegate {name!r} does not load: {error}; install the Edge TPU runtime and plug the device "
                          "in, or use delegate=none") from error


def _weights(weights: str, on_device: bool) -> tuple[ModelFile, bytes]:
    """Weights compiled for the Edge TPU ("edgetpu" in the metadata) where there is one, else the plain ones."""
    precision = WEIGHTS
    if on_device:
        with suppress(UsageError):  # the delegate leaves what is not compiled for it to the CPU
            precision = model_file(weights, "edgetpu").precision
    return open_weights(weights, precision, (WEIGHTS, "edgetpu"))
