"""Prediction: the frames of a video in batches through a trained network, the next ones decoded meanwhile.

Pictures are held for a few batches only; what grows with the video are the points, 12 bytes each.
"""

from __future__ import annotations

import colorsys
from collections.abc import Generator
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from recon.base import Progress, silent
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.settings import Count, Option, Settings
from recon.clip.keypoints import Keypoints
from recon.io.video import Image, VideoInfo, probe, read_frames, video_writer
from recon.keypoint_net import network as net
from recon.keypoint_net.labels import resize
from recon.keypoint_net.pictures import ahead, background_of_video
from recon.show.overlay import Colour, draw_circle

LIKELY = 0.5
"""Points less likely than this are rings in the overlay."""
PIXELS = 2**20
"""The most pixels of a batch, at the network's scale."""
WAITING = 2
"""Batches that are decoded ahead."""
LOST_SHARE, LOST_FRAMES = 0.01, 3
"""So many frames fewer than the video states are its count's fault; more are the video's."""

_Chunk = tuple[list[int], list[Image], list[Image]]
"""Numbers of consecutive frames, their pictures at the network's scale, and as they are, if they are drawn on."""


class PredictSettings(Settings):
    """What `recon predict` finds, and where."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video, as in run.mp4."""
    model: Annotated[Path, Option(metavar="DIR")]
    """Folder of a trained network, as in models/run."""
    out: Path
    """The keypoint file, .csv or .h5, in DeepLabCut's layout."""
    overlay: Path | None = None
    """A new video with the points drawn, .mp4 (MPEG-4) or .avi (Motion JPEG)."""
    device: Annotated[str, net.DEVICE] = "auto"
    threads: Annotated[Count | None, net.THREADS] = None
    partial: bool = False
    """Accept a video of which fewer frames can be decoded than it states."""
    overwrite: bool = False
    """Replace files that are there."""


def predict_video(trained: net.TrainedNetwork, settings: PredictSettings, progress: Progress = silent) -> Keypoints:
    """Every frame's points as the network sees them, without smoothing, with calibrated likelihoods. Raises
    InputError."""
    video, spec = settings.video, trained.spec
    info = probe(video)
    progress("background", 0.0)
    background = background_of_video(video, spec.scale)
    half = net.fast_half(trained.device)
    net.use_threads(settings.threads)
    numbers: list[int] = []
    xy_px: list[NDArray[np.float32]] = []
    likelihood: list[NDArray[np.float32]] = []
    total = max(info.stated_frames or 0, 1)
    with ExitStack() as stack:
        write = None
        if settings.overlay is not None:
            even = (info.size_px[0] // 2 * 2, info.size_px[1] // 2 * 2)
            write = stack.enter_context(video_writer(settings.overlay, even, info.fps or 30.0))
        made = _chunks(video, info, spec.scale, keep=write is not None)
        for of_chunk, pictures, originals in stack.enter_context(closing(ahead(made, 1 + WAITING))):
            xy, raw = trained.points(pictures, background, half)
            sure = net.calibrated(raw, spec.calibration)
            numbers += of_chunk
            xy_px.append(xy.astype(np.float32))
            likelihood.append(sure.astype(np.float32))
            if write is not None:
                for picture, points, how in zip(originals, xy, sure, strict=True):
                    drawn = draw_points(picture, points, how)
                    write(drawn[: drawn.shape[0] // 2 * 2, : drawn.shape[1] // 2 * 2])
            progress(f"frame {numbers[-1]}", min(1.0, len(numbers) / total))
        _check_count(video, info, len(numbers), settings.partial)
    return Keypoints(
        spec.names,
        np.concatenate(xy_px).astype(float),
        np.concatenate(likelihood).astype(float),
        np.array(numbers, dtype=np.int64),
        fps=info.fps,
        image_size_px=info.size_px,
        source=str(video),
    )


def _chunks(video: Path, info: VideoInfo, scale: float, keep: bool) -> Generator[_Chunk]:
    """The frames of a video in batches. keep: the original pictures, too."""
    width, height = info.size_px
    size = int(np.clip(PIXELS / (width * height * scale**2), 1, 32))
    frames = read_frames(video)
    while some := list(islice(frames, size)):
        pictures = [resize(picture, scale) for _, picture in some]
        yield [number for number, _ in some], pictures, [picture for _, picture in some if keep]


def _check_count(video: Path, info: VideoInfo, decoded: int, partial: bool) -> None:
    stated = info.stated_frames or 0
    if partial or stated - decoded <= max(LOST_FRAMES, LOST_SHARE * stated):
        return
    expected = f"the {stated} that the file states; --partial takes what can be decoded"
    raise InputError(Problem(video, "frames", f"{decoded} that can be decoded", expected))


def colours(count: int) -> list[Colour]:
    """One for each keypoint, blue, green, red: evenly around the colour wheel, bright and dark by turns."""
    found = []
    for k in range(count):
        r, g, b = colorsys.hsv_to_rgb(k / max(count, 1), 0.85, 1.0 if k % 2 == 0 else 0.75)
        found.append((round(255 * b), round(255 * g), round(255 * r)))
    return found


def draw_points(picture: Image, xy_px: Array, likelihood: Array) -> Image:
    """A copy with dots at points (K, 2); those less likely than `LIKELY` are rings."""
    drawn = picture.copy()
    radius = max(2.0, max(picture.shape[:2]) / 160)
    for at, how, colour in zip(xy_px, likelihood, colours(len(xy_px)), strict=True):
        if np.isfinite(at).all():
            likely = how >= LIKELY
            if likely:
                draw_circle(drawn, at, radius + 1, (0, 0, 0), -1)
            draw_circle(drawn, at, radius if likely else 0.7 * radius, colour, -1 if likely else 1)
    return drawn
