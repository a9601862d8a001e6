"""The still background of a clip: what a camera on a tripod sees where nothing moves.

The network gets the difference of a picture to it besides the picture itself, which shows what is new in the scene
whatever the place and the light; and training pastes the animal on it elsewhere. Where the camera moves, or where
there are too few pictures, there is none, and the difference is all zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from recon.base.arrays import Array, Integers
from recon.io.video import Image, probe, read_frames
from recon.keypoint_net.labels import Labels, known_points, resize, scaled_size

LEAST_PICTURES = 8
MOST_PICTURES = 60
MOST_BYTES = 2**28
"""Of those that are held at a time of a video."""
STILL_LEVELS = 12.0
"""Grey levels by which most of a picture differs at most from the background where the camera is still."""
STILL_SHARE = 0.6
"""Of a picture's pixels."""
MOVED_LEVELS = 22.0
"""Grey levels by which the animal differs from the background, in some colour."""


def background_of(pictures: Sequence[Image]) -> Image | None:
    """The median of pictures of one clip; None where they are few, or where the camera moves."""
    if len(pictures) < LEAST_PICTURES:
        return None
    picked = [pictures[i] for i in np.unique(np.linspace(0, len(pictures) - 1, MOST_PICTURES).round().astype(int))]
    background = np.empty_like(picked[0])
    for rows in np.array_split(np.arange(len(background)), max(1, background.size * len(picked) // 2**24)):
        background[rows] = np.median(np.stack([p[rows] for p in picked]), axis=0).astype(np.uint8)
    still = [float((cv2.absdiff(p, background).max(axis=2) < STILL_LEVELS).mean()) for p in picked]
    return background if float(np.median(still)) >= STILL_SHARE else None


def backgrounds(labels: Labels, apart: Integers) -> tuple[Image | None, ...]:
    """One for each clip, from its pictures but those `apart` (indices), which nobody has yet."""
    found = []
    for c in range(len(labels.clips)):
        here = np.flatnonzero(labels.clip == c)
        known = np.setdiff1d(here, apart)
        found.append(background_of([labels.pictures[i] for i in (known if len(known) else here)]))
    return tuple(found)


def background_of_video(video: Path, scale: float) -> Image | None:
    """From pictures spread over the frames that the video states, at the network's scale. Few are held at a time."""
    info = probe(video)
    width, height = scaled_size(info.size_px, scale)
    most = int(np.clip(MOST_BYTES // (3 * width * height), LEAST_PICTURES, MOST_PICTURES))
    step = max(1, (info.stated_frames or MOST_PICTURES) // most)
    pictures = [resize(picture, scale) for _, picture in read_frames(video, 0, step * most, step)]
    return background_of(pictures)


def moving_mask(picture: Image, background: Image, xy_px: Array, margin_px: float) -> Image:
    """(height, width), 0 to 255: what differs from the background near the labelled points (K, 2)."""
    near = np.zeros(picture.shape[:2], np.uint8)
    known = xy_px[known_points(xy_px)]
    if len(known):
        hull = cv2.convexHull(known.astype(np.float32)).round().astype(np.int32)
        cv2.fillConvexPoly(near, hull, 255)
        size = 2 * round(margin_px) + 1
        near = cv2.dilate(near, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    moved = (cv2.absdiff(picture, background).max(axis=2) > MOVED_LEVELS).astype(np.uint8) * 255
    moved = cv2.bitwise_and(cv2.morphologyEx(moved, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)), near)
    # Holes are where the animal looks like the background; what lies between its legs is open to the ground.
    gap = 2 * max(1, round(0.25 * margin_px)) + 1
    moved = cv2.morphologyEx(moved, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap)))
    outlines, _ = cv2.findContours(moved, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(moved, outlines, -1, 255, cv2.FILLED)
    moved = cv2.dilate(moved, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.GaussianBlur(moved, (3, 3), 0), np.uint8)
