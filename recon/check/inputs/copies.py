"""Coordinates that no detector finds twice: repeated frames, copied keypoints, points on straight lines between others.

Two detections are never the same to the last digit. Where they are, one of them was copied, and not measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from recon.animal.body import other_side
from recon.base.arrays import Bools
from recon.check.codes import finding
from recon.clip import Source
from recon.clip.keypoints import Keypoints, frame_ranges
from recon.fit.result import Finding

SHARE = 0.2
"""So many identical coordinates, of those that could be, are no chance: hand labels in whole pixels may have a few."""
FRAMES = 0.05
"""Of a clip's frames: fewer that repeat the one before are a hiccup of a camera."""
FEWEST = 4
"""Fewer keypoints of a frame may be identical by chance."""
STRAIGHT_PX, STRAIGHT = 0.01, 0.02
"""A point lies on the line between its neighbours within the digits of a file, and within this part of its way."""


def copies(sources: Sequence[Source], resampled: bool = False) -> Iterator[Finding]:
    """Of all cameras' files. resampled: points were taken between frames here, and straight lines say nothing."""
    for source in sources:
        keypoints, camera = source.keypoints, source.camera.name
        yield from ([] if resampled else _interpolated(keypoints, camera)) or _repeated(keypoints, camera)
        yield from _copied_sides(keypoints, camera)
    for a, b in combinations(sources, 2):
        identical, both = _identical(a.keypoints.xy_px, b.keypoints.xy_px)
        if _many(identical, both):
            yield finding(
                "same_keypoints", cameras=(a.camera.name, b.camera.name), share=float(identical.sum() / both.sum())
            )


def _identical(a: np.ndarray, b: np.ndarray) -> tuple[Bools, Bools]:
    """Of points (..., 2): which are the same in both, and which are in both."""
    both = np.asarray(np.isfinite(a + b).all(axis=-1))
    return both & np.asarray((a == b).all(axis=-1)), both


def _many(identical: Bools, of: Bools) -> bool:
    return bool(identical.sum() > SHARE * of.sum() and identical.sum() >= FEWEST)


def _repeated(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Frames whose points are those of the frame before: every second, as of a video at twice its rate, or some."""
    identical, both = _identical(keypoints.xy_px[1:], keypoints.xy_px[:-1])
    repeats = np.concatenate(
        [[False], (identical.sum(axis=1) >= FEWEST) & (2 * identical.sum(axis=1) > both.sum(axis=1))]
    )
    if repeats.sum() <= FRAMES * len(repeats):
        return
    new = np.flatnonzero(~repeats)
    times = int(np.median(np.diff(new))) if len(new) > 2 else 1
    if times > 1 and repeats.mean() < 1 - 0.5 / times:
        numbers = {"times": times, "given_hz": keypoints.fps or np.nan, "other_hz": (keypoints.fps or np.nan) / times}
        yield finding("detections_repeated", camera=camera, **numbers)
        return
    runs = frame_ranges(np.flatnonzero(repeats))
    first, stop = max(runs, key=lambda run: run[1] - run[0])
    frames = (int(keypoints.frames[first - 1]), int(keypoints.frames[stop - 1]) + 1)
    yield finding("detections_frozen", frames, camera, count=int(repeats.sum()), frames_total=len(repeats))


def _interpolated(keypoints: Keypoints, camera: str) -> list[Finding]:
    """Points halfway between those before and after, although they move."""
    xy_px = keypoints.xy_px
    bend = np.linalg.norm(xy_px[2:] - 2 * xy_px[1:-1] + xy_px[:-2], axis=-1)
    way = 0.5 * np.linalg.norm(xy_px[2:] - xy_px[:-2], axis=-1)
    moving = way > 0
    straight = moving & (bend < np.minimum(STRAIGHT_PX, STRAIGHT * way))
    if not _many(straight, moving):
        return []
    return [finding("detections_interpolated", camera=camera, share=float(straight.sum() / moving.sum()))]


def _copied_sides(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    names = keypoints.names
    pairs = [(i, names.index(other_side(n))) for i, n in enumerate(names) if other_side(n) in names]
    left, right = ([pair[k] for pair in pairs if pair[0] < pair[1]] for k in (0, 1))
    identical, both = _identical(keypoints.xy_px[:, left], keypoints.xy_px[:, right])
    if _many(identical, both):
        yield finding("far_side_copied", camera=camera, share=float(identical.sum() / both.sum()))
