"""Find the position and likelihood of each keypoint in pictures with a network, and run `recon predict`.

An encoder of residual blocks reduces the picture to 1/32 of its size, and a decoder enlarges the result to 1/4
(`STRIDE`). All layers are convolutions, so pictures may have any size. The network has about 2.7 million parameters for
any number of keypoints. If the animal is large in the pictures, there are two networks: one for the whole animal in
small pictures, and one for the part of the picture that contains the points, at full size.

A softmax over the grid turns a keypoint's scores into probabilities. The point is at the maximum of the probability
after a small blur (`BLUR` cells), so that a broad peak wins over a sharp peak with less total probability. Between
cells of the grid, the maximum is found by a parabola through the logarithm of the blurred probability at the peak and
its neighbours. The parabola is exact for a Gaussian, which is the shape that the network is trained on.
The raw likelihood is the probability within the tolerance of the point.

A network is overconfident in pictures that it was trained on. Therefore the likelihoods are calibrated on the
validation pictures. A logistic function of the raw likelihood's logit is fitted to whether points are correct, that is,
within the tolerance of their labels. About 80 % of the points with a calibrated likelihood of 0.8 should then be
correct.

The optional package torch is imported only in the functions that need it.

`recon predict` reads a video and writes a keypoint file. The frames go through the network in batches while the next
frames are decoded. Only a few batches of pictures are in memory at the same time.
"""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Generator, Sequence
from colorsys import hsv_to_rgb
from contextlib import ExitStack, closing
from dataclasses import dataclass
from io import BytesIO
from itertools import islice, pairwise
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import minimize
from scipy.special import expit, logit

from recon.base.arrays import Array, Bools
from recon.base.documents import check_unpacked_size, validated
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.files import staged_file, write_bytes
from recon.base.outputs import Output, output_file, require_suffix
from recon.base.package import install_command
from recon.base.parallel import available_cores
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.clip import Keypoints
from recon.io.formats import FORMATS
from recon.io.video import Image, VideoInfo, missing_note, probe, require_codec, timed_frames, video_writer
from recon.keypoint_net.labels import resize, scale_points
from recon.keypoint_net.pictures import background_of_video, prefetched
from recon.keypoint_net.settings import PredictSettings
from recon.show.overlay import Colour, draw_circle

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

FORMAT = 1
MODEL_FILE = "model.pt"

CHANNELS = 6
"""Number of input channels: three colours, and their differences from the static background."""
GREY = 115.0
"""Grey level, 0 to 255, that becomes 0 in the network's input."""
SPREAD = 64.0
"""Difference from `GREY`, in grey levels, that becomes 1 in the network's input."""
DIFFERENCE = 64.0
"""Difference from the background, in grey levels, that becomes 1 in the network's input."""
STRIDE = 4
"""Distance between neighbouring cells of the grid, pixels. Cell (0, 0) is at pixel (0, 0)."""
WIDTHS = (16, 32, 64, 128, 192)
"""Number of channels of the first stage at 1/2, 1/4, ... 1/32 of the picture's size."""
BLOCKS = (0, 1, 2, 2, 2)
"""Number of residual blocks of the first stage at 1/2, 1/4, ... 1/32 of the picture's size."""
SECOND_WIDTHS = (16, 32, 64, 96)
"""Number of channels of the second stage at 1/2, 1/4, ... 1/16 of the picture's size.

The second stage sees parts of a large animal at full size, and needs less context than the first.
"""
SECOND_BLOCKS = (0, 1, 2, 2)
"""Number of residual blocks of the second stage at 1/2, 1/4, ... 1/16 of the picture's size."""
HEAD = 48
"""Number of channels at 1/4 of the picture's size from which the scores are computed."""

SIGMA = 0.9
"""Standard deviation, in cells of the grid, of the Gaussian that the network is trained on."""
MIN_SIGMA = 0.15
"""Standard deviation of a point, in cells, if its probability is not broader than the Gaussian."""
BLUR = 0.8
"""Standard deviation of the blur of the probability, in cells of the grid."""
MAX_SPREAD_CELLS = 4.0
"""Maximum distance from a point, in cells, that `variance` uses in place of any larger distance."""
_REACH = 3
"""Number of cells on each side of a cell over which the blur extends."""
OUTSIDE_SCORE = -1e4
"""Score of the cells outside a keypoint's search window, low enough for a probability of 0."""
MARGIN_PX = 32
"""Margin around the search windows of the second stage, pixels, so that the network sees their surroundings."""
MIN_WINDOW_LIKELIHOOD = 0.05
"""Raw likelihood above which a point of the first stage must be inside the part that the second stage sees."""

_EDGE = 1e-4
"""Margin to which raw likelihoods are kept away from 0 and 1, so that their logits are finite."""
_PRIOR = np.array([1.0, 0.0])
"""Means of the prior on a calibration's slope and offset, which leave the likelihood unchanged."""
_PRIOR_SIGMA = np.array([0.5, 2.0])
"""Standard deviations of the prior on a calibration's slope and offset."""

DEVICES = ("auto", "cpu", "cuda", "mps")


def require_torch() -> ModuleType:
    """Import and return the `torch` package, or raise InputError with the command that installs it."""
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError:
        version, expected = "none", f"torch: {install_command('net')}"
        raise InputError(Problem("recon train, recon predict", "package for networks", version, expected)) from None
    return torch


def choose_device(name: str) -> torch.device:
    """Return the torch device with a given name, where "auto" means CUDA or MPS if available, else the CPU."""
    torch = require_torch()
    is_available = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if name == "auto":
        name = next(device for device in ("cuda", "mps", "cpu") if is_available[device])
    if not is_available.get(name):
        detail = f"'{name}'" if name not in DEVICES else f"{name}, which torch {torch.__version__} does not find here"
        expected = ", ".join(["one of: auto", *(device for device in is_available if is_available[device])])
        raise InputError(Problem("--device", "device", detail, expected))
    return torch.device(name)


def use_threads(count: int | None) -> None:
    """Set the number of CPU threads, by default as many as this process may use."""
    require_torch().set_num_threads(count or available_cores())


def fast_half(device: torch.device) -> torch.dtype | None:
    """Return bfloat16 if a device computes faster in bfloat16 than in float32, else None.

    float16 is not used, because gradients would underflow in its range without scaling.
    """
    torch = require_torch()
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    if device.type == "cpu":
        units = ("_is_amx_tile_supported", "_is_avx512_bf16_supported")
        has = (getattr(torch.cpu, unit, lambda: False)() for unit in units)
        return torch.bfloat16 if any(has) else None
    return None


def build_network(keypoints: int, widths: tuple[int, ...], blocks: tuple[int, ...]) -> torch.nn.Module:
    """Build one stage of a network with random weights.

    The network maps (B, CHANNELS, H, W) to scores (B, keypoints, ceil(H / 4), ceil(W / 4)).
    """
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
            nn.init.zeros_(self.second[1].weight)  # the block starts as the identity

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return functional.relu(x + self.second(self.first(x)))

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            ins = (CHANNELS, *widths[:-1])
            self.down = nn.ModuleList(
                nn.Sequential(conv(a, b, stride=2), *(Residual(b) for _ in range(n)))
                for a, b, n in zip(ins, widths, blocks, strict=True)
            )
            outs = (HEAD, *widths[2:])  # widths of the decoder from 1/4 to 1/32 of the size (the last is the encoder's)
            self.across = nn.ModuleList(nn.Conv2d(w, o, 1) for w, o in zip(widths[1:-1], outs[:-1], strict=True))
            self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(outs))
            self.mix = nn.ModuleList(conv(o, o) for o in outs[:-1])
            self.scores = nn.Conv2d(HEAD, keypoints, 1)
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


def new_network(keypoints: int, two_stages: bool) -> torch.nn.Module:
    """Build a network of one or two stages with random weights.

    A network of two stages is a `ModuleDict` of `first`, for the whole animal, and `second`, for parts of the animal.
    """
    first = build_network(keypoints, WIDTHS, BLOCKS)
    if not two_stages:
        return first
    second = build_network(keypoints, SECOND_WIDTHS, SECOND_BLOCKS)
    return require_torch().nn.ModuleDict({"first": first, "second": second})


def stages(network: torch.nn.Module) -> tuple[torch.nn.Module, ...]:
    """Return the one or two stages of a network made by `new_network`."""
    return tuple(network.children()) if isinstance(network, require_torch().nn.ModuleDict) else (network,)


def on_device(network: torch.nn.Module, device: torch.device) -> torch.nn.Module:
    """Move a network to a device, in the memory layout for fast convolutions."""
    return network.to(device).to(memory_format=require_torch().channels_last)  # pyright: ignore[reportCallIssue]


def as_input(pictures: NDArray[np.uint8], background: Image | None, device: torch.device) -> torch.Tensor:
    """Convert pictures (B, H, W, 3), with one background or one per picture, to the network's input (B, 6, H, W)."""
    torch = require_torch()
    x = torch.from_numpy(pictures).to(device).float()
    backgrounds = x if background is None else torch.from_numpy(np.ascontiguousarray(background)).to(device).float()
    return torch.cat([(x - GREY) / SPREAD, (x - backgrounds) / DIFFERENCE], dim=-1).permute(0, 3, 1, 2)


Window = tuple["torch.Tensor", float]
"""Region in which each keypoint is searched for, as centres (B, K, 2) and a radius, in cells of the grid."""


def _inside(window: Window, size: Sequence[int]) -> torch.Tensor:
    """Return a mask (B, K, h, w) of the cells inside the window of each keypoint; no cells if the centre is NaN."""
    return _distance2(window[0], size) <= window[1] ** 2


def _distance2(xy: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
    """Return the squared distance (B, K, h, w) of each cell from points (B, K, 2), in cells squared."""
    import torch  # pyright: ignore[reportMissingImports]

    rows, columns = (torch.arange(n, dtype=torch.float32, device=xy.device) for n in size)
    across, down = (columns - xy[..., :1]) ** 2, (rows - xy[..., 1:]) ** 2
    return down[..., :, None] + across[..., None, :]


def probabilities(scores: torch.Tensor, window: Window | None = None) -> torch.Tensor:
    """Convert scores to probabilities (B, K, h, w), float32, that add up to 1 over the grid of each keypoint."""
    scores = scores.float()
    if window is not None:
        scores = scores.masked_fill(~_inside(window, scores.shape[2:]), OUTSIDE_SCORE)
    return scores.flatten(2).softmax(dim=2).view(scores.shape)


def decode(probability: torch.Tensor, tolerance: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return points (B, K, 2), cells of the grid, and the probability (B, K) within `tolerance` cells of each point."""
    import torch  # pyright: ignore[reportMissingImports]

    b, k, h, w = probability.shape
    offsets = torch.arange(-_REACH, _REACH + 1, dtype=torch.float32, device=probability.device)
    kernel = torch.exp(-0.5 * (offsets / BLUR) ** 2)
    kernel = kernel / kernel.sum()
    across = kernel.view(1, 1, 1, -1).expand(k, 1, 1, -1).contiguous()
    down = kernel.view(1, 1, -1, 1).expand(k, 1, -1, 1).contiguous()
    blurred = torch.nn.functional.conv2d(probability, across, padding=(0, _REACH), groups=k)
    blurred = torch.nn.functional.conv2d(blurred, down, padding=(_REACH, 0), groups=k).reshape(b * k, h, w)
    peak = blurred.flatten(1).argmax(dim=1)
    row, column = peak // w, peak % w
    n = torch.arange(b * k, device=probability.device)

    def refined(along: torch.Tensor, size: int, values: list[torch.Tensor]) -> torch.Tensor:
        left, middle, right = (value.clamp_min(1e-30).log() for value in values)
        bend = left - 2 * middle + right
        shift = torch.where(bend < -1e-6, 0.5 * (left - right) / bend.clamp(max=-1e-6), torch.zeros_like(bend))
        inside = (along > 0) & (along < size - 1)
        return along + torch.where(inside, shift.clamp(-0.5, 0.5), torch.zeros_like(shift))

    x = refined(column, w, [blurred[n, row, (column + d).clamp(0, w - 1)] for d in (-1, 0, 1)])
    y = refined(row, h, [blurred[n, (row + d).clamp(0, h - 1), column] for d in (-1, 0, 1)])
    xy = torch.stack([x, y], dim=1).view(b, k, 2)
    # A cell at the edge of the tolerance circle counts in part.
    fraction = (tolerance + 0.5 - _distance2(xy, (h, w)).sqrt()).clamp(0, 1)
    return xy, (probability * fraction).sum(dim=(2, 3)).clamp(0, 1)


def variance(probability: torch.Tensor, xy: torch.Tensor) -> torch.Tensor:
    """Return the variance (B, K) of points (B, K, 2) along each axis, in cells squared.

    The variance of the probability (B, K, h, w) around each point is reduced by the variance of the Gaussian that the
    network is trained on. Distances beyond `MAX_SPREAD_CELLS` count as `MAX_SPREAD_CELLS`.
    """
    spread = 0.5 * (probability * _distance2(xy, probability.shape[2:]).clamp(max=MAX_SPREAD_CELLS**2)).sum(dim=(2, 3))
    return (spread - SIGMA**2).clamp_min(0) + MIN_SIGMA**2


def loss(scores: torch.Tensor, xy: torch.Tensor, window: Window | None = None) -> torch.Tensor:
    """Return the mean cross-entropy of scores (B, K, h, w) with a Gaussian around each labelled point.

    `xy` holds points (B, K, 2) in cells of the grid, NaN if not labelled. If a window is given, only the cells inside
    it count. The loss is 0 without labels.
    """
    import torch  # pyright: ignore[reportMissingImports]

    size = scores.shape[2:]
    labelled = torch.isfinite(xy).all(dim=2)
    points = torch.where(labelled[..., None], xy, torch.zeros_like(xy))
    aim = (-0.5 * _distance2(points, size) / SIGMA**2).flatten(2).softmax(dim=2)
    scores = scores.float()
    if window is not None:
        mask = _inside(window, size)
        aim = aim * mask.flatten(2)
        aim = aim / aim.sum(dim=2, keepdim=True).clamp_min(1e-6)
        scores = scores.masked_fill(~mask, OUTSIDE_SCORE)
    entropies = -(aim * scores.flatten(2).log_softmax(dim=2)).sum(dim=2)
    return (entropies * labelled).sum() / labelled.sum().clamp_min(1)


Calibration = tuple[float, float]
"""Slope and offset of a calibration, likelihood = expit(slope * logit(raw) + offset)."""


def calibrated(raw: Array, calibration: Calibration | None) -> Array:
    """Return calibrated likelihoods for raw likelihoods, which may be NaN."""
    if calibration is None:
        return np.clip(raw, 0.0, 1.0)
    slope, offset = calibration
    return expit(slope * logit(np.clip(raw, _EDGE, 1 - _EDGE)) + offset)


def fit_calibration(raw: Array, right: Bools) -> Calibration | None:
    """Fit the calibration to raw likelihoods (N,) and a mask (N,) of correct points, or return None without points.

    The fit is by maximum likelihood with a weak prior on slope and offset, which keeps both finite if all points are
    correct.
    """
    if not len(raw):
        return None
    x, y = logit(np.clip(raw, _EDGE, 1 - _EDGE)), right.astype(float)

    def cost(p: Array) -> tuple[float, Array]:
        z, deviation = p[0] * x + p[1], (p - _PRIOR) / _PRIOR_SIGMA
        slack = expit(z) - y
        value = float((np.logaddexp(0, z) - y * z).sum() + 0.5 * (deviation**2).sum())
        return value, np.array([(slack * x).sum(), slack.sum()]) + deviation / _PRIOR_SIGMA

    minimum = minimize(cost, _PRIOR, jac=True, method="L-BFGS-B", bounds=[(0.05, 5.0), (-10.0, 10.0)])
    return float(minimum.x[0]), float(minimum.x[1])


_Pixels = Annotated[float, Field(gt=0, lt=1e6)]


@dataclass(frozen=True)
class Spec:
    """Description of a trained network, stored with the network's weights."""

    names: Annotated[tuple[str, ...], Field(min_length=1, max_length=1000)]
    """Names of the keypoints."""
    scale: Annotated[float, Field(gt=1e-3, lt=1e3)]
    """Scale of the network's pictures relative to the clip's pictures."""
    body_length_px: _Pixels
    """Length of the animal in the labelled pictures before scaling, pixels."""
    tolerance_px: _Pixels
    """Largest distance of a correct point from its label in the labelled pictures before scaling, pixels."""
    first: Annotated[float, Field(gt=1e-3, le=1)] = 1.0
    """Scale of the first stage's pictures relative to the network's pictures; 1 if there is only one stage."""
    calibration: Calibration | None = None

    @property
    def two_stages(self) -> bool:
        """Return whether a second stage refines the points in parts of the picture."""
        return self.first < 1

    @property
    def reach_cells(self) -> float:
        """Return the radius, in cells, of the second stage's search window around a point of the first stage.

        The radius is the largest error that the first stage is expected to make.
        """
        return self.tolerance_px * self.scale / STRIDE


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """Network with its weights, ready to find points in pictures."""

    spec: Spec
    network: torch.nn.Module
    device: torch.device
    half: Any = None
    """16-bit floating-point type to compute in, or None for float32."""

    def points(self, pictures: Sequence[Image], background: Image | None) -> tuple[Array, Array]:
        """Return points (B, K, 2) in pixels of the clip and raw likelihoods (B, K).

        All pictures have the same size, at the network's scale.
        """
        first = self.spec.first
        small = np.stack([resize(picture, first) for picture in pictures])
        small_background = None if background is None else resize(background, first)
        xy_px, raw, variance_px2 = self._stage_points(0, small, small_background)
        if self.spec.two_stages:
            begin = scale_points(xy_px, 1 / first), raw, variance_px2 / first**2
            xy_px = self._refined(*begin, pictures, background)
        return scale_points(xy_px, 1 / self.spec.scale), raw

    def _refined(
        self, xy_px: Array, raw: Array, variance_px2: Array, pictures: Sequence[Image], background: Image | None
    ) -> Array:
        """Refine the points (B, K, 2) of the first stage by the second stage, weighting both by their variances.

        The second stage sees the part of each picture that contains the likely points. The points of the first
        stage outside this part are kept.
        """
        low, size = part_of(xy_px, raw, STRIDE * self.spec.reach_cells + MARGIN_PX, pictures[0].shape[1::-1])
        parts = [(slice(y, y + size[1]), slice(x, x + size[0])) for x, y in low]
        crops = np.stack([picture[part] for picture, part in zip(pictures, parts, strict=True)])
        backgrounds = None if background is None else np.stack([background[part] for part in parts])
        near_px = xy_px - low[:, None]
        found_px, _, found_px2 = self._stage_points(1, crops, backgrounds, near_px)
        inside = ((near_px >= 0) & (near_px <= np.array(size) - 1)).all(axis=2)
        weight = inside * variance_px2 / (variance_px2 + found_px2)
        return xy_px + weight[..., None] * (found_px - near_px)

    def _stage_points(
        self, stage: int, pictures: Image, background: Image | None, near_px: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return points (B, K, 2) in px, raw likelihoods (B, K), and variances (B, K) in px^2.

        The variance of a point is the same along both axes. `near_px` holds the centres (B, K, 2) of the second
        stage's windows.
        """
        torch = require_torch()
        spec = self.spec
        with torch.inference_mode():
            x = as_input(pictures, background, self.device)
            window = None if near_px is None else (to_cells(near_px, self.device), spec.reach_cells)
            with torch.autocast(x.device.type, self.half, enabled=self.half is not None):
                scores = stages(self.network)[stage](x)
            probability = probabilities(scores, window)
            xy, raw = decode(probability, spec.reach_cells * spec.first)
            parts = (STRIDE * xy, raw, STRIDE**2 * variance(probability, xy))
        xy_px, raw, variance_px2 = (part.cpu().double().numpy() for part in parts)
        return xy_px, raw, variance_px2


def part_of(
    xy_px: Array, raw: Array, margin_px: float, size_px: Sequence[int]
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return a part of each picture that contains the picture's likely points among points (B, K, 2).

    The result is the first pixel of the part in each picture, (B, 2), and the size (width, height) of the part, px,
    which is the same in all pictures.
    """
    sure = (raw >= np.minimum(MIN_WINDOW_LIKELIHOOD, raw.max(axis=1, keepdims=True)))[..., None]
    low = np.where(sure, xy_px, np.inf).min(axis=1) - margin_px
    high = np.where(sure, xy_px, -np.inf).max(axis=1) + margin_px
    sides = 32 * np.ceil((high - low).max(axis=0) / 32)
    width, height = (int(n) for n in np.minimum(sides, size_px))
    first = np.rint(0.5 * (low + high - [width, height])).astype(np.int64)
    return np.clip(first, 0, np.array(size_px) - [width, height]), (width, height)


def to_cells(xy_px: Array, device: torch.device) -> torch.Tensor:
    """Convert points (..., 2) from pixels of a stage's picture to cells of its grid."""
    return require_torch().from_numpy((xy_px / STRIDE).astype(np.float32)).to(device)


def save_torch(content: dict[str, Any], path: Path) -> None:
    """Write a torch file atomically, so that no incomplete file is left."""
    buffer = BytesIO()
    require_torch().save(content, buffer)
    with staged_file(path) as staged:
        write_bytes(staged, buffer.getvalue())


def model_file(folder: Path) -> Path:
    """Return the path of a folder's network file, or raise InputError if there is none."""
    path = folder / MODEL_FILE if folder.is_dir() else folder
    if not path.is_file():
        expected = f"the {MODEL_FILE} of a folder written by `recon train`"
        raise InputError(Problem("--model", "file", f"no file {path}", expected))
    return path


def load_model(folder: Path, device: torch.device) -> TrainedNetwork:
    """Load the network that `recon train` wrote into a folder, or raise InputError if its file cannot be used."""
    path = model_file(folder)
    content = load_torch(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(Problem(path, "model", "a file of another kind or version", "a file written by `recon train`"))
    try:
        spec_table = content["spec"]
        if calibration_02 := spec_table.get("calibrations", {}).get("fast"):  # format of version 0.2
            spec_table["calibration"] = calibration_02["slope"], calibration_02["offset"]
        names = [field.name for field in dataclasses.fields(Spec)]
        spec = validated(Spec, {name: spec_table[name] for name in names if name in spec_table}, path)
        network = new_network(len(spec.names), spec.two_stages)
        network.load_state_dict(content["weights"])
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        damage = f"missing or altered parts ({' '.join(str(error).split())[:100]})"
        raise InputError(Problem(path, "model", damage, "an unchanged file of `recon train`")) from None
    return TrainedNetwork(spec, on_device(network, device).eval(), device, fast_half(device))


MAX_PICKLE_BYTES = 1 << 22
"""Maximum size in bytes of the part of a torch file that is unpickled, which contains names and sizes."""


def load_torch(path: Path) -> dict[str, Any]:
    """Load numbers and plain types from a torch file, or raise InputError if the file is damaged or of another kind."""
    torch = require_torch()
    try:
        # torch writes zip archives, and raises almost any exception for other or damaged files.
        with zipfile.ZipFile(path) as archive:
            check_unpacked_size(archive)
            if any(info.file_size > MAX_PICKLE_BYTES for info in archive.infolist() if info.filename.endswith(".pkl")):
                raise ValueError("more than names and sizes")  # torch would take long to unpickle more
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        damage = "a file that torch cannot read, because it is damaged or of another kind"
        raise InputError(Problem(path, "model", damage, "a file written by `recon train`")) from error


WRITERS = {f.suffixes[0]: f.write for f in FORMATS if f.name == "deeplabcut"}


RING_LIKELIHOOD = 0.5
"""Likelihood below which points are drawn as rings in the overlay video."""
MAX_BATCH_PIXELS = 2**20
"""Maximum number of pixels in a batch, at the network's scale."""
BATCHES_AHEAD = 2
"""Number of batches of video frames to decode ahead of the network."""
MAX_LOST_FRACTION = 0.01
"""Largest fraction of a video's stated frames that may be missing before the video counts as damaged.

If fewer are missing, the number in the header counts as wrong.
"""
LOST_FRAMES = 3
"""Number of stated frames that may be missing, however short the video is."""

_Chunk = tuple[list[int], list[float], list[Image], list[Image]]
"""Numbers of consecutive frames, their time stamps (s), their pictures at the network's scale, and the original
pictures if points are drawn on them.
"""


def run_prediction(
    video: Path, model: Path, out: Path, *, progress: Progress = silent, output: Output | None = None, **options: Any
) -> Keypoints:
    """Run `recon predict`, which writes a keypoint file in DeepLabCut's layout, and return the keypoints.

    `options` are the other fields of `PredictSettings`.

    Raises
    ------
    InputError
        If the input is invalid, before anything is written, or if too many frames cannot be decoded, after the
        prediction.
    """
    s = PredictSettings(video=video, model=model, out=out, **options)
    output = output or output_file(out, "predict", s.overwrite, input_paths(s))
    _, device, *_ = collect_problems(
        lambda: model_file(model),
        lambda: choose_device(s.device),
        lambda: require_suffix(out, WRITERS),
        lambda: output.require((out.name,)),
        lambda: None if s.overlay is None else require_codec(s.overlay),
        lambda: None if s.overlay is None else _overlay_output(s, s.overlay).require((s.overlay.name,)),
    )
    keypoints = predict_video(load_model(model, device), s, progress)
    with output.staged(adds=True) as folder:
        WRITERS[out.suffix.lower()](keypoints, folder / out.name)
    return keypoints


def _overlay_output(s: PredictSettings, overlay: Path) -> Output:
    return output_file(overlay, "predict", s.overwrite, input_paths(s), option="--overlay")


def predict_video(trained: TrainedNetwork, settings: PredictSettings, progress: Progress = silent) -> Keypoints:
    """Find the keypoints in every frame of a video, without smoothing, with calibrated likelihoods.

    Raises
    ------
    InputError
        If too many frames cannot be decoded.
    """
    video, spec = settings.video, trained.spec
    info = probe(video)
    progress("background", 0.0)
    background = background_of_video(video, spec.scale)
    use_threads(settings.threads)
    results: list[tuple[list[int], list[float], NDArray[np.float32], NDArray[np.float32]]] = []
    total, count = max(info.stated_frames or 0, 1), 0
    with ExitStack() as stack:
        write = None
        if settings.overlay is not None:
            even_size = (info.size_px[0] // 2 * 2, info.size_px[1] // 2 * 2)
            staged = stack.enter_context(_overlay_output(settings, settings.overlay).staged_file())
            write = stack.enter_context(video_writer(staged, even_size, info.fps or 30.0))
        chunks = _chunks(video, info, spec.scale, keep=write is not None)
        for of_chunk, stamps_s, pictures, originals in stack.enter_context(
            closing(prefetched(chunks, 1 + BATCHES_AHEAD))
        ):
            xy, raw = trained.points(pictures, background)
            sure = calibrated(raw, spec.calibration)
            results.append((of_chunk, stamps_s, xy.astype(np.float32), sure.astype(np.float32)))
            count += len(of_chunk)
            if write is not None:
                for picture, points, likelihoods in zip(originals, xy, sure, strict=True):
                    drawn = draw_points(picture, points, likelihoods)
                    write(drawn[: drawn.shape[0] // 2 * 2, : drawn.shape[1] // 2 * 2])
            progress(f"frame {of_chunk[-1]}", min(1.0, count / total))
        lost = (stated := info.stated_frames or 0) - count
        if not settings.partial and lost > max(LOST_FRAMES, MAX_LOST_FRACTION * stated):
            expected = f"{stated} frames, as the file states; --partial accepts fewer frames"
            raise InputError(Problem(video, "frames", f"{count} decodable frames", expected))
    numbers, times_s, xy_px, likelihood = (np.concatenate(column) for column in zip(*results, strict=True))
    note = missing_note(video, times_s)
    properties: dict[str, Any] = {"fps": info.fps, "image_size_px": info.size_px, "source": str(video)}
    properties["notes"] = () if note is None else (note,)
    return Keypoints(spec.names, xy_px.astype(float), likelihood.astype(float), numbers, **properties)


def _chunks(video: Path, info: VideoInfo, scale: float, keep: bool) -> Generator[_Chunk]:
    """Yield the frames of a video in batches, with the original pictures if `keep` is true."""
    width, height = info.size_px
    size = int(np.clip(MAX_BATCH_PIXELS / (width * height * scale**2), 1, 32))
    frames = timed_frames(video)
    while chunk := list(islice(frames, size)):
        numbers, times_s, pictures = (list(column) for column in zip(*chunk, strict=True))
        yield numbers, times_s, [resize(picture, scale) for picture in pictures], pictures if keep else []


def draw_points(picture: Image, xy_px: Array, likelihood: Array) -> Image:
    """Return a copy of a picture with a dot at each point (K, 2), or a ring below `RING_LIKELIHOOD`."""
    drawn = picture.copy()
    radius = max(2.0, max(picture.shape[:2]) / 160)
    for point, point_likelihood, colour in zip(xy_px, likelihood, point_colours(len(xy_px)), strict=True):
        if np.isfinite(point).all():
            likely = point_likelihood >= RING_LIKELIHOOD
            if likely:
                draw_circle(drawn, point, radius + 1, (0, 0, 0), -1)
            draw_circle(drawn, point, radius if likely else 0.7 * radius, colour, -1 if likely else 1)
    return drawn


def point_colours(count: int) -> list[Colour]:
    """Return a colour (blue, green, red) for each keypoint.

    Hues are evenly spaced around the colour wheel, and bright and dark colours alternate.
    """
    colours = (hsv_to_rgb(k / count, 0.85, 0.75 if k % 2 else 1.0) for k in range(count))
    return [(round(255 * blue), round(255 * green), round(255 * red)) for red, green, blue in colours]
