"""Training pictures in batches, made in the background while the network learns from the last ones."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from recon.base.arrays import Array, Integers
from recon.io.video import Image
from recon.keypoint_net.ahead import ahead
from recon.keypoint_net.augment import Augmentation, Example, augment
from recon.keypoint_net.background import moving_mask
from recon.keypoint_net.labels import Labels, body_length_px, known_points, scaled_size

NETWORK_LENGTH_PX = 120.0
"""Length of the animal in the pictures that the network sees; clips are scaled to it, unless they are near."""
FULL_LENGTH_PX = 480.0
"""Length of the animal in the pictures of a second stage, at most: labels are no more precise than this."""
TWO_STAGES = 1.5
"""Animals so many times longer than NETWORK_LENGTH_PX are looked for in small pictures, and each of their points then
near the place found, at full size."""
PART_PX = (128, 128)
"""Size of training pictures of the second stage."""
OFF = 0.75
"""How far off the first stage is taken to be at most, in training, relative to where the second one looks."""
CROP = 1.4
"""Size of training pictures, relative to the animal's length."""
MARGIN = 0.12
"""Of the animal around its labelled points, relative to its length."""
NO_BACKGROUND = 0.2
"""Share of the training pictures whose difference to the background is left out."""
AHEAD = 3


Batch = tuple[NDArray[np.uint8], NDArray[np.uint8], Array, Array | None]
"""Pictures (B, H, W, 3); their backgrounds (B, H, W, 3), the picture itself where there is none, which makes the
difference 0; K points of each (B, K, 2), NaN where a point is not labelled or not in the picture; and places near them
(B, K, 2), as a first stage might find them, None for the first stage itself."""


def network_scales(xy_px: Array) -> tuple[float, float]:
    """By which pictures are scaled for the network, and from there once more for its first stage (1: there is but one),
    from labels (N, K, 2)."""
    length = body_length_px(xy_px)
    scale = NETWORK_LENGTH_PX / length if np.isfinite(length) and length > 0 else 1.0
    if TWO_STAGES * scale < 1:
        full = min(1.0, round(FULL_LENGTH_PX / length, 3))
        return full, round(scale / full, 3)
    return 1.0 if 0.75 < scale < 1.35 else float(np.clip(round(scale, 3), 0.1, 2.0)), 1.0


def crop_size(labels: Labels, scale: float) -> tuple[int, int]:
    """(width, height) of training pictures at a scale of the labels' own: that of the clips' pictures, or less where
    the animal is small in them."""
    length = scale * body_length_px(labels.xy_px)
    length = length if np.isfinite(length) else NETWORK_LENGTH_PX
    sizes = [scaled_size((p.shape[1], p.shape[0]), scale) for p in labels.pictures]
    widest, highest = np.max(sizes, axis=0)
    sides = np.minimum([widest, highest], [CROP * 1.15 * length, CROP * 0.85 * length])
    width, height = (max(64, 32 * round(float(side) / 32)) for side in sides)
    return width, height


def examples_of(labels: Labels, backgrounds: tuple[Image | None, ...]) -> list[Example]:
    length = body_length_px(labels.xy_px)
    length = length if np.isfinite(length) else NETWORK_LENGTH_PX
    found = []
    for picture, clip, xy in zip(labels.pictures, labels.clip, labels.xy_px, strict=True):
        background = backgrounds[clip]
        mask = None
        if background is not None and known_points(xy).sum() >= 4:
            mask = moving_mask(picture, background, xy, MARGIN * length)
        found.append(Example(picture, background, mask, xy, length))
    return found


@dataclass(frozen=True, eq=False)
class BatchSource:
    """Makes the batch of a step: a function of the seed, the step and the pictures to draw from only."""

    examples: list[Example]
    size_px: tuple[int, int]
    options: Augmentation
    size: int
    seed: int
    off_px: float = 0.0
    """How far from its points a second stage is told to look; 0: it is the first."""

    def batch(self, step: int, pool: Integers) -> Batch:
        pictures, backgrounds, points, near = [], [], [], []
        for i in range(self.size):
            rng = np.random.default_rng((self.seed, step, i))
            example = self.examples[int(rng.choice(pool))]
            if rng.random() < NO_BACKGROUND:
                example = replace(example, background=None, mask=None)
            picture, background, xy = augment(example, self.size_px, self.options, rng)
            pictures.append(picture)
            backgrounds.append(picture if background is None else background)
            points.append(xy)
            if self.off_px:
                angle, far = rng.uniform(0, 2 * np.pi, len(xy)), self.off_px * rng.uniform(0, 1, len(xy)) ** 0.5
                near.append(xy + np.stack([far * np.cos(angle), far * np.sin(angle)], axis=1))
        near_px = np.stack(near) if near else None
        return np.stack(pictures), np.stack(backgrounds), np.stack(points), near_px


def batches(sources: Sequence[BatchSource], step: int, pool: Integers) -> Generator[tuple[Batch, ...]]:
    """Of this step and all that follow, one batch of each source, made ahead."""
    return ahead((tuple(source.batch(s, pool) for source in sources) for s in count(step)), AHEAD)
