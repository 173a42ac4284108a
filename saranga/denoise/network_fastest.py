"""The network on the runtime that is fastest in flight and installs everywhere.

Alone in a loop OpenVINO is a little faster; called 32 times a second between other work ONNX Runtime is. It is
a dependency of the project, so flights have the same bits everywhere; OpenVINO only stands in where it is missing.
"""

from importlib.util import find_spec

from saranga.denoise import network_onnx, network_openvino
from saranga.denoise.base import Denoiser
from saranga.denoise.pulse import RING_DOWN_M
from saranga.errors import UsageError

NAME = "saranga"
WEIGHTS = "int8"

FASTEST_FIRST = (network_onnx, network_openvino)
"""In flights: 8.1 and 7.2 times real time on real ArduCopter."""


def build(weights: str = "saranga", precision: str = WEIGHTS, threads: int = 1,
          ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """As `saranga-onnx` where ONNX Runtime is installed, else as `saranga-openvino`.

    Raises:
        UsageError: no runtime, or the weights are missing or wrong. ValueError: an option out of its bounds.
    """
    for module in FASTEST_FIRST:
        if find_spec(module.PACKAGE) is not None:
            denoiser = module.build(weights, precision, threads, ring_down_m)
            denoiser.name = NAME
            return denoiser
    raise UsageError(f"denoiser {NAME!r} needs a runtime, and none of "
                     f"{', '.join(module.PACKAGE for module in FASTEST_FIRST)} is installed: "
                     "pip install onnxruntime")
