"""Where cameras stand, from the animal alone: `recon calibrate extrinsics`.

    python benchmarks/extrinsics.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`, with all cameras, their lenses, and nothing of where they stand. Relative
rotations of all pairs of cameras beside the file's, the upward direction, and how far the cameras are from the first
one; MPJPE over all 24 joints, each pose's middle taken off, after one rotation of the world. Where the detector's
keypoints lie is measured in the other runs. Without FOLDER: the cheetah-runs of $RECON_SHARED_DATA, or of
../shared/data. One thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace
from itertools import combinations

import numpy as np
from cameras import PRIOR, Run, as_seen, cameras_of, errors, runs_given
from markdown_table import print_table
from scipy.spatial.transform import Rotation
from trajectory import body_of, prior_of

from recon.clip import still_view
from recon.solve.extrinsics import solve_extrinsics


def row_of(run: Run, runs: list[Run]) -> dict:
    views = [run.views[camera] for camera in cameras_of(run)["all"]]
    lenses = [replace(view.camera, rotation=None, translation_m=None) for view in views]
    bare = [still_view(lens, view.xy_px, view.confidence) for lens, view in zip(lenses, views, strict=True)]
    body = as_seen(body_of(run.subject), run, runs)
    found = solve_extrinsics(bare, body, prior_of(PRIOR), run.fps)
    apart = []
    for (a, own_a), (b, own_b) in combinations(zip(found.views, views, strict=True), 2):
        turns = [(v.T_camera_world @ np.linalg.inv(w.T_camera_world))[:3, :3] for v, w in ((a, b), (own_a, own_b))]
        apart.append(np.degrees(Rotation.from_matrix(turns[0] @ turns[1].T).magnitude()))
    far, own_far = (
        np.array([np.linalg.norm(view.centre_m[0] - of[0].centre_m[0]) for view in of[1:]])
        for of in (found.views, views)
    )
    up, own_up = (of[0].T_camera_world[:3, 2] for of in (found.views, views))
    turned = replace(found, joints_m=found.joints_m @ _world_turn(found.views, views).T)
    sigma = found.placing_sigma[1:]
    return {
        "run": run.folder.name[:28],
        "rotation of pairs, median": f"{np.median(apart):.1f}°",
        "worst": f"{np.max(apart):.1f}°",
        "stated": f"{np.degrees(np.median(sigma[:, :3])):.1f}°",
        "up": f"{np.degrees(np.arccos(np.clip(up @ own_up, -1, 1))):.1f}°",
        "distances": f"{np.mean(far / own_far - 1):+.1%}",
        "MPJPE mm": errors(run, turned)["mpjpe_mm"],
    }


def _world_turn(found, views) -> np.ndarray:
    """The rotation of the found world that brings all cameras nearest to where they look in the file's."""
    turns = [own.T_camera_world[:3, :3].T @ view.T_camera_world[:3, :3] for view, own in zip(found, views, strict=True)]
    return Rotation.from_matrix(turns).mean().as_matrix()


def main() -> None:
    runs = runs_given(__doc__)
    found = [row_of(run, runs) for run in runs]
    print_table(list(found[0]), [[f"{v:.1f}" if isinstance(v, float) else v for v in row.values()] for row in found])


if __name__ == "__main__":
    main()
