"""Check that keypoints lie inside the camera's picture, and suggest a correction if they do not."""

from __future__ import annotations

import numpy as np

from recon.api.clip_cameras import other_cameras
from recon.api.settings import FitSettings
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.numbers import quantity
from recon.clip import Keypoints
from recon.geometry.camera import Camera

PADDING_FRACTION = 0.05
"""Fraction of the picture's size by which keypoints may lie outside, because detectors pad the picture."""
MIN_INSIDE_FRACTION = 0.9
"""Minimum fraction of a clip's keypoints that have to lie inside. The others may be outliers."""


def require_inside(camera: Camera, keypoints: Keypoints, settings: FitSettings) -> None:
    """Raise InputError if keypoints lie outside the picture, because the camera or the picture size is then wrong."""
    points = np.clip(keypoints.xy_px[keypoints.present], -1e9, 1e9)
    if _contains(camera.image_size_px, points):
        return
    (x0, y0), (x1, y1) = np.percentile(points, [1, 99], axis=0)
    width, height = camera.image_size_px
    actual = f"{width}x{height}, but keypoints at x {x0:.0f} to {x1:.0f}, y {y0:.0f} to {quantity(y1, 0, 'px')}"
    expected = "the camera and the size of the video that the keypoints were found in"
    origin = settings.camera_text or "--image-size"
    raise InputError(Problem(origin, "image size", actual, expected + _possible_causes(camera, points, settings)))


def _contains(size_px: tuple[int, int], points: Array) -> bool:
    """Return whether nearly all points (n, 2) lie in a picture of the given size or only slightly outside."""
    over = np.max([-points, points - size_px], axis=0) / size_px
    return bool(np.mean(over.max(axis=1) <= PADDING_FRACTION) >= MIN_INSIDE_FRACTION)


def _possible_causes(camera: Camera, points: Array, settings: FitSettings) -> str:
    """Return the input errors that would explain points (n, 2) outside the picture, as the end of a sentence."""
    causes = ["x and y are exchanged"] if _contains(camera.image_size_px, points[:, ::-1]) else []
    fitting = (
        camera_of_file
        for camera_of_file in other_cameras(camera, settings)
        if _contains(camera_of_file.image_size_px, points)
    )
    causes += [f"the keypoints are from {camera_of_file.name} of the file" for camera_of_file in fitting]
    larger = (n for n in (2, 3, 4) if _contains((n * camera.image_size_px[0], n * camera.image_size_px[1]), points))
    causes = causes or [f"the keypoints were found in a video {n} times as large" for n in larger][:1]
    return f"; perhaps {', or '.join(causes)}" if causes else ""
