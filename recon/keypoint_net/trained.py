"""A trained network with all that it takes to use it: saved in one file, and applied to pictures."""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.files import staged_file, write_bytes
from recon.base.records import check_unpacked_size
from recon.io.video import Image
from recon.keypoint_net.calibrate import LikelihoodCalibration
from recon.keypoint_net.decode import Window, decode, probabilities, variance
from recon.keypoint_net.labels import resize, scale_points
from recon.keypoint_net.model import STRIDE, build_network, build_stages, stages
from recon.keypoint_net.torch_extra import placed, require_torch

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

FORMAT = 1
MODEL_FILE = "model.pt"
CHANNELS = 6
"""Three colours, and their differences to the still background."""
GREY, SPREAD, DIFFERENCE = 115.0, 64.0, 64.0
"""Levels that become 0 and 1, and the difference that becomes 1."""
MARGIN_PX = 32
"""Around where the second stage looks, for it to see what is near."""
SURE = 0.05
"""Raw likelihood of points that the second stage's part of a picture has to hold."""
VIEWS = {"fast": (), "best": ("mirror", 0.8, 1.25)}
"""By quality, what is averaged with the picture as it is: its mirror picture, and both at other scales."""


@dataclass(frozen=True)
class Spec:
    """What belongs to a network's weights."""

    names: tuple[str, ...]
    """Of the keypoints."""
    scale: float
    """Of the network's pictures to those of the clip."""
    body_length_px: float
    """Of the animal in the labelled pictures, before scaling."""
    tolerance_px: float
    """Within which a point counts as right, for its likelihood; in the labelled pictures, before scaling."""
    partner: tuple[int, ...]
    """Of each keypoint in a mirror."""
    mirrored: bool
    """Whether training used it."""
    calibrations: dict[str, LikelihoodCalibration]
    """By quality."""
    first: float = 1.0
    """Of the pictures of the first stage to the network's; 1 where there is but one stage."""

    @property
    def two_stages(self) -> bool:
        return self.first < 1

    @property
    def tolerance_places(self) -> float:
        """In pictures of the first stage."""
        return self.tolerance_px * self.scale * self.first / STRIDE

    @property
    def reach_places(self) -> float:
        """How far from a point of the first stage the second one looks, in its own pictures: as far as the first one
        says that it is likely to be."""
        return self.tolerance_px * self.scale / STRIDE

    def likelihood(self, raw: Array, quality: str) -> Array:
        return self.calibrations.get(quality, LikelihoodCalibration()).apply(raw)


@dataclass(frozen=True, eq=False)
class _StagePoints:
    """What one stage sees in B pictures."""

    xy_px: Array
    """(B, K, 2)"""
    raw: Array
    """(B, K), raw likelihoods."""
    variance_px2: Array
    """(B, K), of the points along each axis."""


@dataclass(frozen=True, eq=False)
class Trained:
    spec: Spec
    network: torch.nn.Module
    device: torch.device

    def points(
        self, pictures: Sequence[Image], background: Image | None, quality: str = "fast", half: Any = None
    ) -> tuple[Array, Array]:
        """Points (B, K, 2) in pixels of the clip and raw likelihoods (B, K), of pictures of one size, scaled already.

        quality: one of `VIEWS`. half: a 16-bit type to compute in, or None.
        """
        first = self.spec.first
        if not self.spec.two_stages:
            found = self._found(0, np.stack(pictures), background, quality, half)
            return scale_points(found.xy_px, 1 / self.spec.scale), found.raw
        small = np.stack([resize(picture, first) for picture in pictures])
        found = self._found(0, small, None if background is None else resize(background, first), quality, half)
        begin = _StagePoints(scale_points(found.xy_px, 1 / first), found.raw, found.variance_px2 / first**2)
        return scale_points(self._refined(begin, pictures, background, quality, half), 1 / self.spec.scale), found.raw

    def _refined(
        self, begin: _StagePoints, pictures: Sequence[Image], background: Image | None, quality: str, half: Any
    ) -> Array:
        """Points (B, K, 2): the mean of what both stages see, weighted by how sure each is of it, in the part of each
        picture where most points are; others stay."""
        xy_px, raw = begin.xy_px, begin.raw
        low, size = part_of(xy_px, raw, STRIDE * self.spec.reach_places + MARGIN_PX, pictures[0].shape[1::-1])
        parts = [(slice(y, y + size[1]), slice(x, x + size[0])) for x, y in low]
        crops = np.stack([picture[part] for picture, part in zip(pictures, parts, strict=True)])
        still = None if background is None else np.stack([background[part] for part in parts])
        near = xy_px - low[:, None]
        found = self._found(1, crops, still, quality, half, near)
        inside = ((near >= 0) & (near <= np.array(size) - 1)).all(axis=2)
        weight = inside * begin.variance_px2 / (begin.variance_px2 + found.variance_px2)
        return xy_px + weight[..., None] * (found.xy_px - near)

    def _found(
        self, stage: int, pictures: NDArray[np.uint8], background: NDArray[np.uint8] | None, quality: str, half: Any,
        near_px: Array | None = None,
    ) -> _StagePoints:  # fmt: skip
        """In pixels of the pictures; near_px: where the second looks."""
        torch = require_torch()
        with torch.inference_mode():
            x = as_input(pictures, background, self.device)
            window = None
            if near_px is not None:
                window = Window(places(near_px, self.device), self.spec.reach_places)
            plain = found = self._probability(stage, x, half, window)
            views = VIEWS[quality]
            if views:
                found = self._averaged(stage, plain, x, views, half, window)
            xy, raw = decode(found, self.spec.tolerance_places)
            parts = (STRIDE * xy, raw, STRIDE**2 * variance(plain, xy))
        return _StagePoints(*(part.cpu().double().numpy() for part in parts))

    def _probability(self, stage: int, x: torch.Tensor, half: Any, window: Window | None) -> torch.Tensor:
        import torch  # pyright: ignore[reportMissingImports]

        with torch.autocast(x.device.type, half, enabled=half is not None):
            scores = stages(self.network)[stage](x)
        return probabilities(scores, window)

    def _averaged(
        self, stage: int, first: torch.Tensor, x: torch.Tensor, views: tuple[Any, ...], half: Any,
        window: Window | None,
    ) -> torch.Tensor:  # fmt: skip
        import torch  # pyright: ignore[reportMissingImports]

        functional = torch.nn.functional
        partner = list(self.spec.partner)
        height, width = x.shape[2:]
        mirror = "mirror" in views and self.spec.mirrored
        total, count = torch.zeros_like(first), 0
        for scale in (1.0, *(v for v in views if v != "mirror")):
            size = (round(height * scale), round(width * scale))
            view = x if scale == 1 else functional.interpolate(x, size=size, mode="bilinear", antialias=scale < 1)
            for mirrored in (False, True) if mirror else (False,):
                found = first
                if scale != 1 or mirrored:
                    # The mirror picture's places must be those of the picture: a width of whole strides and one pixel.
                    wide = -(-(view.shape[3] - 1) // STRIDE) * STRIDE + 1
                    padded = functional.pad(view, (0, wide - view.shape[3], 0, 0), mode="replicate")
                    seen = None if window is None else _in_view(window, scale, wide if mirrored else 0, partner)
                    found = self._probability(stage, padded.flip(3) if mirrored else padded, half, seen)
                    if mirrored:
                        found = found.flip(3)[:, partner]
                    found = _on_grid(found, first.shape[2:], (size[0] / height, size[1] / width))
                total, count = total + found, count + 1
        return total / count


def part_of(
    xy_px: Array, raw: Array, margin_px: float, size_px: Sequence[int]
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Of pictures of size_px, the part around the points (B, K, 2) that are likely enough: its first pixel in each
    (B, 2), and the size (width, height) of all."""
    sure = (raw >= np.minimum(SURE, raw.max(axis=1, keepdims=True)))[..., None]
    low = np.where(sure, xy_px, np.inf).min(axis=1) - margin_px
    high = np.where(sure, xy_px, -np.inf).max(axis=1) + margin_px
    sides = 32 * np.ceil((high - low).max(axis=0) / 32)
    width, height = (int(n) for n in np.minimum(sides, size_px))
    first = np.rint(0.5 * (low + high - [width, height])).astype(np.int64)
    return np.clip(first, 0, np.array(size_px) - [width, height]), (width, height)


def _in_view(window: Window, scale: float, mirror_px: int, partner: list[int]) -> Window:
    """A window in a picture at another scale, or in the mirror picture of one that is mirror_px wide (0: in none)."""
    near = ((window.near * STRIDE + 0.5) * scale - 0.5) / STRIDE
    if mirror_px:
        near = near[:, partner]
        near[..., 0] = (mirror_px - 1) / STRIDE - near[..., 0]
    return Window(near, window.reach * scale)


def _on_grid(found: torch.Tensor, shape: Sequence[int], scale: tuple[float, float]) -> torch.Tensor:
    """Probabilities (B, K, h, w) of a picture at another scale, on the grid of the first, again adding up to 1."""
    import torch  # pyright: ignore[reportMissingImports]

    h, w = found.shape[2:]
    if scale == (1.0, 1.0):
        return found[:, :, : shape[0], : shape[1]]
    ends = []
    for size, old, factor in zip(shape, (h, w), scale, strict=True):
        pixels = torch.arange(size, device=found.device) * STRIDE
        places = ((pixels + 0.5) * factor - 0.5) / STRIDE
        ends.append(2 * places / max(old - 1, 1) - 1)
    grid = torch.stack(torch.meshgrid(ends[1], ends[0], indexing="xy"), dim=-1)[None].expand(len(found), -1, -1, -1)
    moved = torch.nn.functional.grid_sample(found, grid, align_corners=True, padding_mode="zeros")
    return moved / moved.sum(dim=(2, 3), keepdim=True).clamp_min(1e-12)


def places(xy_px: Array, device: torch.device) -> torch.Tensor:
    """Of pixels, in the grid."""
    return require_torch().from_numpy((xy_px / STRIDE).astype(np.float32)).to(device)


def as_input(pictures: NDArray[np.uint8], background: Image | None, device: torch.device) -> torch.Tensor:
    """(B, 6, H, W): what the network sees of pictures (B, H, W, 3) with one background, or one for each."""
    torch = require_torch()
    x = torch.from_numpy(pictures).to(device)
    # Both parts at once, in place and channels last: this is half the time of making them one after the other.
    seen = torch.empty((*x.shape[:3], CHANNELS), device=device)
    seen[..., :3] = x
    if background is None:
        seen[..., 3:] = 0
        seen[..., :3].sub_(GREY)
    else:
        seen[..., 3:] = x
        still = torch.from_numpy(np.ascontiguousarray(background)).to(device).float()
        seen.sub_(torch.cat([torch.full_like(still, GREY), still], dim=-1))
    seen.div_(torch.tensor([SPREAD] * 3 + [DIFFERENCE] * 3, device=device))
    return seen.permute(0, 3, 1, 2)


def new_network(spec: Spec) -> torch.nn.Module:
    """With random weights."""
    return (build_stages if spec.two_stages else build_network)(len(spec.names), CHANNELS)


def save_model(spec: Spec, weights: dict[str, Any], path: Path) -> None:
    torch = require_torch()
    made = BytesIO()
    torch.save({"format": FORMAT, "spec": dataclasses.asdict(spec), "weights": weights}, made)
    with staged_file(path) as staged:
        write_bytes(staged, made.getvalue())


def model_file(folder: Path) -> Path:
    """Where the network of a folder is that `recon train` wrote. Raises InputError where there is none."""
    path = folder / MODEL_FILE if folder.is_dir() else folder
    if not path.is_file():
        expected = f"the {MODEL_FILE} of a folder that `recon train` wrote"
        raise InputError(Problem("--model", "file", f"{path}, no such file", expected))
    return path


def load_model(folder: Path, device: torch.device) -> Trained:
    """The network of such a folder, with its normalisation folded in. Raises InputError."""
    path = model_file(folder)
    require_torch()
    content = load_file(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(Problem(path, "model", "a file of another kind or version", "one that `recon train` wrote"))
    try:
        kept = content["spec"]
        calibrations = {
            quality: LikelihoodCalibration(**values) for quality, values in kept.pop("calibrations").items()
        }
        kept |= {name: tuple(kept[name]) for name in ("names", "partner")}
        spec = Spec(**kept, calibrations=calibrations)
        network = new_network(spec)
        network.load_state_dict(content["weights"])
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        found = f"a network with parts missing or altered ({' '.join(str(error).split())[:100]})"
        raise InputError(Problem(path, "model", found, "one as `recon train` wrote it")) from None
    return Trained(spec, prepared(network, device), device)


def load_file(path: Path) -> Any:
    """What torch saved: numbers and plain types only. Raises InputError for another kind of file, or a damaged one."""
    torch = require_torch()
    try:
        # torch writes a zip archive; what it makes of other and damaged files is almost any exception.
        with zipfile.ZipFile(path) as archive:
            check_unpacked_size(archive)
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        found = "a file that torch cannot read, of another kind or damaged"
        raise InputError(Problem(path, "model", found, "a file that `recon train` wrote")) from error


def prepared(network: Any, device: torch.device) -> torch.nn.Module:
    """A copy for use only: each normalisation goes into the convolution before it."""
    import copy

    torch = require_torch()
    from torch.nn.utils.fusion import fuse_conv_bn_eval  # pyright: ignore[reportMissingImports]

    network = copy.deepcopy(network).eval()
    for module in list(network.modules()):
        if isinstance(module, torch.nn.Sequential) and len(module) >= 2:
            first, second = module[0], module[1]
            if isinstance(first, torch.nn.Conv2d) and isinstance(second, torch.nn.BatchNorm2d):
                module[0], module[1] = fuse_conv_bn_eval(first, second), torch.nn.Identity()
    return placed(network, device)
