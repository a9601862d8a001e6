"""The result of a fit: the skeleton's motion, what it was fitted to, and how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recon.camera import Camera
from recon.keypoints import CleaningReport, Keypoints
from recon.skeleton import Side, Skeleton
from recon.solve import FrameReport, Solution

Array = NDArray[np.float64]

OUTLIER_SIGMAS = 3.0
"""A detection further than this from its joint's reprojection is named an outlier."""


@dataclass(frozen=True, eq=False)
class Motion:
    """T frames of a skeleton with J joints, A free links and D unknowns.

    side: whose limbs were fitted, and side_reason why. keypoints: what was fitted, cleaned, in the order of the joints,
    all-missing for joints that the file does not have. cleaning: what happened to the file's points. file_names: all
    keypoints of the file.
    """

    skeleton: Skeleton
    camera: Camera
    side: Side
    side_reason: str
    keypoints: Keypoints
    cleaning: CleaningReport
    file_names: tuple[str, ...]
    solution: Solution

    def __post_init__(self) -> None:
        if self.keypoints.fps is None:
            raise ValueError("keypoints without a frame rate")
        if self.keypoints.names != self.names:
            raise ValueError(f"keypoints {self.keypoints.names} are not those of the joints {self.names}")

    @property
    def fps(self) -> float:
        assert self.keypoints.fps is not None
        return self.keypoints.fps

    @property
    def frames(self) -> NDArray[np.int64]:
        """(T,): frame numbers of the keypoint file."""
        return self.keypoints.frames

    @property
    def states(self) -> Array:
        """(T, D), NaN where a frame has no data."""
        return self.solution.states

    @property
    def reports(self) -> tuple[FrameReport | None, ...]:
        """One a frame, None without data."""
        return self.solution.reports

    @property
    def detected_px(self) -> Array:
        """(T, J, 2), NaN where missing."""
        return self.keypoints.xy_px

    @property
    def unused_keypoints(self) -> tuple[str, ...]:
        """Of the file, but not of the skeleton."""
        return tuple(name for name in self.file_names if name not in self.names)

    @property
    def missing_keypoints(self) -> tuple[str, ...]:
        """Of the skeleton, but not of the file."""
        return tuple(name for name in self.names if name not in self.file_names)

    @property
    def names(self) -> tuple[str, ...]:
        """(J,): the joints' keypoints, as the file calls them."""
        return self.skeleton.keypoint_names(self.side)

    @cached_property
    def time_s(self) -> Array:
        """(T,): since frame 0 of the file."""
        return self.frames / self.fps

    @cached_property
    def solved(self) -> NDArray[np.bool_]:
        """(T,): frames that have a pose."""
        return np.isfinite(self.states[:, 0])

    @cached_property
    def status(self) -> tuple[str, ...]:
        """(T,): converged, not_converged or no_data."""
        return tuple("no_data" if r is None else r.status for r in self.reports)

    @cached_property
    def joints_camera_m(self) -> Array:
        """(T, J, 3) in the camera frame, NaN without data."""
        joints = np.full((len(self.frames), len(self.skeleton.joints), 3), np.nan)
        joints[self.solved] = self.skeleton.pose(self.states[self.solved]).joints_m
        return joints

    @property
    def frame_of_reference(self) -> str:
        """ "world" where the camera file has extrinsics, otherwise "camera"."""
        return "world" if self.camera.has_extrinsics else "camera"

    @cached_property
    def joints_m(self) -> Array:
        """(T, J, 3) in the frame of reference."""
        return self.camera.camera_to_world(self.joints_camera_m) if self.camera.has_extrinsics else self.joints_camera_m

    @cached_property
    def root_m(self) -> Array:
        """(T, 3): path of the reference joint, the skeleton's root, in the frame of reference."""
        return self.joints_m[:, 0]

    @cached_property
    def reprojected_px(self) -> Array:
        """(T, J, 2): the joints in the picture, NaN without data."""
        return self.camera.project(self.joints_camera_m)[0]

    @cached_property
    def image_error_px(self) -> Array:
        """(T, J, 2): reprojected minus detected, NaN where either is missing."""
        return self.reprojected_px - self.detected_px

    @cached_property
    def distance_px(self) -> Array:
        """(T, J): distance between reprojection and detection."""
        return np.linalg.norm(self.image_error_px, axis=-1)

    @cached_property
    def sigma_px(self) -> Array:
        """(T,): standard deviation that a detection was given."""
        return np.array([np.nan if r is None else r.sigma_px for r in self.reports])

    @cached_property
    def outliers(self) -> NDArray[np.bool_]:
        """(T, J): detections that the pose does not explain."""
        return self.distance_px > OUTLIER_SIGMAS * self.sigma_px[:, None]

    @cached_property
    def angles_rad(self) -> Array:
        """(T, A): theta and phi of the links, in the order of `skeleton.angle_names`."""
        return self.states[:, : 2 * self.skeleton.n_angles]
