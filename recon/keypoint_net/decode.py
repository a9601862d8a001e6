"""From the network's scores to points: where each keypoint is, to a fraction of a place of the grid, and how likely.

A softmax over the grid makes probabilities of a keypoint's scores. The point is where most of it lies within a small
blur (`BLUR` places): a broad peak beats a sharp one of less weight. Between places of the grid, a parabola through the
logarithm of the blurred probability at the peak and its neighbours finds the maximum; it is exact for a Gaussian, which
is what the network is trained on. The raw likelihood is the probability within the tolerance of the point, which
`recon.keypoint_net.calibrate` maps to a share of right points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

SIGMA = 0.9
"""Of the Gaussian that the network is to give, in places of the grid."""
LEAST_SIGMA = 0.15
"""Standard deviation of a point in places, if the probability is no broader than that."""
BLUR = 0.8
"""Standard deviation, in places of the grid."""
FAR = 4.0
_REACH = 3


@dataclass(frozen=True)
class Window:
    """Where each keypoint may be: within `reach` of `near` (B, K, 2), in places of the grid."""

    near: torch.Tensor
    reach: float

    def mask(self, size: torch.Size | tuple[int, int]) -> torch.Tensor:
        """(B, K, h, w): which places are in it; none for a keypoint that is NaN."""
        return distance2(self.near, size) <= self.reach**2


def distance2(xy: torch.Tensor, size: torch.Size | tuple[int, int]) -> torch.Tensor:
    """(B, K, h, w): squared distance of each place from points (B, K, 2)."""
    import torch  # pyright: ignore[reportMissingImports]

    rows, columns = (torch.arange(n, dtype=torch.float32, device=xy.device) for n in size)
    across, down = (columns - xy[..., :1]) ** 2, (rows - xy[..., 1:]) ** 2
    return down[..., :, None] + across[..., None, :]


NOWHERE = -1e4
"""Score of places outside of the window."""


def probabilities(scores: torch.Tensor, window: Window | None = None) -> torch.Tensor:
    """(B, K, h, w), float32, each keypoint's grid adding up to 1."""
    scores = scores.float()
    if window is not None:
        scores = scores.masked_fill(~window.mask(scores.shape[2:]), NOWHERE)
    return scores.flatten(2).softmax(dim=2).view(scores.shape)


def decode(probability: torch.Tensor, tolerance: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Points (B, K, 2) as x, y in places of the grid, and the probability (B, K) within `tolerance` places of them."""
    import torch  # pyright: ignore[reportMissingImports]

    b, k, h, w = probability.shape
    offsets = torch.arange(-_REACH, _REACH + 1, dtype=torch.float32, device=probability.device)
    kernel = torch.exp(-0.5 * (offsets / BLUR) ** 2)
    kernel = kernel / kernel.sum()
    across = kernel.view(1, 1, 1, -1).expand(k, 1, 1, -1).contiguous()
    down = kernel.view(1, 1, -1, 1).expand(k, 1, -1, 1).contiguous()
    blurred = torch.nn.functional.conv2d(probability, across, padding=(0, _REACH), groups=k)
    blurred = torch.nn.functional.conv2d(blurred, down, padding=(_REACH, 0), groups=k).reshape(b * k, h, w)
    flat = probability.reshape(b * k, h, w)
    peak = blurred.flatten(1).argmax(dim=1)
    row, column = peak // w, peak % w
    n = torch.arange(b * k, device=probability.device)

    def refined(along: torch.Tensor, size: int, at: list[torch.Tensor]) -> torch.Tensor:
        before, here, after = (value.clamp_min(1e-30).log() for value in at)
        bend = before - 2 * here + after
        shift = torch.where(bend < -1e-6, 0.5 * (before - after) / bend.clamp(max=-1e-6), torch.zeros_like(bend))
        inside = (along > 0) & (along < size - 1)
        return along + torch.where(inside, shift.clamp(-0.5, 0.5), torch.zeros_like(shift))

    x = refined(column, w, [blurred[n, row, (column + d).clamp(0, w - 1)] for d in (-1, 0, 1)])
    y = refined(row, h, [blurred[n, (row + d).clamp(0, h - 1), column] for d in (-1, 0, 1)])
    # The probability within the tolerance, from the places around the peak; one at the edge counts in part.
    reach = int(tolerance + 1.5)
    steps = torch.arange(-reach, reach + 1, device=probability.device)
    rows, columns = row[:, None, None] + steps[None, :, None], column[:, None, None] + steps[None, None, :]
    known = (rows >= 0) & (rows < h) & (columns >= 0) & (columns < w)
    values = flat[n[:, None, None], rows.clamp(0, h - 1), columns.clamp(0, w - 1)]
    distance = ((rows - y[:, None, None]) ** 2 + (columns - x[:, None, None]) ** 2).sqrt()
    within = (values * known * (tolerance + 0.5 - distance).clamp(0, 1)).sum(dim=(1, 2))
    return torch.stack([x, y], dim=1).view(b, k, 2), within.clamp(0, 1).view(b, k)


def variance(probability: torch.Tensor, xy: torch.Tensor) -> torch.Tensor:
    """(B, K), in places squared, along each axis, of points (B, K, 2): how much broader the probability (B, K, h, w) is
    around them than the Gaussian that the network is to give. What is far away counts as at `FAR`."""
    spread = 0.5 * (probability * distance2(xy, probability.shape[2:]).clamp(max=FAR**2)).sum(dim=(2, 3))
    return (spread - SIGMA**2).clamp_min(0) + LEAST_SIGMA**2


def targets(xy: torch.Tensor, size: tuple[int, int], sigma: float) -> torch.Tensor:
    """Gaussians (B, K, h, w) around points (B, K, 2) in places of the grid, each adding up to 1. A point that is NaN
    gives NaN, to be masked."""
    import torch  # pyright: ignore[reportMissingImports]

    h, w = size
    columns = torch.arange(w, dtype=torch.float32, device=xy.device)
    rows = torch.arange(h, dtype=torch.float32, device=xy.device)
    across = (-0.5 * ((columns - xy[..., :1]) / sigma) ** 2).softmax(dim=-1)
    down = (-0.5 * ((rows - xy[..., 1:]) / sigma) ** 2).softmax(dim=-1)
    return down[..., :, None] * across[..., None, :]


def loss(scores: torch.Tensor, xy: torch.Tensor, sigma: float, window: Window | None = None) -> torch.Tensor:
    """Mean cross-entropy over the points that are labelled: those of xy (B, K, 2), in places of the grid, that are not
    NaN; inside of the window, if there is one. 0 where there is none."""
    import torch  # pyright: ignore[reportMissingImports]

    labelled = torch.isfinite(xy).all(dim=2)
    known = torch.where(labelled[..., None], xy, torch.zeros_like(xy))
    aim = targets(known, (scores.shape[2], scores.shape[3]), sigma)
    scores = scores.float()
    if window is not None:
        mask = window.mask(scores.shape[2:])
        aim = aim * mask
        aim = aim / aim.sum(dim=(2, 3), keepdim=True).clamp_min(1e-6)
        scores = scores.masked_fill(~mask, NOWHERE)
    log = scores.flatten(2).log_softmax(dim=2)
    each = -(aim.flatten(2) * log).sum(dim=2)
    return (each * labelled).sum() / labelled.sum().clamp_min(1)
