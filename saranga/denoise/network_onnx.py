"""The network on ONNX Runtime: on every platform, no faster one needed."""

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

NAME = "saranga-onnx"
WEIGHTS = "int8"
PACKAGE = "onnxruntime"


def build(weights: str = "saranga", precision: str = WEIGHTS, threads: int = 1,
          ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """Weights of a precision, int8 or fp32, on so many threads; `weights` is a name or a metadata path.

    Raises:
        UsageError: the runtime or the weights are missing or wrong. ValueError: an option out of its bounds.
    """
    runtime = need(NAME, PACKAGE, "onnxruntime", "onnxruntime")
    model, data = open_weights(weights, precision, ("int8", "fp32"))
    options = runtime.SessionOptions()
    options.intra_op_num_threads = need_threads(threads)
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # Waiting threads must sleep: simulators run side by side on all cores.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = runtime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the library's errors have no common base but Exception
        raise unreadable(model, "ONNX Runtime", error) from error
    given = session.get_inputs()[0]
    name = given.name
    outputs = [session.get_outputs()[0].name]

    def infer(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return session.run(outputs, {name: image})[0]

    version = f"ONNX Runtime {runtime.__version__} {precision}"
    return NetworkDenoiser(NAME, version, model, given.shape, infer, ring_down_m)
