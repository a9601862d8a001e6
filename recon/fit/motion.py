"""Define `Motion`, the result of a fit: the motion of the animal, the data, and the uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from recon.animal.body import Body, Side, Skeleton
from recon.base.arrays import Array, Bools, Brief, Integers, mean_along, median
from recon.base.errors import InputError, Problem
from recon.clip import CleaningReport, Keypoints, Source, world_from_reference
from recon.fit.result import OUTLIER_SIGMAS, Finding, MotionSegment, Solution, TrajectorySolution, Verdict
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse, moved
from recon.geometry.kinematics import PITCH, ROOT, YAW
from recon.io.common import Pose3D

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

_T = TypeVar("_T")
MEASURED_FRACTION = 0.5
"""Minimum information fraction, 0 to 1, at which a quantity counts as measured.

More of its precision then comes from the pixels than from the prior.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Picture(Brief):
    """Detections of one camera in T frames, and the J joints of the pose in the camera's frame and pictures."""

    source: Source
    T_reference_camera: Array
    """Transform from the camera to the motion's frame of reference, (4, 4), or (T, 4, 4) for a moving camera."""
    joints_camera_m: Array
    """Joints in this camera's frame (m) at the times of its pictures, shape (T, J, 3); NaN without a pose."""
    reprojected_px: Array
    """Reprojected keypoints, px, shape (T, J, 2); NaN without a pose."""
    sigma_px: Array
    """Standard deviation that the fit assigned to each detection, px, shape (T, J)."""
    weight: Array
    """Weight of each detection, shape (T, J), 0 to 1; NaN if missing.

    In the frame method, the weight is the mean over the frame.
    """

    @property
    def camera(self) -> Camera:
        """Return the camera that took the pictures."""
        return self.source.camera

    @property
    def name(self) -> str:
        """Return the name of the camera."""
        return self.camera.name

    @property
    def detected_px(self) -> Array:
        """Return the detected keypoints in this camera's picture, px, (T, J, 2), NaN if missing."""
        return self.source.keypoints.xy_px

    @property
    def present(self) -> Bools:
        """Return a mask of the keypoints that were detected in each frame, (T, J)."""
        return self.source.keypoints.present

    @cached_property
    def image_error_px(self) -> Array:
        """Return the reprojected minus the detected positions, (T, J, 2), px; NaN if either is missing."""
        return self.reprojected_px - self.detected_px

    @cached_property
    def distance_px(self) -> Array:
        """Return the distance between reprojection and detection, (T, J), pixels."""
        return np.linalg.norm(self.image_error_px, axis=-1)

    @cached_property
    def outliers(self) -> Bools:
        """Return a mask (T, J) of the detections that are more than `OUTLIER_SIGMAS` from the reprojected joints."""
        return self.distance_px > OUTLIER_SIGMAS * self.sigma_px

    @cached_property
    def distance_m(self) -> Array:
        """Return the distance of the mean of all joints from the camera, (T,), metres."""
        return np.linalg.norm(self.joints_camera_m.mean(axis=1), axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Motion of an animal over T frames, with J joints and D unknowns, of which A are angles."""

    sources: tuple[Source, ...]
    """Keypoints of each camera, in the order of the solution's views.

    The keypoints are cleaned and in the order of the joints. Joints that a file does not have are missing in all
    frames.
    """
    side: Side | None
    """Side of the animal whose limbs were fitted, if a chain was fitted; None for both sides."""
    side_reason: str
    solution: Solution
    """Result of the fitting method, such as a `TrajectorySolution`."""
    findings: tuple[Finding, ...] = ()
    """Findings on the input and the fit (`recon.check`), the most serious first."""
    verdict: Verdict | None = None
    """Verdict on whether the motion may be used; None until `recon.check.verdict.add_verdict` is called."""
    chain: Skeleton | None = None
    """Chain (`recon.animal.chain.Chain`) from which `body` was made; None if there is none."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """All settings of the fit in JSON types.

    Paths are absolute, or relative to the results folder in a saved motion.
    """
    correction_gain_m2: Array | None = None
    """Expected decrease of the pose's mean squared error if a detection were corrected, m^2, shape (V, T, J).

    The array is None if the method cannot compute the decrease (`recon.fit.correction_gain`).
    """
    timing_s: Mapping[str, float] = field(default_factory=dict)
    """Duration of each part of the fit in seconds, keyed by its name; `solution.stage_s` has the solver's stages."""

    def __repr__(self) -> str:
        """Return one line of text with the clip, the animal and the verdict."""
        posed, level = int(self.solved.sum()), "not judged" if self.verdict is None else self.verdict.level
        return f"<Motion of {Path(self.file).name}: {self.body.name}, {posed} of {self.clip_frames} frames, {level}>"

    def _repr_html_(self) -> str:
        """Return the motion as HTML, for a notebook."""
        from recon.fit.motion_forms import html_of

        return html_of(self)

    def derived(self, make: Callable[[Motion], _T]) -> _T:
        """Return the result of a function of the motion, such as its analysis, and call the function only once."""
        if make not in self._derived:
            self._derived[make] = make(self)
        return self._derived[make]

    @cached_property
    def _derived(self) -> dict[Callable[[Motion], Any], Any]:
        return {}

    # Other forms of the motion

    def to_dataframe(self, wide: bool = False) -> pd.DataFrame:
        """Return the joints as a table, in the frame of `upright`, z up, metres, with standard deviations.

        Parameters
        ----------
        wide
            Whether the table has one row for each frame, with columns by joint and value. Otherwise it has one row for
            each frame and joint, with the columns frame, time_s, joint, x_m, y_m, z_m, x_sigma_m, y_sigma_m, z_sigma_m,
            flags.

        Returns
        -------
        pandas.DataFrame
            Positions and standard deviations; NaN in frames without a pose.
        """
        from recon.fit.motion_forms import table_of

        return table_of(self, wide)

    def to_xarray(self) -> xr.Dataset:
        """Return the joints as a poses dataset in the format of the `movement` package.

        The variables are `position` and `position_sigma` (time, space, keypoint, individual) in metres, and
        `confidence`, which is NaN. The attributes include the frame rate, the source and the verdict.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        from recon.fit.motion_forms import dataset_of

        return dataset_of(self)

    def sample(self, n: int = 100, seed: int = 0) -> Array:
        """Return motions drawn from the posterior, shape (n, T, J, 3), metres; NaN without a pose.

        Neighbouring frames and joints vary together as their errors do, and so does the size of the animal. The mean
        and the quantiles of a quantity over the draws are its estimate and its interval.

        Parameters
        ----------
        n
            Number of draws, 1 or more.
        seed
            Seed of the random numbers. The same seed gives the same draws.

        Raises
        ------
        InputError
            If n is not a whole number above 0, if the motion is from the frame method, or if the prior of the fit
            cannot be loaded by its name.
        """
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise InputError(Problem("sample", "n", repr(n), "a whole number above 0"))
        if not isinstance(self.solution, TrajectorySolution):
            raise InputError(Problem("sample", "method", "a fit frame by frame", "a fit of all frames at once"))
        from recon.fit.sampling import sample_joints

        return sample_joints(self.sources, self.solution, self.fps, self.settings, int(n), seed)

    def plot(self) -> Figure:
        """Return a matplotlib figure of the animal's poses from the side, evenly spaced over the clip.

        `figure.savefig("side.pdf")` saves the figure, and a notebook shows it.
        """
        from recon.fit.motion_forms import figure_of

        return figure_of(self)

    # Saving and loading

    def save(self, folder: str | Path) -> Path:
        """Write motion.npz into a folder and return its path.

        The file is written completely or not at all. `load` restores the motion bit for bit.
        """
        from recon.base.records import save_record
        from recon.fit.motion_forms import MOTION, SCHEMA

        save_record(self, path := Path(folder) / MOTION, SCHEMA)
        return path

    @classmethod
    def load(cls, folder: str | Path) -> Motion:
        """Return the motion saved in a folder: results of `recon fit`, or any folder given to `save`.

        Raises
        ------
        InputError
            If the folder has no motion, the motion is damaged or of another version, or the folder belongs to an
            interrupted run or to several clips.
        """
        from recon.fit.motion_forms import load

        return load(cls, Path(folder))

    def __post_init__(self) -> None:
        if self.keypoints.fps is None:
            raise ValueError("the keypoints have no frame rate")
        expected = self.body.keypoint_names(self.side)
        if self.keypoints.names != expected:
            raise ValueError(f"keypoints {self.keypoints.names} are not those of the joints {expected}")

    # The animal

    @property
    def method(self) -> str:
        """Return the fitting method, "trajectory" or "frame"."""
        return self.solution.method

    @property
    def jitters(self) -> bool:
        """Return whether each frame was solved independently.

        Paths then jitter from frame to frame, and standard deviations assume that the previous frame is exact.
        """
        return self.solution.jitters

    @property
    def body(self) -> Body:
        """Return the body that was fitted."""
        return self.solution.body

    @property
    def title(self) -> str:
        """Return the title of the skeleton as one line of text."""
        return self.body.title

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the joints in the skeleton, (J,)."""
        return self.body.markers

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the joints' keypoints in the keypoint file, (J,)."""
        return self.keypoints.names

    @property
    def limbs(self) -> dict[str, tuple[int, ...]]:
        """Return the indices of the joints along each limb, keyed by the limb's name, for drawing."""
        return self.body.limb_rows

    @property
    def size(self) -> float:
        """Return the animal's size, a factor on the body's lengths (in the frame method, the median over frames)."""
        return self.solution.size

    @cached_property
    def limb_sides(self) -> dict[str, Side | None]:
        """Return the side of each limb, keyed by the limb's name; None for a limb in the middle, such as the spine."""
        return self.body.limb_sides(self.side)

    @property
    def forward(self) -> tuple[int, int]:
        """Return the indices of the joints at the rear and at the front end of the trunk."""
        rear, front = self.body.forward
        return self.joints.index(rear), self.joints.index(front)

    @cached_property
    def trunk_m(self) -> float:
        """Return the median length (m) of the trunk over the frames, from rear to front joint; 0 without a pose."""
        rear, front = (self.solution.joints_m[self.solved, joint] for joint in self.forward)
        return float(np.median(np.linalg.norm(front - rear, axis=-1))) if len(rear) else 0.0

    @property
    def forward_names(self) -> tuple[str, str]:
        """Return the names of the keypoints of the two joints of `forward`."""
        rear, front = self.forward
        return self.names[rear], self.names[front]

    @cached_property
    def feet(self) -> tuple[int, ...]:
        """Return the indices of the feet's joints."""
        return tuple(self.joints.index(foot) for foot in self.body.feet)

    @cached_property
    def foot_labels(self) -> tuple[str, ...]:
        """Return the labels of the feet: LF, RF, LH, RH (left or right, fore or hind)."""
        return tuple(self.body.feet_by_label(self.side))

    @cached_property
    def foot_names(self) -> dict[str, str]:
        """Return the names of the feet's keypoints, keyed by the labels of the feet."""
        return {label: self.names[foot] for label, foot in zip(self.foot_labels, self.feet, strict=True)}

    @property
    def reference_joint(self) -> str:
        """Return the name of the joint that gives the animal's position: the root's, or else the trunk's rear joint."""
        return self.root_name if self.root_name in self.joints else self.body.forward[0]

    @property
    def reference(self) -> str:
        """Return the name of the reference joint's keypoint."""
        return self.names[self.joints.index(self.reference_joint)]

    # The input of the fit, mostly for the first camera

    @property
    def camera(self) -> Camera:
        """Return the camera of the first, or only, keypoint file."""
        return self.sources[0].camera

    @property
    def keypoints(self) -> Keypoints:
        """Return the detections of the first, or only, camera, after cleaning."""
        return self.sources[0].keypoints

    @property
    def file(self) -> str:
        """Return the path of the first keypoint file, or a placeholder for messages."""
        return self.keypoints.source or "keypoints"

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Return all V cameras of the clip."""
        return tuple(source.camera for source in self.sources)

    @property
    def cleaning(self) -> CleaningReport:
        """Return the report on the cleaning of the first keypoint file."""
        return self.sources[0].cleaning

    @property
    def camera_moves(self) -> bool:
        """Return whether the camera moves along a track, in a world with z up."""
        return self.sources[0].moves

    # Frames and points

    @property
    def fps(self) -> float:
        """Return the frame rate of the clip, Hz."""
        assert self.keypoints.fps is not None
        return self.keypoints.fps

    @property
    def frames(self) -> Integers:
        """Return the frame numbers (T,) in the first keypoint file, without long parts that have no detections."""
        return self.keypoints.frames

    @property
    def clip_frames(self) -> int:
        """Return the number of frames of the clip, including frames far from any detection."""
        return int(self.frames[-1] - self.frames[0]) + 1

    @cached_property
    def time_s(self) -> Array:
        """Return the time of each frame since frame 0 of the first keypoint file, (T,), seconds."""
        return self.frames / self.fps

    @cached_property
    def detections(self) -> Integers:
        """Return the number of detections of all cameras together in each frame, (T,)."""
        return np.sum([source.keypoints.present.sum(axis=1) for source in self.sources], axis=0)

    @property
    def unused_keypoints(self) -> tuple[str, ...]:
        """Return the names of the keypoints in the keypoint files that the skeleton does not have."""
        return tuple(name for name in self._file_names if name not in self.names)

    @property
    def missing_keypoints(self) -> tuple[str, ...]:
        """Return the names of the skeleton's keypoints that no keypoint file has."""
        return tuple(name for name in self.names if name not in self._file_names)

    @cached_property
    def _file_names(self) -> dict[str, None]:
        """Return the names of the keypoints in all keypoint files, in the order of the files, without duplicates."""
        return dict.fromkeys(name for source in self.sources for name in source.file_names)

    # The states

    @property
    def states_frame(self) -> Literal["world", "level"]:
        """Return the frame of reference of the root's position and rotation in `states` (`recon.geometry.frames`)."""
        return "world" if self.knows_up else "level"

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the D unknowns of a frame, with their units."""
        return self.body.state_names

    @property
    def states(self) -> Array:
        """Return the D unknowns of each frame, (T, D), in the units of `state_names`; NaN in frames without a pose."""
        return self.solution.states

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Return the names of the angles, (A,): the root's yaw, pitch and roll, then the joints' angles."""
        return self.state_names[YAW:]

    @property
    def angles_rad(self) -> Array:
        """Return the root's and the joints' angles in the order of `angle_names`, (T, A), rad."""
        return self.states[:, YAW:]

    @property
    def posture_names(self) -> tuple[str, ...]:
        """Return the names of the angles without the root's yaw, (P,), P = A - 1.

        The yaw gives the animal's heading, not its posture.
        """
        return self.state_names[PITCH:]

    @property
    def posture_rad(self) -> Array:
        """Return the angles that the prior describes, without the heading, (T, P), in rad."""
        return self.states[:, PITCH:]

    @property
    def posture_sigma_rad(self) -> Array:
        """Return the standard deviations of the posture angles, (T, P), rad."""
        return self.solution.angle_sigma_rad[:, PITCH - YAW :]

    @property
    def posture_data_share(self) -> Array:
        """Return the fraction of the posture angles' precision that comes from the pixels, (T, P), 0 to 1."""
        return self.solution.angle_data_share[:, PITCH - YAW :]

    @cached_property
    def data_shares(self) -> dict[str, float]:
        """Return the fraction of the information on each posture angle that comes from the pixels.

        The fraction is the median over the frames, NaN if it is unknown. The keys are the names of the angles.
        """
        return dict(zip(self.posture_names, map(median, self.posture_data_share.T), strict=True))

    # The world in which the motion was solved, with z up

    @cached_property
    def upright(self) -> Pose3D:
        """Return the joints in the world with z up, named as their keypoints, with limbs as edges."""
        names = self.names
        edges = [(names[a], names[b]) for limb in self.limbs.values() for a, b in pairwise(limb)]
        pose = Pose3D(names, self.solution.joints_m, self.frames)
        return replace(pose, fps=self.fps, edges=tuple(dict.fromkeys(edges)))

    @property
    def upright_sigma_m(self) -> Array:
        """Return the standard deviations of `upright` along the axes, position and size included, (T, J, 3), m."""
        return _sigmas(self.solution.covariance_m2)

    @property
    def upright_relative_sigma_m(self) -> Array:
        """Return the standard deviations of `upright` relative to the mean of all joints, (T, J, 3), m."""
        return _sigmas(self.solution.relative_covariance_m2)

    @property
    def segments(self) -> tuple[MotionSegment, ...]:
        """Return the parts of the clip with a pose, each with its ground, or the whole clip if no part has a pose."""
        return self.solution.segments or (MotionSegment(slice(0, len(self.frames)), None),)

    # The frame of reference of the camera file

    @property
    def frame_of_reference(self) -> Literal["world", "camera"]:
        """Return "world" if the camera file has extrinsics or the camera moves, otherwise "camera"."""
        return "world" if self.camera.has_extrinsics or self.camera_moves else "camera"

    @property
    def knows_up(self) -> bool:
        """Return whether the frame of reference is a world with z up."""
        return self.camera.knows_up or self.camera_moves

    @cached_property
    def T_reference_world(self) -> Array:
        """Return the transform (4, 4) from the solution's world to the frame of reference (`recon.geometry.frames`)."""
        return np.eye(4) if self.camera_moves else inverse(world_from_reference(self.camera))

    def in_reference(self, world_m: Array) -> Array:
        """Transform points (..., 3), metres, from the solution's world to the frame of reference."""
        return moved(self.T_reference_world, world_m)

    @cached_property
    def joints_m(self) -> Array:
        """Return the joints in the frame of reference, (T, J, 3), metres; NaN without a pose."""
        return self.in_reference(self.solution.joints_m)

    @property
    def joints_camera_m(self) -> Array:
        """Return the joints in the first camera's frame, (T, J, 3), metres; NaN without a pose."""
        return self.solution.joints_camera_m

    @cached_property
    def solved(self) -> Bools:
        """Return a mask of the frames that have a pose, (T,)."""
        return self.solution.posed

    @property
    def root_name(self) -> str:
        """Return the name of the marker at the root's origin, or of the root segment if no marker is there."""
        root = self.body.tree.segments[0].name
        return next((m.name for m in self.body.tree.markers if m.segment == root and not any(m.offset_m)), root)

    @cached_property
    def root_m(self) -> Array:
        """Return the origin of the root in the frame of reference, (T, 3), metres."""
        return self.in_reference(self.states[:, ROOT])

    def below_m(self, segment: MotionSegment) -> Array | None:
        """Return the ground point below the middle of the root's path in the world, shape (3,), m; None if unknown."""
        xy_m = self.states[segment.rows, :2]
        xy_m = xy_m[np.isfinite(xy_m[:, 0])]
        if segment.ground is None or not len(xy_m):
            return None
        middle = xy_m.mean(axis=0)
        return np.append(middle, segment.ground.height_m + segment.ground.slope @ middle)

    # Pictures

    @cached_property
    def pictures(self) -> tuple[Picture, ...]:
        """Return the detections and the reprojected pose of each camera, in the order of the sources."""
        solution = self.solution
        pictures = []
        for source, view, *rest in zip(self.sources, solution.views, solution.noise_px, solution.weight, strict=True):
            pixels, _ = view.project(view.shift_to_exposure(solution.markers_m))
            if source.poses is not None:
                pixels = np.where(source.poses.known[:, None, None], pixels, np.nan)
            T_reference_camera = self.T_reference_world @ inverse(view.T_camera_world)
            joints_m = view.to_camera(view.shift_to_exposure(solution.joints_m))
            pictures.append(Picture(source, T_reference_camera, joints_m, pixels, *rest))
        return tuple(pictures)

    # Uncertainty

    @property
    def flags(self) -> tuple[tuple[str, ...], ...]:
        """Return the flags of each frame, (T,).

        In a frame without a pose, a flag gives the reason.
        """
        return self.solution.flags

    @property
    def alternative_m(self) -> Array:
        """Return the mean distance between the joints of the two best solutions, both centred, shape (T,), m.

        The distance is NaN in frames without a second solution.
        """
        return self.solution.alternative_m

    @property
    def joint_sigma_m(self) -> Array:
        """Return the joints' standard deviations in the frame of reference with position and size, (T, J, 3), m."""
        return _sigmas(self._turned(self.solution.covariance_m2))

    def relative_covariance_m2(self, rows: slice = slice(None)) -> Array:
        """Return the covariances (T, J, 3, 3) in m^2 of the joints relative to their mean, in the frames `rows`."""
        return self._turned(self.solution.relative_covariance_m2[rows])

    @property
    def relative_sigma_m(self) -> Array:
        """Return the standard deviations of the joints' positions relative to their mean, (T, J, 3), m."""
        return _sigmas(self.relative_covariance_m2())

    @cached_property
    def relative_rms_m(self) -> Array:
        """Return the expected RMS error of the joints' positions relative to their mean, (T,), m."""
        return np.sqrt(np.trace(self.solution.relative_covariance_m2, axis1=2, axis2=3).mean(axis=1))

    @cached_property
    def place_sigma_m(self) -> Array:
        """Return the standard deviation of the mean of all joints along the first camera's line of sight, (T,), m."""
        # Each joint is the mean plus an offset. The offsets sum to zero, so the averages of the two covariances differ
        # by the covariance of the mean.
        mean_covariance = (self.solution.covariance_m2 - self.solution.relative_covariance_m2).mean(axis=1)
        ray = self.solution.joints_m.mean(axis=1) - self.solution.views[0].centre_m
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        return np.sqrt(np.maximum(np.einsum("ta,tab,tb->t", ray, mean_covariance, ray), 0.0))

    @cached_property
    def mean_weight(self) -> Array:
        """Return the mean weight of all cameras' detections, (T,), 0 to 1; NaN without detections or without a pose."""
        return mean_along(self.solution.weight, (0, 2))

    def _turned(self, covariance_m2: Array) -> Array:
        R = self.T_reference_world[:3, :3]
        return R @ covariance_m2 @ R.T


def trajectory_solution(motion: Motion) -> TrajectorySolution:
    """Return the solution of a motion that was fitted by the trajectory method."""
    assert isinstance(motion.solution, TrajectorySolution)
    return motion.solution


def _sigmas(covariance: Array) -> Array:
    """Return the standard deviations (..., 3) along the axes from covariances (..., 3, 3)."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
