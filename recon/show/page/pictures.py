"""Choose and encode the pictures of a video for a page, all frames of a short clip or some of a long one.

The pictures are WebP files instead of a video, because every browser shows them, each frame is found exactly, and
OpenCV encodes them quickly. OpenCV's wheels have no H.264 encoder, and their VP8 and VP9 encoders are slower and make
larger files.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from recon.base.arrays import Array, Integers
from recon.io.video import Image

STRIP_BYTES = 2_500_000
"""Largest size of all pictures of a page before base64 encoding, which adds a third."""
SIZES_AND_QUALITIES = ((960, 55), (800, 50), (640, 50), (640, 35), (480, 35))
"""Widths in pixels and WebP qualities of pictures, the best first.

The first with which the pictures fit into `STRIP_BYTES` is used.
"""
MARGIN = 0.2
"""Margin around the part of the picture through which the animal passes, as a fraction of the animal's size."""
SMALL_PX = 150.0
"""Width of the animal in a page's picture, in pixels, below which the picture is a window that follows the animal."""
WINDOW = 2.6
"""Size of the window that follows the animal, relative to the box around the animal."""
WINDOW_PX = 640
SMOOTH_S = 0.2
MIME = "image/webp"


@dataclass(frozen=True, eq=False)
class Cut:
    """Part of each picture that a page keeps, with corners (T, 2) and one size (2,) in pixels of the video."""

    corners_px: Integers
    size_px: tuple[int, int]
    most_px: int
    """Largest width of a page's pictures, in pixels."""


@dataclass(eq=False)
class PictureStrip:
    """Encoded pictures of some frames of a video, for the player of a page."""

    cut: Cut
    rows: list[int] = field(default_factory=list)
    """Indices of the motion's frames to which the pictures belong, in ascending order."""
    encoded: list[bytes] = field(default_factory=list)
    every: int = 1
    """Step between the frames that are kept, 1 for every frame."""
    video: str = ""
    """Name of the video."""
    first_frame: int = 0
    """Frame number, in the clip, of the video's first frame."""

    def to_json(self) -> dict[str, Any]:
        """Return the pictures and their positions in the video as JSON types, for the player of a page."""
        return {
            "mime": MIME,
            "every": self.every,
            "video": self.video,
            "first_frame": self.first_frame,
            "rows": self.rows,
            "corners_px": [[int(x) for x in self.cut.corners_px[row]] for row in self.rows],
            "size_px": list(self.cut.size_px),
            "data": [base64.b64encode(picture).decode() for picture in self.encoded],
        }


def cut_of(points_px: Array, fps: float, picture_px: tuple[int, int]) -> Cut:
    """Return the part of each picture of a video that a page keeps around the animal.

    Parameters
    ----------
    points_px
        Positions of the joints in the picture in pixels, shape (T, J, 2), NaN if unknown.
    fps
        Frames per second.
    picture_px
        Width and height of the picture in pixels.
    """
    picture = np.array(picture_px)
    corners = np.zeros((len(points_px), 2), dtype=int)
    known = np.isfinite(points_px.sum(axis=2)).any(axis=1)
    if not known.any():
        return Cut(corners, picture_px, SIZES_AND_QUALITIES[0][0])
    low, high = np.nanmin(points_px[known], axis=1), np.nanmax(points_px[known], axis=1)
    low, high = np.clip(low, 0, picture), np.clip(high, 0, picture)
    box = np.maximum(np.percentile(high - low, 98, axis=0), 8.0)
    first, last = low.min(axis=0) - MARGIN * box, high.max(axis=0) + MARGIN * box
    first, last = np.clip(first, 0, picture), np.clip(last, 0, picture)
    size = _even(np.maximum(last - first, 0.15 * picture), picture)
    widest = SIZES_AND_QUALITIES[0][0]
    if box[0] * min(1.0, widest / size[0]) >= SMALL_PX or size[0] <= WINDOW * box[0]:
        corners[:] = np.clip(np.round((first + last - size) / 2), 0, picture - size)
        return Cut(corners, (int(size[0]), int(size[1])), widest)
    size = _even(np.maximum(WINDOW * box, 48), picture)
    rows, known_rows = np.arange(len(points_px)), np.flatnonzero(known)
    filled = np.column_stack([np.interp(rows, known_rows, centre) for centre in (low + high).T / 2])
    half = min(round(SMOOTH_S * fps / 2), len(filled) - 1)
    start, end = 2 * filled[0] - filled[half:0:-1], 2 * filled[-1] - filled[-2 : -half - 2 : -1]
    padded = np.concatenate([start, filled, end])  # extrapolated at constant speed
    smooth = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0).mean(axis=-1)
    corners = np.clip(np.round(smooth - size / 2), 0, picture - size).astype(int)
    return Cut(corners, (int(size[0]), int(size[1])), WINDOW_PX)


def _even(size: Array, limit_px: Array) -> Array:
    return np.minimum(2 * np.ceil(size / 2), limit_px)


def encode_strip(pictures: Iterable[tuple[int, Image]], count: int, cut: Cut) -> PictureStrip:
    """Encode pictures for a page, so that their size is about `STRIP_BYTES` at most.

    `pictures` yields the index in the motion and the picture of each frame, in ascending order, and `count` is their
    number.
    """
    strip = PictureStrip(cut)
    width, quality, budget = 0, 0, 0.0
    for i, (row, picture) in enumerate(pictures):
        if width == 0:
            width, quality, strip.every = _fitting(picture, row, count, cut)
            budget = STRIP_BYTES / -(-count // strip.every)
        if i % strip.every:
            continue
        spent, due = sum(map(len, strip.encoded)), budget * len(strip.encoded)
        # A lower quality keeps the size within the limit if later pictures have more detail than the first ones.
        lower = 0 if spent <= due else min(25, round(60 * (spent / max(due, 1.0) - 1)) + 3)
        strip.rows.append(row)
        strip.encoded.append(_encode(picture, row, cut, width, max(10, quality - lower)))
    return strip


def _fitting(picture: Image, row: int, count: int, cut: Cut) -> tuple[int, int, int]:
    """Return the width in px and quality at which `count` similar pictures fit a page, and the step between frames."""
    allowed = [
        (width, quality)
        for width, quality in SIZES_AND_QUALITIES
        if width <= max(cut.most_px, SIZES_AND_QUALITIES[-1][0])
    ]
    size = 1.0
    for width, quality in allowed:
        size = 1.1 * len(_encode(picture, row, cut, width, quality))
        if count * size <= STRIP_BYTES:
            return width, quality, 1
    width, quality = next(at for at in allowed if at[0] <= WINDOW_PX)
    size = 1.1 * len(_encode(picture, row, cut, width, quality))
    return width, quality, int(np.ceil(count * size / STRIP_BYTES))


def _encode(picture: Image, row: int, cut: Cut, width: int, quality: int) -> bytes:
    x, y = cut.corners_px[row].tolist()
    part = picture[y : y + cut.size_px[1], x : x + cut.size_px[0]]
    scale = min(1.0, width / cut.size_px[0])
    if scale < 1:
        part = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".webp", part, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
