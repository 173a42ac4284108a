"""The network on OpenVINO, the fastest on a CPU: it reads the same ONNX file as ONNX Runtime."""

import sys
from types import ModuleType
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

NAME = "saranga-openvino"
WEIGHTS = "int8"
PACKAGE = "openvino"


def import_openvino(asked_by: str = NAME) -> ModuleType:
    """OpenVINO without its telemetry, which would report every import and write an identifier into the home folder.

    Raises:
        UsageError: not installed.
    """
    if PACKAGE not in sys.modules and "openvino_telemetry" not in sys.modules:
        sys.modules["openvino_telemetry"] = None  # type: ignore[assignment]  # its import fails; a stub takes its place
    return need(asked_by, PACKAGE, "openvino", "openvino")


def build(weights: str = "saranga", precision: str = WEIGHTS, threads: int = 1,
          ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """Weights of a precision, int8 or fp32, on so many threads; `weights` is a name or a metadata path.

    Raises:
        UsageError: the runtime or the weights are missing or wrong. ValueError: an option out of its bounds.
    """
    openvino = import_openvino()
    model, data = open_weights(weights, precision, ("int8", "fp32"))
    settings: dict[str, Any] = {
        "INFERENCE_NUM_THREADS": need_threads(threads),
        "NUM_STREAMS": 1,
        "PERFORMANCE_HINT": "LATENCY",
        # bfloat16 is the default where the CPU has it: the same weights would give other edges elsewhere.
        "INFERENCE_PRECISION_HINT": "f32",
        # Processes that fly side by side would all be pinned to the same first core.
        "ENABLE_CPU_PINNING": False,
    }
    try:
        core = openvino.Core()
        network = core.read_model(data, b"")
        shape = tuple(network.inputs[0].get_partial_shape().to_shape())
        request = core.compile_model(network, "CPU", settings).create_infer_request()
    except RuntimeError as error:
        raise unreadable(model, "OpenVINO", error) from error

    def infer(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return request.infer([image], share_inputs=True, share_outputs=True)[0]

    version = openvino.__version__.split("-")[0]
    return NetworkDenoiser(NAME, f"OpenVINO {version} {precision}", model, shape, infer, ring_down_m)
