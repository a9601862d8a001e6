"""Check that keypoints lie inside the camera's picture, and say what would put them there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recon.api.settings import FitSettings
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.clip import (
    Keypoints,
)
from recon.geometry.camera import Camera

if TYPE_CHECKING:
    pass


from recon.api.clip_cameras import other_cameras

PADDED, INSIDE = 0.05, 0.9
"""Detectors pad the picture: so far outside keypoints are as good as in it; at least so many of a clip's have to be."""


def require_inside(camera: Camera, keypoints: Keypoints, settings: FitSettings) -> None:
    """A picture smaller than the points' is another camera's, or the wrong size was given."""
    points = np.clip(keypoints.xy_px[keypoints.present], -1e9, 1e9)
    if _holds(camera.image_size_px, points):
        return
    (x0, y0), (x1, y1) = np.percentile(points, [1, 99], axis=0)
    width, height = camera.image_size_px
    found = f"{width}x{height}, but keypoints at x {x0:.0f} to {x1:.0f}, y {y0:.0f} to {y1:.0f} px"
    expected = "the camera and the size of the video that the keypoints were found in"
    where = settings.camera_text or "--image-size"
    raise InputError(Problem(where, "image size", found, expected + _perhaps(camera, points, settings)))


def _holds(size_px: tuple[int, int], points: Array) -> bool:
    """Whether nearly all points (n, 2) lie in a picture of that size, or as little outside as detectors put them."""
    over = np.max([-points, points - size_px], axis=0) / size_px
    return bool(np.mean(over.max(axis=1) <= PADDED) >= INSIDE)


def _perhaps(camera: Camera, points: Array, settings: FitSettings) -> str:
    """What would put points (n, 2) in the picture."""
    causes = ["x and y are exchanged"] if _holds(camera.image_size_px, points[:, ::-1]) else []
    others = (other for other in other_cameras(camera, settings) if _holds(other.image_size_px, points))
    causes += [f"they are of {other.name} of the file" for other in others]
    larger = (n for n in (2, 3, 4) if _holds((n * camera.image_size_px[0], n * camera.image_size_px[1]), points))
    causes = causes or [f"they were found in a video {n} times as large" for n in larger][:1]
    return f"; perhaps {', or '.join(causes)}" if causes else ""
