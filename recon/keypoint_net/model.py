"""The network: a picture in, for each keypoint a score for each place of a grid in it.

An encoder of residual blocks down to 1/32 of the picture, and a decoder back up to 1/4 (`STRIDE`). Convolutions only,
so that any size of picture goes in; about 2.7 million parameters for any number of keypoints. The softmax of a
keypoint's scores over the grid is the probability that it is there (`recon.keypoint_net.decode`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from recon.keypoint_net.torch_extra import require_torch

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

STRIDE = 4
"""Pixels between neighbouring places of the grid; place (0, 0) is pixel (0, 0)."""
WIDTHS = (16, 32, 64, 128, 192)
"""Channels at 1/2, 1/4, ... 1/32 of the picture."""
BLOCKS = (0, 1, 2, 2, 2)
"""Residual blocks there."""
HEAD = 48
SECOND_WIDTHS, SECOND_BLOCKS = (16, 32, 64, 96), (0, 1, 2, 2)
"""Of the second stage, which sees parts of a large animal at full size: less context, and less work."""


def build_network(
    keypoints: int, channels: int, widths: tuple[int, ...] = WIDTHS, blocks: tuple[int, ...] = BLOCKS, head: int = HEAD
) -> torch.nn.Module:
    """A network with random weights: (B, channels, H, W) in, scores (B, keypoints, ceil(H / 4), ceil(W / 4)) out."""
    torch = require_torch()
    nn, functional = torch.nn, torch.nn.functional

    def conv(inputs: int, outputs: int, size: int = 3, stride: int = 1) -> torch.nn.Sequential:
        kernel = nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False)
        return nn.Sequential(kernel, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))

    class Residual(nn.Module):
        def __init__(self, width: int) -> None:
            super().__init__()
            self.first = conv(width, width)
            self.second = nn.Sequential(nn.Conv2d(width, width, 3, 1, 1, bias=False), nn.BatchNorm2d(width))
            nn.init.zeros_(self.second[1].weight)  # the block begins as the identity

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return functional.relu(x + self.second(self.first(x)))

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            ins = (channels, *widths[:-1])
            self.down = nn.ModuleList(
                nn.Sequential(conv(a, b, stride=2), *(Residual(b) for _ in range(n)))
                for a, b, n in zip(ins, widths, blocks, strict=True)
            )
            outs = (head, *widths[2:])  # of the decoder, from 1/4 down; the deepest is the encoder's
            self.across = nn.ModuleList(nn.Conv2d(w, o, 1) for w, o in zip(widths[1:-1], outs[:-1], strict=True))
            self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(outs))
            self.mix = nn.ModuleList(conv(o, o) for o in outs[:-1])
            self.scores = nn.Conv2d(head, keypoints, 1)
            nn.init.normal_(self.scores.weight, std=0.01)

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            levels = []
            for stage in self.down:
                x = stage(x)
                levels.append(x)
            for i in reversed(range(len(self.mix))):
                skip = levels[i + 1]
                x = functional.interpolate(self.up[i](x), size=skip.shape[-2:], mode="nearest")
                x = self.mix[i](functional.relu(x + self.across[i](skip)))
            return self.scores(x)

    return Network()


def build_stages(keypoints: int, channels: int) -> torch.nn.Module:
    """Two networks, `first` for the whole animal and `second` for its parts at full size."""
    first = build_network(keypoints, channels)
    second = build_network(keypoints, channels, widths=SECOND_WIDTHS, blocks=SECOND_BLOCKS)
    return require_torch().nn.ModuleDict({"first": first, "second": second})


def stages(network: torch.nn.Module) -> tuple[torch.nn.Module, ...]:
    """Those of `build_stages`, or the one that there is."""
    return tuple(network.children()) if isinstance(network, require_torch().nn.ModuleDict) else (network,)


def count_parameters(network: torch.nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())
