"""The networks, in PyTorch: U-Nets of four encoder and four decoder layers and 1.24 M parameters (paper, "Perception").

`tracks` is ours: its input is the track map (`saranga.track_map`), its decoder runs along range only, since only the
edges of the newest row are ever used. `paper` is the paper's kind: from the envelope image to the edge image, rows and
columns alike.
"""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from saranga.echo import RANGE_COLUMNS
from saranga.errors import UsageError
from saranga.plugins import nearest_hint
from saranga.track_map import SHAPE as TRACK_SHAPE

_RARE = -4.0
"""First bias of the last layer: an edge in about one column of fifty, so that training need not find that first."""


def _down(inputs: int, outputs: int, kernel: tuple[int, int], stride: tuple[int, int], pad: tuple[int, int]
          ) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel, stride, pad, bias=False), nn.BatchNorm2d(outputs),
                         nn.ReLU(inplace=True))


def _up(inputs: int, outputs: int, kernel: tuple[int, int], stride: tuple[int, int], pad: tuple[int, int]
        ) -> nn.Sequential:
    return nn.Sequential(nn.ConvTranspose2d(inputs, outputs, kernel, stride, pad, bias=False),
                         nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


def _last(inputs: int, kernel: tuple[int, int], stride: tuple[int, int], pad: tuple[int, int]) -> nn.ConvTranspose2d:
    layer = nn.ConvTranspose2d(inputs, 1, kernel, stride, pad)
    if layer.bias is not None:
        nn.init.constant_(layer.bias, _RARE)
    return layer


def _over_speeds(x: Tensor) -> Tensor:
    """(B, C, S, W) to (B, 2C, 1, W): highest and mean over the speeds."""
    window = (x.shape[2], 1)
    return torch.cat([functional.max_pool2d(x, window), functional.avg_pool2d(x, window)], 1)


class TrackUNet(nn.Module):
    """Track map (B, 8, 32 speeds, 128 ranges) to logits (B, N) of the newest row's edges."""

    input_kind = "tracks"

    def __init__(self, encoder: tuple[int, int, int, int] = (32, 64, 128, 256),
                 decoder: tuple[int, int, int] = (160, 96, 64)) -> None:
        super().__init__()
        c1, c2, c3, c4 = encoder
        d4, d3, d2 = decoder
        channels, speeds, _ = TRACK_SHAPE
        self.down1 = _down(channels, c1, (4, 5), (2, 1), (1, 2))
        self.down2 = _down(c1, c2, (4, 4), (2, 2), (1, 1))
        self.down3 = _down(c2, c3, (4, 4), (2, 2), (1, 1))
        self.down4 = _down(c3, c4, (4, 4), (2, 2), (1, 1))
        along = ((1, 4), (1, 2), (0, 1))
        self.up4 = _up(c4 * speeds // 16, d4, *along)
        self.up3 = _up(d4 + 2 * c3, d3, *along)
        self.up2 = _up(d3 + 2 * c2, d2, *along)
        self.up1 = _last(d2 + 2 * c1 + 2 * channels, (1, 8), (1, 4), (0, 2))

    def forward(self, tracks: Tensor) -> Tensor:
        """Logits (B, N) of (B, 8, 32, 128)."""
        a = self.down1(tracks)
        b = self.down2(a)
        c = self.down3(b)
        d = self.down4(c)
        y = self.up4(d.reshape(d.shape[0], -1, 1, d.shape[3]))
        y = self.up3(torch.cat([y, _over_speeds(c)], 1))
        y = self.up2(torch.cat([y, _over_speeds(b)], 1))
        y = self.up1(torch.cat([y, _over_speeds(a), _over_speeds(tracks)], 1))
        return y.reshape(y.shape[0], RANGE_COLUMNS)


class PaperUNet(nn.Module):
    """Envelope image (B, 1, M, N) to logits (B, M, N); the paper names the depth and the size, not the widths."""

    input_kind = "envelope"

    def __init__(self, widths: tuple[int, int, int, int] = (16, 32, 128, 256)) -> None:
        super().__init__()
        c1, c2, c3, c4 = widths
        four = ((4, 4), (2, 2), (1, 1))
        self.down1, self.down2 = _down(1, c1, *four), _down(c1, c2, *four)
        self.down3, self.down4 = _down(c2, c3, *four), _down(c3, c4, *four)
        self.up4, self.up3, self.up2 = _up(c4, c3, *four), _up(2 * c3, c2, *four), _up(2 * c2, c1, *four)
        self.up1 = _last(2 * c1, *four)

    def forward(self, envelope: Tensor) -> Tensor:
        """Logits (B, M, N) of (B, 1, M, N)."""
        a = self.down1(envelope)
        b = self.down2(a)
        c = self.down3(b)
        y = self.up4(self.down4(c))
        y = self.up3(torch.cat([y, c], 1))
        y = self.up2(torch.cat([y, b], 1))
        return self.up1(torch.cat([y, a], 1))[:, 0]


ARCHITECTURES: dict[str, type[TrackUNet] | type[PaperUNet]] = {"tracks": TrackUNet, "paper": PaperUNet}


def build_network(architecture: str) -> TrackUNet | PaperUNet:
    """A network with new weights, from torch's random state.

    Raises:
        UsageError: an unknown architecture.
    """
    if architecture not in ARCHITECTURES:
        known = list(ARCHITECTURES)
        raise UsageError(f"unknown architecture {architecture!r}{nearest_hint(architecture, known)}: known are "
                         f"{', '.join(known)}")
    return ARCHITECTURES[architecture]()


def parameter_count(network: nn.Module) -> int:
    """Trainable parameters."""
    return sum(p.numel() for p in network.parameters() if p.requires_grad)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What `saranga.training.checkpoint` wrote.

    Raises:
        UsageError: the file is missing, or not a checkpoint of this project.
    """
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise UsageError(f"checkpoint {path} does not exist: train one with python -m saranga train") from None
    except Exception as error:  # torch raises pickle's, zip's and its own errors
        reason = str(error).strip().splitlines()[0][:160] if str(error).strip() else type(error).__name__
        raise UsageError(f"checkpoint {path} cannot be read: {reason}") from error
    if not isinstance(content, dict) or not {"architecture", "weights"} <= set(content):
        raise UsageError(f"checkpoint {path} is not of python -m saranga train: it has no architecture and weights")
    return content


def load_checkpoint(path: Path) -> TrackUNet | PaperUNet:
    """The trained network of a checkpoint, ready for inference.

    Raises:
        UsageError: see `read_checkpoint`, or weights of another shape.
    """
    content = read_checkpoint(path)
    network = build_network(content["architecture"])
    try:
        network.load_state_dict(content["weights"])
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()[:160]
        raise UsageError(f"checkpoint {path}: its weights are not of architecture {content['architecture']!r}: {reason}"
                         ) from error
    return network.eval()
