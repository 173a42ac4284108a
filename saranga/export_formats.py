"""Other formats of an fp32 ONNX model: OpenVINO's own, and LiteRT in whole numbers."""

import io
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.errors import BenchError, UsageError


def openvino_from_onnx(fp32: bytes) -> tuple[bytes, bytes]:
    """OpenVINO's .xml and .bin, weights in fp32.

    Raises:
        UsageError: OpenVINO is not installed or cannot read the model.
    """
    from saranga.denoise.network_openvino import import_openvino

    openvino = import_openvino("export --format openvino")
    try:
        model = openvino.Core().read_model(fp32, b"")
    except RuntimeError as error:
        raise UsageError(f"OpenVINO cannot read the model: {str(error).strip().splitlines()[0]}") from error
    with tempfile.TemporaryDirectory(prefix="saranga-openvino-") as folder:
        path = Path(folder) / "model.xml"
        openvino.save_model(model, path, compress_to_fp16=False)
        return path.read_bytes(), path.with_suffix(".bin").read_bytes()


def tflite_from_onnx(fp32: bytes, inputs: NDArray[np.float32]) -> bytes:
    """The full-integer LiteRT model: int8 in, int8 out, ranges as seen on `inputs` (k, C, H, W).

    Raises:
        UsageError: the converter is not installed, or the model has an operator it does not know.
        BenchError: something in the result is not a whole-number operator.
    """
    try:
        import litert_torch
        import torch
        from ai_edge_quantizer import calibrator, quantizer, recipe, recipe_manager
        from ai_edge_quantizer.utils.qsv_utils import min_max_update
    except ImportError as error:
        raise UsageError(f"--format tflite needs litert-torch and ai-edge-quantizer ({error}): "
                         "pip install 'saranga-bench[train,litert-export]'") from error
    from saranga.denoise.network_torch import module_from_onnx

    try:
        module, shape = module_from_onnx(fp32)
    except ValueError as error:
        raise UsageError(f"the model cannot be converted: {error}") from error
    with tempfile.TemporaryDirectory(prefix="saranga-tflite-") as folder, redirect_stdout(io.StringIO()):
        path = Path(folder) / "floats.tflite"
        converted = litert_torch.convert(module, (torch.zeros(shape),))
        converted.export(str(path))
        whole = recipe.static_wi8_ai8()
        manager = recipe_manager.RecipeManager()
        manager.load_quantization_recipe(whole)
        # the quantiser's own calibration averages the ranges of the images, which cuts off loud echoes
        measured = calibrator.Calibrator(str(path), num_threads=1, qsv_update_func=min_max_update)
        (signature, names), = ((k, v["inputs"]) for k, v in _signatures(path).items())
        measured.calibrate({signature: [{names[0]: one[None]} for one in inputs]}, manager)
        result = quantizer.Quantizer(str(path), whole).quantize(measured.get_model_qsvs()).quantized_model
    data = bytes(result or b"")
    _check_whole(data)
    return data


def tflite_edges(data: bytes, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Edge probabilities of a full-integer LiteRT model, one result for each of `inputs` (k, C, H, W)."""
    from ai_edge_litert.interpreter import Interpreter

    from saranga.denoise.network_litert import whole_number_runner

    infer = whole_number_runner(Interpreter(model_content=data, num_threads=1))
    return np.stack([infer(one[None]) for one in inputs])


def _signatures(path: Path) -> dict[str, Any]:
    from ai_edge_litert.interpreter import Interpreter

    return Interpreter(str(path)).get_signature_list()


def _check_whole(data: bytes) -> None:
    from ai_edge_litert.interpreter import Interpreter

    interpreter = Interpreter(model_content=data)
    interpreter.allocate_tensors()
    broken = sorted({detail["name"] for detail in interpreter.get_tensor_details()
                     if np.issubdtype(detail["dtype"], np.floating)})
    if broken:
        raise BenchError(f"{len(broken)} tensors of the LiteRT model are not whole numbers, such as {broken[0]!r}: the "
                         "Edge TPU would leave them to the CPU; report the network's architecture")
