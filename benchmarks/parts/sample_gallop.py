"""Test the frame method on the simulated gallop, without noise at three headings and with noise from five seeds.

python benchmarks/parts/sample_gallop.py
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.animal.body import MIN_JOINTS
from recon.clip import still_view
from recon.fit.result import OUTLIER_SIGMAS
from recon.testing.gallop import SyntheticClip, add_noise, gallop
from recon.thesis.chain import load_chain
from recon.thesis.objectives import FrameOptions
from recon.thesis.solver import solve_frames

SKELETON = load_chain("cheetah-8u")
CLEAN = FrameOptions(sigma_px=1.0, keypoint_sigma_m=0.0, base_sigma_m=0.001)
NOISY = FrameOptions(sigma_px=2.0, keypoint_sigma_m=0.0)
DEFAULT = FrameOptions()


def fit(clip: SyntheticClip, keypoints, options: FrameOptions, outliers: np.ndarray | None = None) -> list[str]:
    """Fit a clip by the frame method, and return the cells of a table row, such as errors and time per frame."""
    columns = [keypoints.names.index(name) for name in SKELETON.body.keypoint_names(clip.side)]
    xy, confidence = keypoints.xy_px[:, columns], keypoints.confidence[:, columns]
    fps = clip.keypoints.fps or 30.0
    solution = solve_frames(still_view(clip.camera, xy, confidence), SKELETON, fps, options)
    reports = [r for r in solution.reports if r is not None]
    joints = SKELETON.pose(solution.chain_states).joints_m
    truth = clip.camera.world_to_camera(clip.truth_m[:, columns])
    off = (joints - joints.mean(1, keepdims=True)) - (truth - truth.mean(1, keepdims=True))
    distance = np.linalg.norm(clip.camera.project(joints)[0] - xy, axis=2)
    named = "-"
    if outliers is not None:
        sigma = np.array([np.nan if r is None else r.sigma_px for r in solution.reports])[:, None]
        wrong = outliers[:, columns] & (np.linalg.norm(clip.camera.project(truth)[0] - xy, axis=2) > 20)
        named = f"{np.sum(wrong & (distance > OUTLIER_SIGMAS * sigma))} of {np.sum(wrong)}"
    frame = np.nanmean(distance[np.isfinite(distance).any(axis=1)], axis=1)
    return [
        f"{sum(r.status == 'converged' for r in reports)} of {np.sum(np.isfinite(xy[..., 0]).sum(1) >= MIN_JOINTS)}",
        f"{np.nanmax(frame):.2f}",
        f"{np.nanmean(frame):.2f}",
        f"{1000 * np.nanmean(np.linalg.norm(off, axis=2)):.1f}",
        f"{1000 * np.nanmax(np.linalg.norm(off, axis=2).mean(axis=1)):.0f}",
        f"{1000 * np.nanmean(np.linalg.norm(joints - truth, axis=2)):.0f}",
        named,
        f"{1000 * np.median([r.solve_s for r in reports]):.1f}",
    ]


def main() -> None:
    print("| clip | settings | converged | worst frame px | mean px | MPJPE mm | worst frame mm | MPE mm "
          "| outliers > 20 px named | ms per frame |")  # fmt: skip
    print("|" + " --- |" * 10)
    for heading in (0.0, 0.35, 0.6):
        clip = gallop(heading_rad=heading)
        for label, options in (
            ("noise 1 px, base known", CLEAN),
            ("the same, no Gaussian priors", replace(CLEAN, angle_prior="none")),
            ("the same, no Gaussian priors, printed form", replace(CLEAN, angle_prior="none", form="printed")),
            ("defaults", DEFAULT),
        ):
            print(
                "| " + " | ".join([f"clean, heading {heading} rad", label, *fit(clip, clip.keypoints, options)]) + " |"
            )
    for clip in (gallop(), gallop(camera_model="fisheye", direction="left")):
        for seed in range(5):
            keypoints, wrong = add_noise(clip.keypoints, seed=seed)
            for label, options in (("noise 2 px", NOISY), ("defaults", DEFAULT)):
                row = fit(clip, keypoints, options, wrong)
                print(
                    "| "
                    + " | ".join([f"noisy {clip.camera.model} to the {clip.side}, seed {seed}", label, *row])
                    + " |"
                )


if __name__ == "__main__":
    main()
