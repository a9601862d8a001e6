"""Describe the motion of an animal on a treadmill relative to the belt.

In the belt's frame the camera and the whole laboratory move forward at the belt's speed, feet in stance are at rest,
and the body advances. A solution is moved into that frame together with its views, so that reprojections do not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from recon.base.arrays import Array
from recon.clip import View
from recon.fit.result import Solution

_Solution = TypeVar("_Solution", bound=Solution)


def belt_path_m(solution: Solution, time_s: Array, speed_m_s: float) -> Array:
    """Return the displacement (T, 3) of the laboratory relative to the belt since the first frame, metres.

    The belt is assumed to be level and to run opposite to the mean direction of the trunk.

    Parameters
    ----------
    solution
        Motion of T frames in a world with z up, metres.
    time_s
        Times, shape (T,), seconds.
    speed_m_s
        Speed of the belt, m/s.
    """
    rear, front = (solution.body.markers.index(marker) for marker in solution.body.forward)
    trunk_m = np.nanmean(solution.joints_m[:, front] - solution.joints_m[:, rear], axis=0) * [1.0, 1.0, 0.0]
    direction = trunk_m / max(float(np.linalg.norm(trunk_m)), 1e-9)
    return speed_m_s * (time_s - time_s[0])[:, None] * direction


def views_from_belt(views: Sequence[View], path_m: Array) -> tuple[View, ...]:
    """Return views whose cameras move along a path (T, 3), metres, as they do in the frame of the belt."""
    T_world_belt = np.tile(np.eye(4), (len(path_m), 1, 1))
    T_world_belt[:, :3, 3] = -path_m
    return tuple(replace(view, T_camera_world=view.T_camera_world @ T_world_belt) for view in views)


def relative_to_belt(solution: _Solution, path_m: Array) -> _Solution:
    """Return a solution in the belt's frame, in which the body and cameras move along a path (T, 3).

    The heights and slopes of ground planes stay as they are. The solution must have been found without assuming that
    feet in stance do not move.
    """
    states = solution.states.copy()
    states[:, :3] += path_m
    return replace(
        solution,
        states=states,
        joints_m=solution.joints_m + path_m[:, None],
        views=views_from_belt(solution.views, path_m),
    )
