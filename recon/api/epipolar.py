"""Compute epipolar lines: possible positions, in one camera's picture, of a keypoint that another camera sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from recon.base.arrays import Array
from recon.fit.motion import Motion

NEAREST_RATIO = 0.1
"""Distance from the camera at which a ray begins, relative to the animal's distance."""
FARTHEST_RATIO = 10.0
"""Distance from the camera at which a ray ends, relative to the animal's distance."""
POINTS_PER_RAY = 97
"""Number of points on a ray, evenly spaced in the logarithm of the distance."""


def epipolar_lines_px(
    motion: Motion, camera: int, row: int, joint: int, marks_px: Mapping[int, tuple[float, float] | None]
) -> dict[str, Array]:
    """Return the epipolar lines of the other cameras' detections of a keypoint, in one camera's picture.

    The line is the picture of the ray through the other camera's detection, curved by the distortion of the lens.

    Parameters
    ----------
    motion
        A motion of several cameras.
    camera
        Index of the camera in whose picture the lines are drawn.
    row, joint
        Indices of the frame and of the keypoint.
    marks_px
        Corrected positions (px) that replace the detections, keyed by index of the camera; None if the keypoint is
        hidden.

    Returns
    -------
    dict
        Points (n, 2) of each line, px, keyed by the name of the other camera. Cameras that do not see the keypoint are
        left out.
    """
    views = [view.part(slice(row, row + 1)) for view in motion.solution.views]
    lines: dict[str, Array] = {}
    width, height = views[camera].camera.image_size_px
    for number, view in enumerate(views):
        mark_px = marks_px.get(number, tuple(view.xy_px[0, joint]))
        if number == camera or mark_px is None or not np.isfinite(mark_px).all():
            continue
        seen = replace(view, xy_px=np.array([[mark_px]]), confidence=np.ones((1, 1)))
        direction, centre_m = seen.rays()[0, 0], seen.centre_m[0]
        distance_m = np.linalg.norm(motion.solution.markers_m[row, joint] - centre_m)
        if not np.isfinite(distance_m) or not np.isfinite(direction).all():
            continue
        ratios = np.geomspace(NEAREST_RATIO, FARTHEST_RATIO, POINTS_PER_RAY)
        points_m = centre_m + distance_m * ratios[:, None] * direction
        pixels, is_valid = views[camera].project(points_m[None])
        margin_px = max(width, height)
        low, high = np.array([-margin_px, -margin_px]), np.array([width + margin_px, height + margin_px])
        is_near = is_valid[0] & ((pixels[0] > low) & (pixels[0] < high)).all(axis=1)
        if is_near.sum() > 1:
            lines[motion.cameras[number].name] = pixels[0, is_near]
    return lines
