"""Measure the error of one camera while keypoints, noise, frame rate and distance change one by one.

    python benchmarks/parts/one_camera.py [FOLDER] [--only WORD]

The motions come from the runs in FOLDER, by default the cheetah-runs of $RECON_SHARED_DATA. A simulated camera (60
degrees, 1920 x 1080) stands at the side of the middle of each run. Except for the condition that a row changes, there
are all keypoints, 3 px of noise, the run's own frame rate and a distance of 12 m. The fits use the lengths of the
expected animal and the built-in prior, which was learned from the same runs. They know nothing else about the truth.
MPJPE is the mean distance of the joints, both poses centred, and PA-MPJPE is the mean distance after the best rotation
and scale of each frame. "distance" is the relative error of the mean distance from the camera.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_or_exit
from markdown_table import print_table
from recordings import meta_of
from trajectory import PRIOR, SIMULATED_CAMERA, body_of, prior_of, truth_of

from recon.clip import View
from recon.fit.trajectory import solve_trajectory
from recon.gait.evaluation import aligned, joint_errors
from recon.geometry.frames import rigid
from recon.testing.cameras import aim_camera, make_view

PAWS = ("l_front_paw", "r_front_paw", "l_back_paw", "r_back_paw")
TRUNK = ("nose", "neck_base", "spine", "tail_base", "l_shoulder", "r_shoulder", "l_hip", "r_hip")
LEFT_OUT_ABOVE = ("l_eye", "r_eye", "tail1", "tail2")


@dataclass(frozen=True)
class Condition:
    """Conditions of a simulated clip of one camera."""

    name: str
    keypoints: tuple[str, ...] | None = None
    """Names of the detected keypoints; None for all."""
    noise_px: float = 3.0
    every: int = 1
    """Number of frames out of which one is kept."""
    distance_m: float = 12.0


CONDITIONS = (
    Condition("24 keypoints, 3 px, every frame, 12 m"),
    Condition("20 keypoints: without eyes and tail", tuple(m for m in body_of().markers if m not in LEFT_OUT_ABOVE)),
    Condition("12 keypoints: trunk and paws", (*TRUNK, *PAWS)),
    Condition("8 keypoints: trunk", TRUNK),
    *(Condition(f"noise of {px:g} px", noise_px=px) for px in (1.0, 6.0, 12.0)),
    *(Condition(f"one frame in {every}", every=every) for every in (2, 4, 8)),
    *(Condition(f"{distance_m:g} m away", distance_m=distance_m) for distance_m in (6.0, 24.0, 48.0)),
)


def view_of_run(points_m: np.ndarray, condition: Condition) -> View:
    """Simulate the detections of a camera at the side of the middle of a run."""
    markers = body_of().markers
    middle_m, path_m = points_m.mean(axis=(0, 1)), points_m.mean(axis=1)
    along = path_m[-1, :2] - path_m[0, :2]
    along /= np.linalg.norm(along)
    centre_m = middle_m + condition.distance_m * np.array([along[1], -along[0], 0.0]) + [0.0, 0.0, 0.5]
    camera = aim_camera(SIMULATED_CAMERA, centre_m, middle_m)
    assert camera.rotation is not None
    assert camera.translation_m is not None
    view = make_view(camera, points_m, rigid(camera.rotation, camera.translation_m), condition.noise_px)
    is_kept = np.isin(markers, markers if condition.keypoints is None else condition.keypoints)
    is_seen = is_kept & camera.in_image(view.xy_px)
    xy_px = np.where(is_seen[..., None], view.xy_px, np.nan)
    return replace(view, xy_px=xy_px, confidence=is_seen.astype(float))


def errors(run: Path, condition: Condition) -> tuple[float, float, float, float]:
    """Fit a simulated clip, and return its errors.

    Returns
    -------
    tuple
        MPJPE and PA-MPJPE, mm; the relative error of the distance; and the fraction of frames with a pose.
    """
    truth_m = truth_of(run)
    truth_m = truth_m[np.isfinite(truth_m).all(axis=(1, 2))][:: condition.every]
    view, fps = view_of_run(truth_m, condition), meta_of(run)["fps"] / condition.every
    solution = solve_trajectory([view], body_of(), prior_of(PRIOR), fps)
    posed = solution.posed
    if not posed.any():
        return np.nan, np.nan, np.nan, 0.0
    joints_m, true_m = solution.joints_m[posed], truth_m[posed]
    mpjpe = joint_errors(aligned(joints_m, true_m), true_m).mean()
    similar = joint_errors(aligned(joints_m, true_m, scale=True, turn=True), true_m).mean()
    distance_m, true_distance_m = (
        np.linalg.norm(points.mean(axis=1) - view.centre_m[posed], axis=1).mean() for points in (joints_m, true_m)
    )
    return 1000 * float(mpjpe), 1000 * float(similar), float(distance_m / true_distance_m - 1), float(posed.mean())


def main() -> None:
    """Print the median errors over the runs for each condition."""
    parser = parser_of(__doc__, kind="cheetah-runs")
    parser.add_argument("--only", default="", help="only conditions whose names contain this text")
    options = parser.parse_args()
    runs, rows = runs_or_exit(parser, options.folder), []
    for condition in CONDITIONS:
        if options.only in condition.name:
            by_run = np.array([errors(run, condition) for run in runs])
            mpjpe, similar, distance, posed = by_run.T
            rows.append(
                [
                    *(condition.name, f"{np.nanmedian(mpjpe):.0f} (to {np.nanmax(mpjpe):.0f})"),
                    *(f"{np.nanmedian(similar):.0f}", f"{np.nanmedian(np.abs(distance)):.0%}", f"{posed.mean():.0%}"),
                ]
            )
    print_table(
        ["changed", "MPJPE mm (worst run)", "PA-MPJPE mm", "error of the mean distance", "frames with a pose"], rows
    )


if __name__ == "__main__":
    main()
