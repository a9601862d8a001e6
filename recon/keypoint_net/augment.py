"""Training pictures that nobody took: turned, scaled, moved, mirrored, pasted elsewhere, in another light, blurred,
covered in part and noisy.

Each is a function of its random generator, and that of the run's seed and the place of the picture in it: a run that
goes on after a break draws the same pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recon.base.arrays import Array
from recon.io.video import Image
from recon.keypoint_net.labels import known_points


@dataclass(frozen=True)
class Augmentation:
    """Ranges; each is drawn evenly between its ends, in its logarithm where it is a factor. Shares are probabilities.

    partner: for each keypoint, the one that it becomes in a mirror; None: pictures are not mirrored.
    """

    rotation_deg: float = 20.0
    scale: tuple[float, float] = (0.6, 1.6)
    stretch: float = 0.12
    partner: tuple[int, ...] | None = None
    paste: float = 0.5
    contrast: float = 0.3
    brightness: float = 25.0
    gamma: float = 0.3
    colour: float = 0.12
    light_patch: float = 0.3
    cutout: float = 0.5
    blur: float = 0.25
    noise: float = 6.0


@dataclass(frozen=True, eq=False)
class Example:
    """A picture to learn from, h by w pixels, with K points."""

    picture: Image
    """(h, w, 3)"""
    background: Image | None
    """Of the picture's shape, None where the camera moves."""
    mask: Image | None
    """(h, w), the animal's, None where the camera moves."""
    xy_px: Array
    """(K, 2), NaN where not labelled."""
    length_px: float
    """Of the animal."""
    part: bool = False
    """Whether pictures are made of what is around one of its points, rather than of all of it."""


def augment(
    example: Example, size_px: tuple[int, int], options: Augmentation, rng: np.random.Generator
) -> tuple[Image, Image | None, Array]:
    """A picture of size_px (width, height), its background, and the points in it (K, 2), NaN where there is none."""
    mirrored = options.partner is not None and rng.random() < 0.5
    to = _affine(example, size_px, options, mirrored, rng)
    picture = _warp(example.picture, to, size_px)
    background = None
    if example.background is not None:
        background = _warp(example.background, to, size_px)
        if example.mask is not None and rng.random() < options.paste:
            mask = _warp(example.mask, to, size_px, constant=True)[..., None].astype(np.float32) / 255
            background = _other_background(example.background, size_px, rng)
            picture = (picture * mask + background * (1 - mask)).astype(np.uint8)
    xy_px = example.xy_px @ to[:, :2].T + to[:, 2]
    if mirrored and options.partner is not None:
        xy_px = xy_px[list(options.partner)]
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
    """As of a picture that moved evenly along a line while it was taken."""
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
    """(2, 3): the animal's middle, or one of its points, to anywhere in the new picture but its edges."""
    known = example.xy_px[known_points(example.xy_px)]
    height, width = example.picture.shape[:2]
    centre = 0.5 * (known.min(axis=0) + known.max(axis=0)) if len(known) else rng.uniform(0, [width, height])
    if example.part and len(known):
        centre = known[rng.integers(len(known))]
    scale = math.exp(rng.uniform(*np.log(options.scale)))
    stretch = math.exp(rng.uniform(-options.stretch, options.stretch))
    turn = math.radians(rng.normal(0, options.rotation_deg / 2))
    turn = float(np.clip(turn, *np.radians([-options.rotation_deg, options.rotation_deg])))
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    linear = rotation @ np.diag([scale * stretch * (-1 if mirrored else 1), scale / stretch])
    place = rng.uniform([0.2, 0.25], [0.8, 0.75]) * size_px
    return np.column_stack([linear, place - linear @ centre])


def _warp(picture: Image, to: Array, size_px: tuple[int, int], constant: bool = False) -> Image:
    border = cv2.BORDER_CONSTANT if constant else cv2.BORDER_REFLECT_101
    small = abs(np.linalg.det(to[:, :2])) < 0.5
    flags = cv2.INTER_AREA if small else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(picture, to, size_px, flags=flags, borderMode=border), np.uint8)


def _other_background(background: Image, size_px: tuple[int, int], rng: np.random.Generator) -> Image:
    """Another part of the clip's own background, or its mirror picture."""
    height, width = background.shape[:2]
    scale = math.exp(rng.uniform(-0.4, 0.5)) * max(1.0, 0.7 * size_px[0] / width, 0.7 * size_px[1] / height)
    mirror = -1.0 if rng.random() < 0.5 else 1.0
    linear = np.diag([scale * mirror, scale])
    place = 0.5 * np.array(size_px) - linear @ rng.uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height])
    return _warp(background, np.column_stack([linear, place]), size_px)


def _random_light(
    size_px: tuple[int, int], options: Augmentation, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
    """A table (256, 3) for the levels of each colour, and a factor for each pixel (H, W, 1) where there is a patch."""
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
    angle, at = rng.uniform(0, 2 * math.pi), rng.uniform(0.2, 0.8, 2) * size_px
    across = (x - at[0]) * math.cos(angle) + (y - at[1]) * math.sin(angle)
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
    """Up to three rectangles of one colour, or of the background: what stands before the animal."""
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
