"""What a clip is made from: for each camera its keypoints, on the frames that all of them share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from recon.base.arrays import Array, Bools, Integers
from recon.base.errors import InputError, Problem
from recon.clip.keypoints import CleaningReport, Keypoints
from recon.clip.view import View, camera_poses
from recon.geometry.camera import Camera

BRIDGED_S = 2.0
"""Without detections for longer than this, what comes before and after are two clips."""


@dataclass(frozen=True, eq=False)
class FramePoses:
    """Where a camera that moves was in T frames, in a world with z up; NaN where that is not known."""

    T_camera_world: Array
    """(T, 4, 4)"""
    intrinsics_px: Array | None = None
    """(T, 4): fx, fy, cx, cy, of a camera that zooms."""
    turn_sigma_rad: Array | None = None
    """(T,): standard deviation of each pose's rotation about any axis, where that is known."""

    @property
    def known(self) -> Bools:
        """(T,)"""
        return np.isfinite(self.T_camera_world[:, 0, 0])

    def each(self, change: Callable[[Array], Array]) -> FramePoses:
        """With all that there is changed."""
        zoom, sigma = (None if a is None else change(a) for a in (self.intrinsics_px, self.turn_sigma_rad))
        return FramePoses(change(self.T_camera_world), zoom, sigma)


@dataclass(frozen=True, eq=False)
class Source:
    """One camera's keypoints and what became of them."""

    camera: Camera
    keypoints: Keypoints
    """Cleaned, those that are fitted in their order, on the clip's frames: the first camera's numbers."""
    cleaning: CleaningReport
    file_names: tuple[str, ...]
    """All keypoints of the file."""
    lead_frames: float = 0.0
    """0 up to 1: its pictures were taken that much later than the clip's frames."""
    poses: FramePoses | None = None
    """Of a camera that moves; where they are not known, nothing is detected. The camera itself has no pose then."""
    offset_s: float = 0.0
    """How much later than the first camera's frame 0 its own was taken, as given or found."""

    @property
    def moves(self) -> bool:
        return self.poses is not None


def views_of(sources: Sequence[Source]) -> tuple[View, ...]:
    """Where a camera moves, those that stand still must know their place in the same world."""
    still = [source.camera for source in sources if not source.moves]
    poses, views = iter(camera_poses(still) if still else ()), []
    for source in sources:
        where = FramePoses(next(poses)) if source.poses is None else source.poses.each(held)
        seen = (source.keypoints.xy_px, source.keypoints.confidence, where.intrinsics_px, source.lead_frames)
        views.append(View(source.camera, where.T_camera_world, *seen, where.turn_sigma_rad))
    return tuple(views)


def held(values: Array) -> Array:
    """Values (T, ...), where they are NaN those of the nearest frame that has some."""
    known = np.flatnonzero(np.isfinite(values.reshape(len(values), -1)[:, 0]))
    frames = np.arange(len(values))
    after = np.clip(np.searchsorted(known, frames), 0, len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(known[before] - frames) <= np.abs(known[after] - frames), before, after)
    return values[known[nearest]]


def together(sources: Sequence[Source], later_frames: Sequence[float]) -> tuple[Source, ...]:
    """Sources on their own frames, put on the frames from the first to the last that one of them has, without those
    that are far from all that was seen (`_near_detections`).

    later_frames: how much later each camera's frame 0 was taken than the first's, in frames.
    """
    shifts = [int(np.floor(later)) for later in later_frames]
    starts = [int(s.keypoints.frames[0]) + shift for s, shift in zip(sources, shifts, strict=True)]
    stops = [int(s.keypoints.frames[-1]) + shift + 1 for s, shift in zip(sources, shifts, strict=True)]
    frames, fps = np.arange(min(starts), max(stops)), sources[0].keypoints.fps or np.nan
    near = _near_detections(sources, starts, frames, BRIDGED_S * fps)
    return tuple(
        replace(_on_frames(source, start, frames[near]), lead_frames=later - shift, offset_s=later / fps)
        for source, start, later, shift in zip(sources, starts, later_frames, shifts, strict=True)
    )


def at_rate(keypoints: Keypoints, fps: float) -> Keypoints:
    """Keypoints of a camera with another frame rate at that of the clip, frame 0 staying where it is: between two of
    its frames along straight lines. Slower ones are seen more often than they were, and count less in proportion.
    Raises InputError for fewer frames than that needs."""
    assert keypoints.fps is not None
    if keypoints.fps == fps:
        return keypoints
    times = keypoints.frames * fps / keypoints.fps
    frames = np.arange(int(np.ceil(times[0])), int(np.floor(times[-1])) + 1)
    if len(times) < 2 or not len(frames):
        expected = f"two or more that last as long as one at {fps:g} Hz"
        raise InputError(Problem(keypoints.source or "keypoints", "frames", str(len(times)), expected))
    after = np.clip(np.searchsorted(times, frames), 1, len(times) - 1)
    share = ((frames - times[after - 1]) / (times[after] - times[after - 1]))[:, None]

    def between(values: Array, share: Array) -> Array:
        before, later = values[after - 1], values[after]
        mixed = (1 - share) * before + share * later
        return np.where(share == 0, before, np.where(share == 1, later, mixed))

    xy_px = between(keypoints.xy_px, share[..., None])
    confidence = between(keypoints.confidence, share) * min(1.0, keypoints.fps / fps)
    confidence = np.where(np.isnan(xy_px[..., 0]), 0.0, confidence)
    return replace(keypoints, xy_px=xy_px, confidence=confidence, frames=frames, fps=fps)


def _near_detections(sources: Sequence[Source], starts: Sequence[int], frames: Integers, bridged: float) -> Bools:
    """(T,): the first and the last of consecutive frames, and those near ones in which something is seen: of a stretch
    in which nothing is, so many are left that it is still not bridged."""
    seen = np.zeros(len(frames), dtype=bool)
    for source, start in zip(sources, starts, strict=True):
        seen[np.flatnonzero(source.keypoints.present.any(axis=1)) + start - frames[0]] = True
    at = np.concatenate([[-np.inf], np.flatnonzero(seen), [np.inf]])
    rows = np.arange(len(frames))
    after = np.searchsorted(at, rows)
    near = np.minimum(at[after] - rows, rows - at[after - 1]) <= bridged / 2 + 1
    near[[0, -1]] = True
    return near


def _on_frames(source: Source, start: int, frames: Integers) -> Source:
    """What was seen in consecutive frames from `start` on, in these; missing before and after."""
    keypoints = source.keypoints
    rows = np.arange(start, start + len(keypoints.frames))
    has, own = np.intersect1d(frames, rows, assume_unique=True, return_indices=True)[1:]
    if len(has) == len(frames) == len(rows):
        return replace(source, keypoints=replace(keypoints, frames=frames))

    def spread(values: Array, missing: float = np.nan) -> Array:
        spread = np.full((len(frames), *values.shape[1:]), missing)
        spread[has] = values[own]
        return spread

    return replace(
        source,
        keypoints=replace(
            keypoints, xy_px=spread(keypoints.xy_px), confidence=spread(keypoints.confidence, 0.0), frames=frames
        ),
        poses=source.poses and source.poses.each(spread),
    )
