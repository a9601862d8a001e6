"""Decide whether the camera poses that a fit has refined are used, and report the changes."""

from __future__ import annotations

import numpy as np

from recon.check.codes import finding
from recon.check.sights import error_ratio_of_pair, sights_of
from recon.fit import constants
from recon.fit.result import Finding, TrajectorySolution

UNCHANGED_FACTOR = 1.1
"""Ratio of a camera's median reprojection errors after and before refinement, up to which it fits no worse.

The errors of some cameras may increase a little while those of another camera decrease.
"""
BETTER_FACTOR = 1.02
"""Ratio of a camera's median reprojection errors before and after refinement, above which the camera fits better."""
OUTLIER_FACTOR = 5.0
"""Ratio of a camera's reprojection error to the median over all cameras, above which the whole camera is an outlier."""
MAX_ROTATION_FACTOR = 4.0
"""Ratio of a camera's rotation to the expected error of calibrations, above which its refined pose is not plausible."""


def why_not_refined(
    refined: TrajectorySolution,
    fixed: TrajectorySolution,
    better_below_rad: float = np.inf,
    *,
    may_fit_worse: bool = False,
) -> tuple[Finding, ...]:
    """Return findings on why the calibrated camera poses are kept, or () if the refined poses are to be used.

    Refined poses can be wrong, because a robust cost also decreases if all detections of a camera become outliers. If
    no camera fits better, the refined poses are only less certain.

    Parameters
    ----------
    refined, fixed
        Solutions with refined and with calibrated poses.
    better_below_rad
        Rotation above which refined poses are used even if no camera fits better, because a wrong size of the animal
        can hide the improvement.
    may_fit_worse
        Whether the calibrated poses may fit better for another reason. If so, a camera that fits worse with the refined
        poses is a reason against them only if the whole camera becomes an outlier.
    """
    fixed_px, refined_px = _medians_px(fixed), _medians_px(refined)
    names, turns_rad = [v.camera.name for v in fixed.views], np.linalg.norm(refined.extrinsic_correction[:, :3], axis=1)
    growth = OUTLIER_FACTOR if may_fit_worse else UNCHANGED_FACTOR
    lost = (refined_px > growth * fixed_px) | (refined_px > OUTLIER_FACTOR * np.median(refined_px))
    worst_lost, most_turned = int(np.argmax(lost * refined_px / fixed_px)), int(np.argmax(turns_rad))
    if lost[worst_lost]:
        return (
            finding(
                "cameras_not_refined",
                camera=names[worst_lost],
                before_px=fixed_px[worst_lost],
                after_px=refined_px[worst_lost],
            ),
        )
    if turns_rad[most_turned] > MAX_ROTATION_FACTOR * constants.CAMERA_ROTATION_RAD:
        return (
            finding(
                "camera_left_its_pose", camera=names[most_turned], turn_deg=float(np.degrees(turns_rad[most_turned]))
            ),
        )
    if turns_rad[most_turned] <= better_below_rad and not (fixed_px > BETTER_FACTOR * refined_px).any():
        return (finding("cameras_as_calibrated"),)
    return ()


def rays_meet_worse(refined: TrajectorySolution, fixed: TrajectorySolution) -> bool:
    """Return whether the rays of two cameras meet clearly worse with their refined poses.

    If a camera was turned or moved, its rays meet better with the right pose. If they meet worse, the animal has other
    proportions than the skeleton, and the fit has turned a camera to explain the pictures.

    The error ratio of the rays may increase by `UNCHANGED_FACTOR`. It increases by a factor of at most 1.02 for seven
    pairs of real cameras, and of 1.2 if two exact cameras are turned to explain an animal of other proportions.
    """
    # Only the two error ratios are compared, so the noise to which both refer does not matter.
    fixed_ratio, refined_ratio = (
        error_ratio_of_pair(*sights_of(solution.views, sigma_px=1.0, keypoint_sigma_m=0.0))[0]
        for solution in (fixed, refined)
    )
    return refined_ratio > UNCHANGED_FACTOR * fixed_ratio


def pair_is_turned(refined: TrajectorySolution) -> bool:
    """Return whether one of two refined cameras is turned by more than twice the usual error of a calibration."""
    return bool(np.linalg.norm(refined.extrinsic_correction[:, :3], axis=1).max() > 2.0 * constants.CALIBRATED_RAD)


def pair_refined(refined: TrajectorySolution, is_misplaced: bool) -> Finding:
    """Return the finding on two cameras whose poses were refined although the user did not request this.

    The finding names the camera that was turned more. It is a warning if a camera has probably been turned
    or moved (`is_misplaced`), otherwise a note.
    """
    turns_rad, shifts_m = np.linalg.norm(refined.extrinsic_correction.reshape(-1, 2, 3), axis=-1).T
    most_turned = int(np.argmax(turns_rad))
    cameras = tuple(view.camera.name for view in refined.views)
    return finding(
        "pair_refined" if is_misplaced else "pair_adjusted",
        camera=cameras[most_turned],
        cameras=cameras,
        turn_rad=float(turns_rad[most_turned]),
        shift_m=float(shifts_m[most_turned]),
    )


def _medians_px(solution: TrajectorySolution) -> np.ndarray:
    """Return the median distance between detections and reprojected markers for each camera, pixels, shape (V,).

    The distance is infinite if most detections are in frames without a pose, and 1 without detections.
    """
    medians = []
    for view in solution.views:
        pixels, _ = view.project(view.shift_to_exposure(solution.markers_m))
        distances = np.linalg.norm(pixels - view.xy_px, axis=-1)[view.present]
        distances = np.where(np.isfinite(distances), distances, np.inf)
        medians.append(float(np.median(distances)) if distances.size else 1.0)
    return np.maximum(medians, 1e-9)
