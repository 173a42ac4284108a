"""The network on the fastest runtime that is installed."""

from importlib.util import find_spec

from saranga.denoise import network_onnx, network_openvino
from saranga.denoise.base import Denoiser
from saranga.denoise.pulse import RING_DOWN_M
from saranga.errors import UsageError

NAME = "saranga"
WEIGHTS = "int8"

FASTEST_FIRST = (network_openvino, network_onnx)
"""As measured by `make bench` (test_network_speed)."""


def build(weights: str = "saranga", precision: str = WEIGHTS, threads: int = 1,
          ring_down_m: float = RING_DOWN_M) -> Denoiser:
    """As `saranga-openvino` where OpenVINO is installed, else as `saranga-onnx`.

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
                     "pip install 'saranga-bench[openvino]' (or [onnxruntime])")
