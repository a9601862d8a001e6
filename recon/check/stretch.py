"""Test whether the video is stretched along x, which changes the animal's proportions.

The stretch is a factor exp(s) on the camera's focal length along x. The vertical and horizontal lengths of an animal
are known well enough to detect the usual stretches.
"""

from __future__ import annotations

import math

import numpy as np

from recon.base.arrays import Array
from recon.check.codes import finding
from recon.check.one_step import Detections, Step, Unknown
from recon.fit.clip_problem import ClipProblem
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.terms import focal_scale

MEAN_LOG_STRETCH = 0.05
"""Mean of the estimated logarithm of the stretch in videos that are not stretched."""
LOG_STRETCH_SIGMA = 0.04
"""Standard deviation of the estimated logarithm in videos that are not stretched, not counting detection errors."""
SIGMA_FACTOR = 0.5
"""Factor on the stated standard deviation, which is twice the standard deviation of the estimates in tests."""
LIMITS = -1.6, 3.3
"""Deviations of the estimate, in standard deviations, beyond which a video is compressed or stretched along x.

The deviations are -1.0 to 2.5 in correct views, -2.4 to -0.3 (median -2.1) if x is scaled by 0.75, and 2.1 to 4.7
(median 3.7) if x is scaled by 1.33 (`python benchmarks/wrong_inputs.py --only limits`).
"""
MIN_FOOT_FRACTION = 0.25
"""Minimum fraction of the frames in which each foot is detected, because height and size are uncertain without legs."""


def deviation(stretch: Step) -> float:
    """Return the deviation of an estimate from the mean in videos that are not stretched, in standard deviations."""
    return (stretch.value - MEAN_LOG_STRETCH) / math.hypot(LOG_STRETCH_SIGMA, SIGMA_FACTOR * stretch.sigma)


def feet_are_detected(clip: ClipProblem) -> bool:
    """Return whether the animal has feet, and each of them is detected often enough by the only camera."""
    fractions = clip.views[0].present[:, clip.feet].mean(axis=0)
    return len(fractions) > 0 and float(fractions.min()) >= MIN_FOOT_FRACTION


def stretch_finding(clip: ClipProblem, solution: TrajectorySolution, stretch: Step | None) -> Finding | None:
    """Return a finding if the video is stretched along x or y, otherwise None.

    `stretch` is the estimate of `STRETCH`, if there is one.
    """
    segment = solution.longest_segment
    if stretch is None or segment is None or not feet_are_detected(clip.part(segment.rows)):
        return None
    if LIMITS[0] < deviation(stretch) < LIMITS[1]:
        return None
    return finding(
        "picture_stretched", factor=math.exp(stretch.value - MEAN_LOG_STRETCH), sigmas=abs(deviation(stretch))
    )


def _by_stretch(detections: Detections) -> Array:
    return (detections.projected_px - detections.centre_px) * np.array([1.0, 0.0])


STRETCH = Unknown(0, _by_stretch, fixed=(focal_scale(0),))
"""Logarithm of the factor by which a video of one camera is stretched along x, for `one_steps`."""
