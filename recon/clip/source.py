"""What a clip is made from: for each camera its keypoints, on the frames that all of them share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recon.camera import Camera
from recon.clip.view import View, camera_poses
from recon.keypoints import CleaningReport, Keypoints


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


def views_of(sources: Sequence[Source]) -> tuple[View, ...]:
    """By cameras that stand still."""
    poses = camera_poses([source.camera for source in sources])
    return tuple(
        View(
            source.camera,
            pose,
            source.keypoints.xy_px,
            source.keypoints.confidence,
            lead_frames=source.lead_frames,
        )
        for source, pose in zip(sources, poses, strict=True)
    )


def together(sources: Sequence[Source], later_frames: Sequence[float]) -> tuple[Source, ...]:
    """Sources on their own frames, put on the frames from the first to the last that one of them has.

    later_frames: how much later each camera's frame 0 was taken than the first's, in frames.
    """
    shifts = [int(np.floor(later)) for later in later_frames]
    starts = [int(s.keypoints.frames[0]) + shift for s, shift in zip(sources, shifts, strict=True)]
    stops = [int(s.keypoints.frames[-1]) + shift + 1 for s, shift in zip(sources, shifts, strict=True)]
    frames = np.arange(min(starts), max(stops))
    return tuple(
        replace(
            source, keypoints=_on_frames(source.keypoints, start - int(frames[0]), frames), lead_frames=later - shift
        )
        for source, start, later, shift in zip(sources, starts, later_frames, shifts, strict=True)
    )


def _on_frames(keypoints: Keypoints, start: int, frames: NDArray[np.int64]) -> Keypoints:
    """Keypoints of frames without a gap, as rows from `start` on; missing before and after."""
    rows = slice(start, start + len(keypoints.frames))
    xy_px = np.full((len(frames), *keypoints.xy_px.shape[1:]), np.nan)
    confidence = np.zeros((len(frames), len(keypoints.names)))
    xy_px[rows], confidence[rows] = keypoints.xy_px, keypoints.confidence
    return replace(keypoints, xy_px=xy_px, confidence=confidence, frames=frames)
