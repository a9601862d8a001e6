"""Make batches of training pictures in a thread while the network learns from earlier batches.

New pictures are made from the labelled ones by rotating, scaling, moving and mirroring them, pasting the animal
elsewhere, changing the light, blurring, covering parts, and adding noise. Each picture depends only on its random
generator, which is seeded by the run's seed and the picture's number. A run that is resumed therefore uses the same
pictures.

The static background of a clip is what a camera on a tripod sees without moving objects. The network's input is a
picture and its difference from this background, which shows what has moved, in any scene and light. Training also
pastes the animal onto other parts of the background. If the camera moves, or if there are too few pictures, there is no
background, and the difference is 0.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from recon.base.arrays import Array, Integers
from recon.io.video import Image, probe, read_frames
from recon.keypoint_net.labels import Labels, body_length_px, known_points, resize, scaled_size

NETWORK_LENGTH_PX = 120.0
"""Length of the animal in the network's pictures, pixels.

Clips are scaled to this length unless their animal is about as long.
"""
FULL_LENGTH_PX = 480.0
"""Largest length of the animal in the pictures of a second stage, pixels.

Labels are not precise enough for larger pictures to help.
"""
TWO_STAGES = 1.5
"""Length of an animal, relative to NETWORK_LENGTH_PX, above which the network works in two stages.

The first stage locates the animal in small pictures. The second stage refines the points at full size.
"""
PART_PX = (128, 128)
"""Width and height of the second stage's training pictures, pixels."""
MAX_WINDOW_ERROR = 0.75
"""Largest simulated error of the first stage in training, as a fraction of the radius of the second stage's window."""
CROP = 1.4
"""Width and height of training pictures, relative to the animal's length."""
MARGIN = 0.12
"""Margin around the animal's labelled points, relative to the animal's length."""
NO_BACKGROUND = 0.2
"""Fraction of the training pictures without the difference from the background."""
BATCHES_AHEAD = 3
"""Number of batches that the thread makes in advance."""

MIN_PICTURES = 8
"""Minimum number of pictures required to compute a background."""
MAX_PICTURES = 60
"""Maximum number of pictures from which a background is computed."""
MAX_BYTES = 2**28
"""Maximum memory for a video's pictures, bytes."""
STILL_LEVELS = 12.0
"""Largest difference of a still pixel from the background, in grey levels."""
MIN_STILL_FRACTION = 0.6
"""Fraction of still pixels in a picture above which the camera counts as static."""
MOVED_LEVELS = 22.0
"""Difference from the background, in grey levels of any colour, above which a pixel belongs to the animal."""


@dataclass(frozen=True)
class Augmentation:
    """Ranges of random changes to a picture.

    Rotations are normally distributed, with a standard deviation of half the largest rotation. All other values are
    drawn uniformly, factors on a logarithmic scale.
    """

    rotation_deg: float = 20.0
    """Largest rotation to either side, degrees."""
    scale: tuple[float, float] = (0.6, 1.6)
    """Smallest and largest factor by which the size changes."""
    stretch: float = 0.12
    """Largest logarithm of the factor by which the width grows and the height shrinks, or the other way round."""
    partner: tuple[int, ...] | None = None
    """Index of each keypoint's counterpart on the other side; None if pictures are not mirrored."""
    paste: float = 0.5
    """Probability of pasting the animal onto another part of the background."""
    contrast: float = 0.3
    """Largest logarithm of the factor by which the contrast changes."""
    brightness: float = 25.0
    """Largest change of the brightness, on a scale from 0 to 255."""
    gamma: float = 0.3
    """Largest logarithm of the exponent (gamma) that is applied to the brightness of every pixel."""
    colour: float = 0.12
    """Largest logarithm of the factor by which each colour changes."""
    light_patch: float = 0.3
    """Probability that a part of the picture gets different lighting."""
    cutout: float = 0.5
    """Probability that rectangles cover parts of the animal."""
    blur: float = 0.25
    """Probability of motion blur."""
    noise: float = 6.0
    """Largest standard deviation of the noise in the brightness, on a scale from 0 to 255."""


@dataclass(frozen=True, eq=False)
class Example:
    """Labelled picture of h by w pixels with K keypoints, from which training pictures are made."""

    picture: Image
    """The picture, shape (h, w, 3)."""
    background: Image | None
    """Median picture of the clip, shape (h, w, 3); None if the camera moves."""
    mask: Image | None
    """Mask of the animal's pixels, 0 to 255, shape (h, w); None if the camera moves."""
    xy_px: Array
    """Labelled points, pixels, NaN where missing, shape (K, 2)."""
    length_px: float
    """Length of the animal in pixels."""
    part: bool = False
    """Whether training pictures show the surroundings of one point instead of the whole animal."""


def augment(
    example: Example, size_px: tuple[int, int], options: Augmentation, rng: np.random.Generator
) -> tuple[Image, Image | None, Array]:
    """Make a training picture of `size_px` (width, height), and return it with its background and points (K, 2).

    Points, px, are NaN if they are outside the picture.
    """
    partner = options.partner if options.partner is not None and rng.random() < 0.5 else None
    transform = _affine(example, size_px, options, partner is not None, rng)
    picture = _warp(example.picture, transform, size_px)
    background = None
    if example.background is not None:
        background = _warp(example.background, transform, size_px)
        if example.mask is not None and rng.random() < options.paste:
            mask = _warp(example.mask, transform, size_px, constant=True)[..., None].astype(np.float32) / 255
            background = _other_background(example.background, size_px, rng)
            picture = (picture * mask + background * (1 - mask)).astype(np.uint8)
    xy_px = example.xy_px @ transform[:, :2].T + transform[:, 2]
    if partner is not None:
        xy_px = xy_px[list(partner)]
    outside = np.any((xy_px < 0) | (xy_px > np.array(size_px) - 1.0), axis=1, keepdims=True)
    xy_px = np.where(outside, np.nan, xy_px)
    light = _random_light(size_px, options, rng)
    picture = _in_light(picture, light)
    if background is not None:
        background = _in_light(background, light)
    picture = _partly_covered(picture, background, example.length_px, options, rng)
    if rng.random() < options.blur:
        picture = motion_blur(picture, rng.uniform(1.5, 0.06 * example.length_px + 2), rng.uniform(0, math.pi))
    sigma = rng.uniform(0, options.noise)
    grain = rng.standard_normal((*picture.shape[:2], 1), np.float32) * np.float32(sigma)
    return np.clip(picture + grain, 0, 255).astype(np.uint8), background, xy_px


def motion_blur(picture: Image, length_px: float, angle_rad: float) -> Image:
    """Return a picture blurred as if by uniform motion along a line during the exposure."""
    half = max(1, math.ceil(length_px / 2))
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for t in np.linspace(-0.5, 0.5, 8 * half + 1):
        x, y = half + t * length_px * math.cos(angle_rad), half + t * length_px * math.sin(angle_rad)
        x0, y0 = min(int(x), 2 * half - 1), min(int(y), 2 * half - 1)
        for dy, wy in ((0, 1 - (y - y0)), (1, y - y0)):
            for dx, wx in ((0, 1 - (x - x0)), (1, x - x0)):
                kernel[y0 + dy, x0 + dx] += wx * wy
    return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE), np.uint8)


def _affine(
    example: Example, size_px: tuple[int, int], options: Augmentation, mirrored: bool, rng: np.random.Generator
) -> Array:
    """Return a random affine map (2, 3) that moves the animal's middle, or one of its points, to a random pixel."""
    points = example.xy_px[known_points(example.xy_px)]
    height, width = example.picture.shape[:2]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0)) if len(points) else rng.uniform(0, [width, height])
    if example.part and len(points):
        centre = points[rng.integers(len(points))]
    scale = math.exp(rng.uniform(*np.log(options.scale)))
    stretch = math.exp(rng.uniform(-options.stretch, options.stretch))
    turn = math.radians(rng.normal(0, options.rotation_deg / 2))
    turn = float(np.clip(turn, *np.radians([-options.rotation_deg, options.rotation_deg])))
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    linear = rotation @ np.diag([scale * stretch * (-1 if mirrored else 1), scale / stretch])
    target = rng.uniform([0.2, 0.25], [0.8, 0.75]) * size_px
    return np.column_stack([linear, target - linear @ centre])


def _warp(picture: Image, transform: Array, size_px: tuple[int, int], constant: bool = False) -> Image:
    border = cv2.BORDER_CONSTANT if constant else cv2.BORDER_REFLECT_101
    small = abs(np.linalg.det(transform[:, :2])) < 0.5
    flags = cv2.INTER_AREA if small else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(picture, transform, size_px, flags=flags, borderMode=border), np.uint8)


def _other_background(background: Image, size_px: tuple[int, int], rng: np.random.Generator) -> Image:
    """Scale a random part of the clip's background to `size_px`, and mirror it at random."""
    height, width = background.shape[:2]
    scale = math.exp(rng.uniform(-0.4, 0.5)) * max(1.0, 0.7 * size_px[0] / width, 0.7 * size_px[1] / height)
    mirror = -1.0 if rng.random() < 0.5 else 1.0
    linear = np.diag([scale * mirror, scale])
    target = 0.5 * np.array(size_px) - linear @ rng.uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height])
    return _warp(background, np.column_stack([linear, target]), size_px)


def _random_light(
    size_px: tuple[int, int], options: Augmentation, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
    """Return a table (256, 3) of new values for each colour, and a factor (H, W, 1) if a patch is lit differently."""
    levels = np.arange(256)[:, None] / 255.0
    gamma = math.exp(rng.uniform(-options.gamma, options.gamma))
    contrast = math.exp(rng.uniform(-options.contrast, options.contrast))
    colour = np.exp(rng.uniform(-options.colour, options.colour, 3))
    pivot = rng.uniform(0.2, 0.6)
    table = 255 * ((levels**gamma - pivot) * contrast + pivot) * colour
    table = table + rng.uniform(-options.brightness, options.brightness)
    table = np.clip(table, 0, 255).astype(np.uint8)
    if rng.random() >= options.light_patch:
        return table, None
    x, y = np.meshgrid(np.arange(size_px[0]), np.arange(size_px[1]))
    angle, centre = rng.uniform(0, 2 * math.pi), rng.uniform(0.2, 0.8, 2) * size_px
    across = (x - centre[0]) * math.cos(angle) + (y - centre[1]) * math.sin(angle)
    soft = 1 / (1 + np.exp(-np.clip(across / rng.uniform(2, 30), -30, 30)))
    factor = 1 + (math.exp(rng.uniform(-0.7, 0.5)) - 1) * soft
    return table, factor[..., None].astype(np.float32)


def _in_light(picture: Image, light: tuple[NDArray[np.uint8], NDArray[np.float32] | None]) -> Image:
    table, factor = light
    lit = cv2.LUT(picture, table[None])
    return np.asarray(lit if factor is None else np.clip(lit * factor, 0, 255), np.uint8)


def _partly_covered(
    picture: Image, background: Image | None, length_px: float, options: Augmentation, rng: np.random.Generator
) -> Image:
    """Return a picture with up to three rectangles over the animal, of one colour or cut from the background."""
    if rng.random() >= options.cutout:
        return picture
    picture = picture.copy()
    height, width = picture.shape[:2]
    for _ in range(rng.integers(1, 4)):
        w, h = np.maximum(rng.uniform(0.05, 0.25, 2) * length_px, 2).astype(int)
        x, y = rng.integers(0, max(1, width - w)), rng.integers(0, max(1, height - h))
        if background is not None and rng.random() < 0.5:
            picture[y : y + h, x : x + w] = background[y : y + h, x : x + w]
        else:
            picture[y : y + h, x : x + w] = rng.integers(0, 256, 3)
    return picture


def background_of(pictures: Sequence[Image]) -> Image | None:
    """Return the median of one clip's pictures, or None if there are too few pictures or if the camera moves."""
    if len(pictures) < MIN_PICTURES:
        return None
    picked = [pictures[i] for i in np.unique(np.linspace(0, len(pictures) - 1, MAX_PICTURES).round().astype(int))]
    background = np.empty_like(picked[0])
    for rows in np.array_split(np.arange(len(background)), max(1, background.size * len(picked) // 2**24)):
        background[rows] = np.median(np.stack([p[rows] for p in picked]), axis=0).astype(np.uint8)
    still_shares = [float((cv2.absdiff(p, background).max(axis=2) < STILL_LEVELS).mean()) for p in picked]
    return background if float(np.median(still_shares)) >= MIN_STILL_FRACTION else None


def backgrounds(labels: Labels, left_out: Integers) -> tuple[Image | None, ...]:
    """Return a background for each clip, from its pictures except those in `left_out` (indices)."""
    medians = []
    for c in range(len(labels.clips)):
        of_clip = np.flatnonzero(labels.clip == c)
        usable = np.setdiff1d(of_clip, left_out)
        medians.append(background_of([labels.pictures[i] for i in (usable if len(usable) else of_clip)]))
    return tuple(medians)


def background_of_video(video: Path, scale: float) -> Image | None:
    """Return the background of a video at the network's scale, or None if the camera moves."""
    info = probe(video)
    width, height = scaled_size(info.size_px, scale)
    count = int(np.clip(MAX_BYTES // (3 * width * height), MIN_PICTURES, MAX_PICTURES))
    step = max(1, (info.stated_frames or MAX_PICTURES) // count)
    pictures = [resize(picture, scale) for _, picture in read_frames(video, 0, step * count, step)]
    return background_of(pictures)


def moving_mask(picture: Image, background: Image, xy_px: Array, margin_px: float) -> Image:
    """Return a mask (height, width), 0 to 255, of the pixels near points (K, 2) that differ from the background."""
    region = np.zeros(picture.shape[:2], np.uint8)
    points = xy_px[known_points(xy_px)]
    if len(points):
        hull = cv2.convexHull(points.astype(np.float32)).round().astype(np.int32)
        cv2.fillConvexPoly(region, hull, 255)
        size = 2 * round(margin_px) + 1
        region = cv2.dilate(region, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    moved = (cv2.absdiff(picture, background).max(axis=2) > MOVED_LEVELS).astype(np.uint8) * 255
    moved = cv2.bitwise_and(cv2.morphologyEx(moved, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)), region)
    # Fill holes where the animal looks like the background. The space between the legs stays empty, because the space
    # is open to the ground.
    gap = 2 * max(1, round(0.25 * margin_px)) + 1
    moved = cv2.morphologyEx(moved, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap)))
    outlines, _ = cv2.findContours(moved, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(moved, outlines, -1, 255, cv2.FILLED)
    moved = cv2.dilate(moved, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.GaussianBlur(moved, (3, 3), 0), np.uint8)


T = TypeVar("T")


def prefetched(items: Generator[T], count: int) -> Generator[T]:
    """Yield the items of a generator that runs in a thread, up to `count` items ahead. No item may be None."""
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="ahead") as executor:
        waiting = deque(executor.submit(next, items, None) for _ in range(count))
        try:
            while (item := waiting.popleft().result()) is not None:
                waiting.append(executor.submit(next, items, None))
                yield item
        finally:
            executor.shutdown(wait=True, cancel_futures=True)
            items.close()


Batch = tuple[NDArray[np.uint8], NDArray[np.uint8], Array, Array | None]
"""Pictures (B, H, W, 3); backgrounds (B, H, W, 3), or the pictures themselves for a difference of 0; points (B, K, 2),
NaN if not labelled or outside; and centres (B, K, 2) of the second stage's windows, None for the first stage.
"""


def network_scales(xy_px: Array) -> tuple[float, float]:
    """Return the scale of the network's last stage, and the scale of the first stage relative to the last.

    The second value is 1 if there is only one stage. `xy_px` holds labels (N, K, 2).
    """
    length = body_length_px(xy_px)
    scale = NETWORK_LENGTH_PX / length if np.isfinite(length) and length > 0 else 1.0
    if TWO_STAGES * scale < 1:
        full = min(1.0, round(FULL_LENGTH_PX / length, 3))
        return full, round(scale / full, 3)
    return 1.0 if 0.75 < scale < 1.35 else float(np.clip(round(scale, 3), 0.1, 2.0)), 1.0


def crop_size(labels: Labels, scale: float) -> tuple[int, int]:
    """Return the size (width, height) of training pictures for labelled pictures scaled by `scale`.

    Training pictures are as large as the scaled pictures, or smaller if the animal is small in them.
    """
    length = scale * body_length_px(labels.xy_px)
    length = length if np.isfinite(length) else NETWORK_LENGTH_PX
    sizes = [scaled_size((p.shape[1], p.shape[0]), scale) for p in labels.pictures]
    widest, highest = np.max(sizes, axis=0)
    sides = np.minimum([widest, highest], [CROP * 1.15 * length, CROP * 0.85 * length])
    width, height = (max(64, 32 * round(float(side) / 32)) for side in sides)
    return width, height


def examples_of(labels: Labels, clip_backgrounds: tuple[Image | None, ...]) -> list[Example]:
    """Return an `Example` for each labelled picture, with the background of the picture's clip."""
    length = body_length_px(labels.xy_px)
    length = length if np.isfinite(length) else NETWORK_LENGTH_PX
    examples = []
    for picture, clip, xy in zip(labels.pictures, labels.clip, labels.xy_px, strict=True):
        background = clip_backgrounds[clip]
        mask = None
        if background is not None and known_points(xy).sum() >= 4:
            mask = moving_mask(picture, background, xy, MARGIN * length)
        examples.append(Example(picture, background, mask, xy, length))
    return examples


def make_batch(
    examples: Sequence[Example], size_px: tuple[int, int], options: Augmentation, size: int, seed: int, step: int,
    pool: Integers, off_px: float = 0.0,
) -> Batch:  # fmt: skip
    """Make the batch of a training step, which depends only on the seed, the step and the pictures in the pool.

    `off_px` is the largest distance of the second stage's windows from their points, 0 for the first stage.
    """
    pictures, picture_backgrounds, points, near_points = [], [], [], []
    for i in range(size):
        rng = np.random.default_rng((seed, step, i))
        example = examples[int(rng.choice(pool))]
        if rng.random() < NO_BACKGROUND:
            example = replace(example, background=None, mask=None)
        picture, background, xy = augment(example, size_px, options, rng)
        pictures.append(picture)
        picture_backgrounds.append(picture if background is None else background)
        points.append(xy)
        if off_px:
            angle, distance_px = rng.uniform(0, 2 * np.pi, len(xy)), off_px * rng.uniform(0, 1, len(xy)) ** 0.5
            near_points.append(xy + np.stack([distance_px * np.cos(angle), distance_px * np.sin(angle)], axis=1))
    return (
        np.stack(pictures),
        np.stack(picture_backgrounds),
        np.stack(points),
        np.stack(near_points) if near_points else None,
    )
