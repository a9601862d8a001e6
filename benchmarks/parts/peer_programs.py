"""Triangulate keypoints with aniposelib and Pose2Sim, in a separate environment.

    build/peers/bin/python benchmarks/parts/peer_programs.py FOLDER [aniposelib] [pose2sim]

`peer_runs.py` creates the environment and runs this script with its Python, so nothing of recon is imported here. Each
in_NUMBER.npz in FOLDER has pixels without lens distortion (C, T, K, 2), the cameras' focal lengths (C,) and poses as
rotation vectors and translations (C, 3), the frame rate, pairs of keypoints with a constant distance (N, 2), and
recon's triangulation: positions (T, K, 3), and a mask (C, T, K) of the detections that were used. out_NUMBER.npz gets
the positions (T, K, 3) of each program, NaN if unknown, and its processor time in seconds.
"""

from __future__ import annotations

import logging
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pandas as pd


def by_aniposelib(given: dict[str, np.ndarray]) -> np.ndarray:
    """Triangulate by aniposelib's optimiser from the detections that recon's triangulation uses.

    aniposelib's own robust subsets try all subsets of cameras for each point, which takes minutes for half a second of
    six cameras.
    """
    from aniposelib.cameras import Camera, CameraGroup  # pyright: ignore[reportMissingImports]

    cameras = [
        Camera(matrix=np.diag([focal_px, focal_px, 1.0]), dist=np.zeros(5), rvec=rvec, tvec=tvec)
        for focal_px, rvec, tvec in zip(given["focal_px"], given["rvecs"], given["tvecs"], strict=True)
    ]
    points = np.where(given["is_used"][..., None], given["points"], np.nan)
    return CameraGroup(cameras).optim_points(points, given["start_m"], constraints=given["bones"].tolist())


def by_pose2sim(given: dict[str, np.ndarray]) -> np.ndarray:
    """Triangulate by Pose2Sim, which leaves out outlying cameras, fills gaps, and fits splines.

    The settings are taken from Pose2Sim's demo, except that the filter is a spline that chooses its own smoothness. The
    demo's cut-off of 6 Hz suits a walking person.
    """
    from Pose2Sim.common import interpolate_zeros_nans  # pyright: ignore[reportMissingImports]
    from Pose2Sim.filtering import filter1d, hampel_filter  # pyright: ignore[reportMissingImports]
    from Pose2Sim.triangulation import triangulation_from_best_cameras  # pyright: ignore[reportMissingImports]

    settings = {"filtering": {"gcv_spline": {"cut_off_frequency": "auto", "smoothing_factor": 1.0}}}
    projections = []
    for focal_px, rvec, tvec in zip(given["focal_px"], given["rvecs"], given["tvecs"], strict=True):
        pose = np.column_stack([cv2.Rodrigues(rvec)[0], tvec])
        projections.append(np.diag([focal_px, focal_px, 1.0]) @ pose)
    _, T, K, _ = given["points"].shape
    positions_m = np.full((T, K, 3), np.nan)
    for t in range(T):
        for k in range(K):
            pixels = given["points"][:, t, k]
            seen = np.where(np.isfinite(pixels[:, 0]), 1.0, np.nan)
            detections = np.array([*pixels.T, seen])
            if np.isfinite(seen).sum() >= 2:
                positions_m[t, k] = triangulation_from_best_cameras(settings, detections, detections, projections, {})[
                    0
                ]
    columns = pd.DataFrame(positions_m.reshape(T, -1))
    columns = columns.apply(interpolate_zeros_nans, axis=0, args=[20, "linear"])
    columns = columns.apply(hampel_filter, axis=0)
    columns = columns.apply(filter1d, axis=0, args=[settings, "gcv_spline", float(given["fps"])])
    return columns.to_numpy().reshape(T, K, 3)


PROGRAMS = {"aniposelib": by_aniposelib, "pose2sim": by_pose2sim}


def main() -> None:
    """Run each program on each clip, after a short run of aniposelib that compiles its functions."""
    logging.disable(logging.CRITICAL)
    folder = Path(sys.argv[1])
    for number, path in enumerate(sorted(folder.glob("in_*.npz"))):
        with np.load(path) as archive:
            given = dict(archive)
        if number == 0:
            short = {name: given[name][:, :12] for name in ("points", "is_used")} | {"start_m": given["start_m"][:12]}
            by_aniposelib({**given, **short})
        results = {}
        for name in sys.argv[2:] or PROGRAMS:
            began = time.process_time()
            results[name] = PROGRAMS[name](given)
            results[f"{name}_s"] = np.array(time.process_time() - began)
        np.savez(folder / path.name.replace("in_", "out_"), **results)


if __name__ == "__main__":
    main()
