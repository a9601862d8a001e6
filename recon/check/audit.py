"""Audit a file of 2D keypoints or 3D poses from any program, without a camera, a fit or a model of the animal.

Each check measures a value that increases with the suspicion of a fault. A value above the check's limit (`LIMITS`)
leads to a finding. `benchmarks/parts/audit.py` tests the limits on recordings that were left out when choosing them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from recon.check.audited import AuditedPoints, Measure
from recon.check.codes import finding, sort_findings
from recon.check.pose_checks import measure_poses
from recon.check.track_checks import measure_tracks
from recon.fit.result import Finding

LIMITS: Mapping[str, float] = {
    "detections_repeated": 0.5,
    "detections_frozen": 1.5,
    "points_identical": 1.0,
    "point_frozen": 4.5,
    "points_interpolated": 2.5,
    "points_jump": 1.0,
    "frames_dropped": 3.0,
    "keypoints_normalised": 0.5,
    "keypoints_y_up": 0.5,
    "sides_swap": 15.0,
    "sides_exchanged": 0.6,
    "lengths_change": 3.5,
    "lengths_drift": 1.0,
    "unit_unlikely": 1.0,
    "up_unlikely": 0.5,
    "gravity_unlikely": 1.0,
    "feet_slide": 1.0,
    "joint_beyond_range": 1.0,
}
"""Value of each check's measure above which a finding is reported, with the check's code as the key."""
TRACKS_ONLY = ("keypoints_normalised", "keypoints_y_up")
"""Codes of the checks that apply only to 2D keypoints."""
POSES_ONLY = (
    "sides_exchanged",
    "lengths_change",
    "lengths_drift",
    "unit_unlikely",
    "up_unlikely",
    "gravity_unlikely",
    "feet_slide",
    "joint_beyond_range",
)
"""Codes of the checks that apply only to 3D poses."""
CONSEQUENCES: Mapping[str, tuple[str, ...]] = {
    "detections_repeated": ("detections_frozen", "point_frozen", "frames_dropped", "points_interpolated"),
    "detections_frozen": ("point_frozen", "frames_dropped", "points_identical"),
    "keypoints_normalised": ("keypoints_y_up",),
    "unit_unlikely": ("gravity_unlikely", "feet_slide"),
    "up_unlikely": ("gravity_unlikely", "feet_slide", "sides_exchanged", "joint_beyond_range"),
    "sides_exchanged": ("joint_beyond_range",),
    "points_interpolated": ("lengths_change",),
    "points_jump": ("lengths_change", "joint_beyond_range"),
    "sides_swap": ("lengths_change", "joint_beyond_range", "points_jump"),
    "points_identical": ("lengths_change", "joint_beyond_range"),
    "point_frozen": ("lengths_change", "joint_beyond_range"),
}
"""Codes of the consequences of each fault, by the fault's code. They are not reported in addition to the fault."""
MIN_FRAMES = 5
"""Minimum number of frames in a file that can be audited."""


def audit(points: AuditedPoints) -> tuple[Finding, ...]:
    """Return the findings of all checks on the points of a file, the most serious first."""
    suspicious = [measure for measure in measures_of(points) if measure.value > LIMITS[measure.code]]
    explained = {code for measure in suspicious for code in CONSEQUENCES.get(measure.code, ())}
    return sort_findings([_as_finding(points, measure) for measure in suspicious if measure.code not in explained])


def measures_of(points: AuditedPoints) -> list[Measure]:
    """Return the measures of all checks that apply to the points and can be computed."""
    if len(points.frames) < MIN_FRAMES or not points.known.any():
        return []
    with np.errstate(invalid="ignore"):
        measures = [*measure_tracks(points), *(measure_poses(points) if points.in_space else ())]
    return [measure for measure in measures if np.isfinite(measure.value)]


def _as_finding(points: AuditedPoints, measure: Measure) -> Finding:
    frames = None
    if measure.rows is not None:
        first, stop = measure.rows
        frames = (int(points.frames[first]), int(points.frames[stop - 1]) + 1)
    numbers = {**measure.numbers, "measure": measure.value, "limit": LIMITS[measure.code]}
    return finding(measure.code, frames, None, **numbers)
