"""Where cameras stand, from the animal alone: views of one clip whose cameras have a lens and no pose.

1. Each view is solved by itself, which gives the joints in its own camera's frame, in metres of the animal's lengths.
2. The rigid motion that takes one camera's joints to the first one's, over all joints and frames, robustly, is where
   that camera stands beside the first one.
3. The views are solved together, the poses of all but the first being unknowns that hardly anything is expected of
   (`TrajectoryOptions.refine_cameras`); then again from there, the first camera's tilt and roll unknown as well. Up is
   where the ground under the feet, the animal's climb and its upright posture say.

The scale is the animal's: its size is held at that of the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.arrays import Array
from recon.body import Body
from recon.clip import View
from recon.frames import level_from_camera, rigid
from recon.prior import MotionPrior
from recon.progress import Progress, silent
from recon.solve.result import TrajectorySolution
from recon.solve.setting import TrajectoryOptions
from recon.solve.trajectory import solve_trajectory

_PLACING_RAD, _PLACING_M = float(np.radians(10.0)), 1.0
"""How far off the first poses are, about each axis and along it."""
_LEVEL_RAD = float(np.radians(5.0))
"""How far the first camera is from level, about each axis."""
_SIZE_SIGMA, _MIN_FRAMES = 1e-3, 5


class TooLittleInCommonError(ValueError):
    """A view, by its number, that has fewer frames with a pose in common with the first than `_MIN_FRAMES`."""

    def __init__(self, view: int) -> None:
        super().__init__(f"view {view} has fewer than {_MIN_FRAMES} frames in common with the first")
        self.view = view


def solve_extrinsics(
    views: Sequence[View],
    body: Body,
    prior: MotionPrior,
    fps: float,
    options: TrajectoryOptions | None = None,
    progress: Progress = silent,
) -> TrajectorySolution:
    """The motion and the poses, in the solution's views; each given view stands in a world of its own, level under its
    camera. `placing_sigma` of the solution says how well the poses are known beside the first.

    Raises TooLittleInCommonError.
    """
    options = replace(
        options or TrajectoryOptions(),
        refine_cameras=True,
        placing_rad=_PLACING_RAD,
        placing_m=_PLACING_M,
        size_sigma=_SIZE_SIGMA,
    )
    steps, in_camera = len(views) + 2, []
    for view in views:
        alone = solve_trajectory([view], body, prior, fps, options, ground_near_zero=False)
        in_camera.append(alone.joints_camera_m)
        progress("each camera", len(in_camera) / steps)
    first = level_from_camera(views[0].camera.up)
    placed = [replace(views[0], T_camera_world=rigid(first.T, np.zeros(3)))]
    for i, joints_m in enumerate(in_camera[1:], start=1):
        T_other_first = _aligned(in_camera[0], joints_m)
        if T_other_first is None:
            raise TooLittleInCommonError(i)
        placed.append(replace(views[i], T_camera_world=T_other_first @ placed[0].T_camera_world))
    solution = solve_trajectory(placed, body, prior, fps, options, ground_near_zero=False)
    progress("all cameras", (len(views) + 1) / steps)
    leads = [view.lead_frames for view in views]
    again = [replace(view, lead_frames=lead) for view, lead in zip(solution.views, leads, strict=True)]
    tilted = replace(options, level_rad=_LEVEL_RAD)
    return solve_trajectory(again, body, prior, fps, tilted, ground_near_zero=False)


def _aligned(a_m: Array, b_m: Array) -> Array | None:
    """T (4, 4) that takes points (T, J, 3) to others as well as can be, those far off counting less; NaN where a frame
    has none. None with too few frames in common."""
    common = np.isfinite(a_m[:, 0, 0]) & np.isfinite(b_m[:, 0, 0])
    if common.sum() < _MIN_FRAMES:
        return None
    a, b = (points[common].reshape(-1, 3) for points in (a_m, b_m))
    weight, R, t = np.ones(len(a)), np.eye(3), np.zeros(3)
    for _ in range(30):
        share = weight / weight.sum()
        from_a, from_b = a - share @ a, b - share @ b
        u, _, vt = np.linalg.svd((share[:, None] * from_b).T @ from_a)
        R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        t = share @ b - R @ (share @ a)
        off = np.linalg.norm(a @ R.T + t - b, axis=1)
        weight = 1.0 / (1.0 + (off / max(float(np.median(off)), 1e-6)) ** 2)
    return rigid(R, t)


def above_ground(solution: TrajectorySolution) -> tuple[View, ...]:
    """The views, in a world that is moved so that z = 0 is the ground below the middle of the animal's path, and the
    first camera above its origin; without ground, in the first camera."""
    spells = [spell for spell in solution.spells if spell.ground is not None]
    origin = solution.views[0].centre_m[0].copy()
    if spells:
        spell = max(spells, key=lambda one: one.rows.stop - one.rows.start)
        assert spell.ground is not None
        middle = np.nanmean(solution.states[spell.rows, :2], axis=0)
        origin[2] = spell.ground.height_m + spell.ground.slope @ middle
    T_world_moved = rigid(np.eye(3), origin)
    return tuple(replace(view, T_camera_world=view.T_camera_world @ T_world_moved) for view in solution.views)
