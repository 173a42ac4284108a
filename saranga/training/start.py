"""Weights to begin with: those of another run's checkpoint, or of a published network.

A published network has its batch normalisation folded into the convolutions. It is taken apart again so that the
network computes exactly the same and yet every normalised channel has mean 0 and deviation 1 over `inputs`, as training
wants it.
"""

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from saranga.errors import UsageError
from saranga.fixtures import fixture_path
from saranga.network import load_checkpoint, read_checkpoint

LAYERS = ("down1", "down2", "down3", "down4", "up4", "up3", "up2", "up1")
"""In the order in which both architectures compute them."""


def start_from(source: Path, architecture: str, network: nn.Module, inputs: Tensor) -> dict[str, Any]:
    """Give `network` the weights of `source`; returns where they come from.

    Args:
        source: a checkpoint of `python -m saranga train`, a published .onnx (fp32), or the name of a shipped network.
        architecture: of `network`.
        inputs: some training images, (B, ...) of the network's input.

    Raises:
        UsageError: no such file, or weights of another architecture.
    """
    published = source if source.suffix == ".onnx" else None
    if not source.suffix and not source.is_file():
        published = fixture_path("models", str(source), ".json").with_suffix(".onnx")
    if published is not None:
        return _from_onnx(published, architecture, network, inputs)
    content = read_checkpoint(source)
    if content["architecture"] != architecture:
        raise UsageError(f"checkpoint {source} is of architecture {content['architecture']!r}, the recipe wants "
                         f"{architecture!r}: start from one of its kind")
    network.load_state_dict(load_checkpoint(source).state_dict())
    state = content["state"]
    return {"recipe_sha256": content["recipe_sha256"], "images_seen": state["images"],
            "started_from": state.get("started_from")}


def _from_onnx(path: Path, architecture: str, network: nn.Module, inputs: Tensor) -> dict[str, Any]:
    about = path.with_suffix(".json")
    try:
        kind = json.loads(about.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{about} cannot be read ({error}): it is published with the network and says what it is"
                         ) from None
    if kind.get("architecture") != architecture:
        raise UsageError(f"{path} is of architecture {kind.get('architecture')!r}, the recipe wants {architecture!r}: "
                         "start from one of its kind")
    folded = _folded_layers(path)
    with torch.no_grad():
        for name, (weight, bias) in zip(LAYERS, folded, strict=True):
            _put(path, name, getattr(network, name), weight, bias)
        _unfold(network, inputs)
    training = kind.get("training", {})
    return {"recipe_sha256": training.get("recipe_sha256"), "images_seen": training.get("images_seen"),
            "started_from": training.get("started_from"), "file_sha256": kind["files"]["fp32"]["sha256"]}


def _folded_layers(path: Path) -> list[tuple[Tensor, Tensor]]:
    import onnx
    from onnx import numpy_helper

    try:
        graph = onnx.load(path).graph
    except Exception as error:  # protobuf's own errors
        raise UsageError(f"{path} cannot be read as ONNX: {error}") from error
    held = {one.name: one for one in graph.initializer}
    nodes = [node for node in graph.node if node.op_type in ("Conv", "ConvTranspose")]
    if len(nodes) != len(LAYERS) or any(len(n.input) != 3 or n.input[1] not in held for n in nodes):
        raise UsageError(f"{path} has {len(nodes)} plain convolutions with weights, {len(LAYERS)} are needed: give the "
                         "fp32 file, not the int8 one")
    return [(torch.from_numpy(numpy_helper.to_array(held[n.input[1]]).copy()),
             torch.from_numpy(numpy_helper.to_array(held[n.input[2]]).copy())) for n in nodes]


def _put(path: Path, name: str, layer: Any, weight: Tensor, bias: Tensor) -> None:
    convolution: Any = layer[0] if isinstance(layer, nn.Sequential) else layer
    if convolution.weight.shape != weight.shape:
        raise UsageError(f"{path}: {name} has weights {tuple(weight.shape)}, the network's are "
                         f"{tuple(convolution.weight.shape)}: it was made by another version")
    convolution.weight.copy_(weight)
    if not isinstance(layer, nn.Sequential):
        convolution.bias.copy_(bias)
        return
    norm: Any = layer[1]
    norm.running_mean.zero_()
    norm.running_var.fill_(1.0 - norm.eps)
    norm.weight.fill_(1.0)
    norm.bias.copy_(bias)


def _unfold(network: nn.Module, inputs: Tensor) -> None:
    """Normalise every channel by what `inputs` make of it, and undo that in scale and shift."""
    seen: dict[nn.BatchNorm2d, tuple[Tensor, Tensor]] = {}

    def look(module: nn.Module, given: tuple[Tensor, ...]) -> None:
        assert isinstance(module, nn.BatchNorm2d)
        seen[module] = given[0].mean((0, 2, 3)), given[0].var((0, 2, 3))

    norms = [m for m in network.modules() if isinstance(m, nn.BatchNorm2d)]
    hooks = [norm.register_forward_pre_hook(look) for norm in norms]
    was_training = network.training
    network.eval()
    network(inputs)
    network.train(was_training)
    for hook in hooks:
        hook.remove()
    for norm, (mean, variance) in seen.items():
        assert norm.running_mean is not None and norm.running_var is not None
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(variance)
        norm.weight.copy_(torch.sqrt(variance + norm.eps))
        norm.bias.add_(mean)
