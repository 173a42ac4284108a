"""Eight-bit weights and activations: one ONNX file with quantise/dequantise pairs that every runtime runs as integers.

Static: the range of each activation is measured on synthetic images. Weights are symmetric, one scale a channel and
7 bits, because CPUs without VNNI add products of full 8-bit weights in 16 bits, which overflow: measured, the eighth
bit changes no hit rate.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from saranga.errors import UsageError
from saranga.input_kinds import inputs_of
from saranga.subpixel import without_transposed

IMAGES = 256
_LOUD_SHARE = 0.25
_LOUD_PSNR_DB = [20.0, 40.0]
"""Echoes far over the noise, as in a quiet hall: they set the upper end of the input's range."""


def calibration_inputs(kind: str, count: int = IMAGES, recipe: str = "default", seed: int = 1) -> NDArray[np.float32]:
    """Inputs (count, C, H, W) of synthetic images: a quarter with loud echoes, the rest as the recipe says; of every
    eight the last has no phase, as recordings of amplitudes have none.

    Args:
        kind: of the network's input, see `saranga.input_kinds`.
        count: at least 4.
        recipe, seed: of the synthesis.

    Raises:
        UsageError: unknown recipe, or fewer than four images.
    """
    from saranga.synthesis import Synthesiser, load_recipe

    if count < 4:
        raise UsageError(f"{count} calibration images: give at least 4")
    loud = int(count * _LOUD_SHARE)
    plain = load_recipe(recipe)
    parts = []
    for drawn, number in ((plain, count - loud), (plain.with_values({"noise.psnr_db": _LOUD_PSNR_DB}), loud)):
        batch = Synthesiser(drawn, seed, ("left",)).batch(0, number, iq=True)
        hidden = np.arange(number) % 8 == 7
        parts.append(inputs_of(kind, batch.images[:, 0], cast(NDArray[np.complex64], batch.iq)[:, 0], hidden))
    return np.concatenate(parts)


def quantised(fp32: bytes, inputs: NDArray[np.float32]) -> bytes:
    """The int8 ONNX model of an fp32 one, with the ranges seen on `inputs` (k, C, H, W).

    Raises:
        UsageError: onnxruntime or onnx is not installed.
    """
    try:
        import onnx
        from onnxruntime import quantization
    except ImportError as error:
        raise UsageError(f"int8 export needs onnxruntime and onnx ({error}): pip install 'saranga-bench[train]'"
                         ) from error

    class Reader(quantization.CalibrationDataReader):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            self._next: Iterator[dict[str, Any]] = ({name: one[None]} for one in inputs)

        def get_next(self) -> dict[str, Any] | None:
            return next(self._next, None)

    name = onnx.load_from_string(fp32).graph.input[0].name
    with tempfile.TemporaryDirectory(prefix="saranga-quantise-") as folder:
        source, plain, made = (Path(folder) / f"{step}.onnx" for step in ("source", "plain", "made"))
        source.write_bytes(without_transposed(fp32))
        quantization.shape_inference.quant_pre_process(source, plain, skip_symbolic_shape=True)
        quantization.quantize_static(
            plain, made, Reader(), quant_format=quantization.QuantFormat.QDQ, per_channel=True, reduce_range=True,
            activation_type=quantization.QuantType.QUInt8, weight_type=quantization.QuantType.QInt8,
            calibrate_method=quantization.CalibrationMethod.MinMax)
        model = onnx.load(made)
    return model.SerializeToString(deterministic=True)
