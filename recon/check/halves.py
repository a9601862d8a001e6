"""Test whether the fore half and the hind half belong to the same animal, because another one may run close behind.

The hind half of another animal looks early or late. A time offset of the hind half shifts its markers along their
motion in the picture. One step of the fit estimates this offset with its standard deviation.
"""

from __future__ import annotations

import numpy as np

from recon.base.arrays import Array, Bools
from recon.check.codes import finding
from recon.check.one_step import Detections, Step, Unknown
from recon.fit.clip_problem import ClipProblem
from recon.fit.result import Finding, TrajectorySolution

LIMITS = -1.4, 3.3
"""Time offsets of the hind half, in standard deviations, below which the half is late and above which it is early.

The offsets are 0.2 to 1.4 in correct views, and -2.2 to -1.2 (median -1.4) with the hind half of an animal that runs a
tenth of a second behind (`python benchmarks/wrong_inputs.py --only limits`, five views each).
"""
MIN_FRAMES = 3
"""Minimum number of frames in a segment of the clip whose halves are compared."""
DISAGREES_SIGMAS = 3.0
"""Distance of a detection from its marker, in standard deviations, beyond which it disagrees with the pose."""
WORSE_HALF_RATIO = 2.0
"""Ratio of the fractions of disagreeing detections in the two halves, above which only the worse half is reported."""


def hind_markers(clip: ClipProblem) -> Bools:
    """Return a mask (J,) of the markers that are behind the middle of the trunk in the expected pose."""
    body, points_m = clip.body, clip.body.expected_points_m()
    rear, front = (body.markers.index(marker) for marker in body.forward)
    ahead = points_m[front] - points_m[rear]
    return np.asarray((points_m - 0.5 * (points_m[front] + points_m[rear])) @ ahead < 0)


def hind_offset(clip: ClipProblem) -> Unknown:
    """Return the time offset of the animal's hind half in a clip of one camera, in frames, for `one_steps`."""
    is_hind = hind_markers(clip)

    def by_offset(detections: Detections) -> Array:
        projected_px = detections.projected_px
        if len(projected_px) < MIN_FRAMES:
            return np.zeros_like(projected_px)
        return np.gradient(projected_px, axis=0) * is_hind[None, :, None]

    return Unknown(0, by_offset)


def halves_finding(clip: ClipProblem, solution: TrajectorySolution, offset: Step | None) -> Finding | None:
    """Return a finding if the hind half is early or late relative to the fore half, otherwise None.

    `offset` is the estimate of `hind_offset`, if there is one.
    """
    if offset is None or hind_markers(clip).all() or LIMITS[0] < offset.value / offset.sigma < LIMITS[1]:
        return None
    halves = foreign_half(clip, solution)
    return finding("halves_apart", late_frames=-offset.value, sigmas=abs(offset.value) / offset.sigma, foreign=halves)


def foreign_half(clip: ClipProblem, solution: TrajectorySolution) -> str:
    """Return the name of the half of the body, fore or hind, whose detections disagree with the pose far more often.

    If neither half stands out, the returned string names both halves.
    """
    view, is_hind = clip.views[0], hind_markers(clip)
    projected_px, _ = view.project(view.shift_to_exposure(solution.markers_m))
    with np.errstate(invalid="ignore"):  # NaN in frames without a pose
        distances = np.linalg.norm(projected_px - view.xy_px, axis=-1) / solution.noise_px[0]
    is_known = view.present & np.isfinite(distances)
    hind, fore = (
        float((distances[:, half][is_known[:, half]] > DISAGREES_SIGMAS).mean()) if is_known[:, half].any() else 0.0
        for half in (is_hind, ~is_hind)
    )
    if max(hind, fore) < WORSE_HALF_RATIO * min(hind, fore) or hind == fore:
        return "fore or hind half"
    return "hind half" if hind > fore else "fore half"
