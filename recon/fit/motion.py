"""The result of a fit: the animal's motion, what it was fitted to, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from recon.animal.body import Body, Side, Skeleton
from recon.base.arrays import Array, Bools, Brief, Integers, mean_along, median
from recon.clip import CleaningReport, Keypoints, Source, world_from_reference
from recon.fit.result import OUTLIER_SIGMAS, Finding, MotionSegment, Solution, Verdict
from recon.geometry import PITCH, ROOT, YAW, Camera, inverse, moved
from recon.io.common import Pose3D

if TYPE_CHECKING:
    import pandas as pd

MEASURED_SHARE = 0.5
"""A quantity with less of its precision from the pixels is not called measured."""


@dataclass(frozen=True, eq=False, repr=False)
class Picture(Brief):
    """One camera's picture of a motion, T frames with J joints: where the detector saw them, and where they are."""

    source: Source
    T_reference_camera: Array
    """(4, 4), or (T, 4, 4) of a camera that moves: to the motion's frame of reference."""
    joints_camera_m: Array
    """(T, J, 3) in this camera's frame when its pictures were taken, NaN without a pose."""
    reprojected_px: Array
    """(T, J, 2): the joints in the picture, where the detector sees them; NaN without a pose."""
    sigma_px: Array
    """(T, J): standard deviation that a detection was given."""
    weight: Array
    """(T, J): how far it was trusted, 0 to 1, NaN where missing; with the frame method the mean of the frame."""

    @property
    def camera(self) -> Camera:
        return self.source.camera

    @property
    def name(self) -> str:
        """The name of the camera."""
        return self.camera.name

    @property
    def detected_px(self) -> Array:
        """(T, J, 2), NaN where missing."""
        return self.source.keypoints.xy_px

    @property
    def present(self) -> Bools:
        """Which of the J keypoints were detected in each of the T frames, shape (T, J)."""
        return self.source.keypoints.present

    @cached_property
    def image_error_px(self) -> Array:
        """(T, J, 2): reprojected minus detected, NaN where either is missing."""
        return self.reprojected_px - self.detected_px

    @cached_property
    def distance_px(self) -> Array:
        """(T, J): distance between reprojection and detection."""
        return np.linalg.norm(self.image_error_px, axis=-1)

    @cached_property
    def outliers(self) -> Bools:
        """(T, J): detections that the pose does not explain."""
        return self.distance_px > OUTLIER_SIGMAS * self.sigma_px

    @cached_property
    def distance_m(self) -> Array:
        """(T,): of the mean of all joints from the camera."""
        return np.linalg.norm(self.joints_camera_m.mean(axis=1), axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """T frames of an animal with J joints and D unknowns, of which A are angles."""

    sources: tuple[Source, ...]
    """What each camera saw, in the order of the solution's views: cleaned keypoints in the order of the joints,
    all-missing for joints that the file does not have."""
    side: Side | None
    """Whose limbs were fitted, of a chain; None: both."""
    side_reason: str
    solution: Solution
    """What the method found, and what else it says: a `TrajectorySolution`, or that of another method."""
    findings: tuple[Finding, ...] = ()
    """What checks of the input and of the fit found (`recon.check`), the most serious first."""
    verdict: Verdict | None = None
    """Whether it may be used, and how far off it is expected to be; None before `recon.check.judged`."""
    chain: Skeleton | None = None
    """The `recon.animal.chain.Chain` that a skeleton is, if it is one, which `body` is made from."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """All that the fit was told, as JSON has it; its paths are absolute, and in a folder of results relative to it."""
    timing_s: Mapping[str, float] = field(default_factory=dict)
    """Seconds that the fit took, by name, besides those of the solution's stages."""

    def __repr__(self) -> str:
        """One line: what it is of, and the verdict on it."""
        posed, level = int(self.solved.sum()), "not judged" if self.verdict is None else self.verdict.level
        return f"<Motion of {Path(self.file).name}: {self.body.name}, {posed} of {self.clip_frames} frames, {level}>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        from recon.fit.motion_forms import html_of

        return html_of(self)

    # -- handed over ----------------------------------------------------------------------------------------------

    def to_dataframe(self, wide: bool = False) -> pd.DataFrame:
        """The joints in the frame of `upright`, z up, metres, with standard deviations (`upright_sigma_m`); NaN
        without a pose. A row for each frame and joint: frame, time_s, joint, x_m, y_m, z_m, x_sigma_m, y_sigma_m,
        z_sigma_m, flags; or, wide, a row for each frame, its columns by joint and value."""
        from recon.fit.motion_forms import table_of

        return table_of(self, wide)

    def to_xarray(self) -> Any:
        """The same as movement's dataset of poses: `position` and `position_sigma` (time, space, keypoint, individual)
        in metres, `confidence`, which is NaN, the frame rate, the source and the verdict as attributes. Raises
        InputError where xarray is not installed."""
        from recon.fit.motion_forms import dataset_of

        return dataset_of(self)

    # -- saved and loaded -----------------------------------------------------------------------------------------

    def save(self, folder: str | Path) -> Path:
        """Write motion.npz into a folder, whole or not at all; its path. `load` gives back the same, bit for bit."""
        from recon.base.records import save_record
        from recon.fit.motion_forms import MOTION, SCHEMA

        save_record(self, path := Path(folder) / MOTION, SCHEMA)
        return path

    @classmethod
    def load(cls, folder: str | Path) -> Motion:
        """The motion in a folder of results of `recon fit`, or in any that it was saved to. Raises InputError where
        there is none, where it is damaged or of another version, and for what an interrupted run or several left."""
        from recon.fit.motion_forms import load

        return load(cls, Path(folder))

    def __post_init__(self) -> None:
        if self.keypoints.fps is None:
            raise ValueError("keypoints without a frame rate")
        expected = self.body.keypoint_names(self.side)
        if self.keypoints.names != expected:
            raise ValueError(f"keypoints {self.keypoints.names} are not those of the joints {expected}")

    # -- the animal -----------------------------------------------------------------------------------------------

    @property
    def method(self) -> str:
        """The method of fitting: trajectory or frame."""
        return self.solution.method

    @property
    def jitters(self) -> bool:
        """Each frame was solved by itself: paths jitter from frame to frame, and sigmas are given the frame before."""
        return self.solution.jitters

    @property
    def body(self) -> Body:
        """The animal that was fitted."""
        return self.solution.body

    @property
    def title(self) -> str:
        """The title of the skeleton, one line."""
        return self.body.title

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,): what the skeleton calls them."""
        return self.body.markers

    @property
    def names(self) -> tuple[str, ...]:
        """(J,): the joints' keypoints, as the file calls them."""
        return self.keypoints.names

    @property
    def limbs(self) -> dict[str, tuple[int, ...]]:
        """Joints along each limb, as indices, for drawing."""
        return self.body.limb_rows

    @property
    def size(self) -> float:
        """The factor on the body's lengths; of the frame method, which has one for each frame, their median."""
        return self.solution.size

    @cached_property
    def limb_sides(self) -> dict[str, Side | None]:
        """The side of each limb; None: the middle."""
        return self.body.limb_sides(self.side)

    @property
    def forward(self) -> tuple[int, int]:
        """Two joints, from rear to front."""
        rear, front = self.body.forward
        return self.joints.index(rear), self.joints.index(front)

    @property
    def forward_names(self) -> tuple[str, str]:
        """The same by their keypoints."""
        rear, front = self.forward
        return self.names[rear], self.names[front]

    @cached_property
    def feet(self) -> tuple[int, ...]:
        """Joints of the feet, as indices."""
        return tuple(self.joints.index(foot) for foot in self.body.feet)

    @cached_property
    def foot_labels(self) -> tuple[str, ...]:
        """The labels of the feet: LF, RF, LH, RH (left or right, fore or hind)."""
        return tuple(self.body.feet_by_label(self.side))

    @cached_property
    def foot_names(self) -> dict[str, str]:
        """Keypoints of the feet by label, those that there are."""
        return {label: self.names[foot] for label, foot in zip(self.foot_labels, self.feet, strict=True)}

    @property
    def reference_joint(self) -> str:
        """What stands for the animal's position: the root's joint, or, where none is there, the trunk's rear one."""
        return self.root_name if self.root_name in self.joints else self.body.forward[0]

    @property
    def reference(self) -> str:
        """The keypoint of the reference joint."""
        return self.names[self.joints.index(self.reference_joint)]

    # -- what was fitted, of the first camera ---------------------------------------------------------------------

    @property
    def camera(self) -> Camera:
        """The camera of the first, or only, keypoint file."""
        return self.sources[0].camera

    @property
    def keypoints(self) -> Keypoints:
        """Detections of the first, or only, camera, after cleaning."""
        return self.sources[0].keypoints

    @property
    def file(self) -> str:
        """The first keypoint file, for messages."""
        return self.keypoints.source or "keypoints"

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """(V,): of all that filmed the clip."""
        return tuple(source.camera for source in self.sources)

    @property
    def cleaning(self) -> CleaningReport:
        """What happened to the file's points."""
        return self.sources[0].cleaning

    @property
    def camera_moves(self) -> bool:
        """Along a track, in a world with z up."""
        return self.sources[0].moves

    # -- frames and points ----------------------------------------------------------------------------------------

    @property
    def fps(self) -> float:
        """How many frames there are in a second."""
        assert self.keypoints.fps is not None
        return self.keypoints.fps

    @property
    def frames(self) -> Integers:
        """(T,): frame numbers of the first keypoint file, without most of those far from all detections."""
        return self.keypoints.frames

    @property
    def clip_frames(self) -> int:
        """How many frames the clip has, with those that are far from all detections."""
        return int(self.frames[-1] - self.frames[0]) + 1

    @cached_property
    def time_s(self) -> Array:
        """(T,): since frame 0 of the file."""
        return self.frames / self.fps

    @cached_property
    def detections(self) -> Integers:
        """(T,): points that the cameras saw together."""
        return np.sum([source.keypoints.present.sum(axis=1) for source in self.sources], axis=0)

    @property
    def unused_keypoints(self) -> tuple[str, ...]:
        """Keypoints of a file that the skeleton does not have."""
        return tuple(name for name in self._file_names if name not in self.names)

    @property
    def missing_keypoints(self) -> tuple[str, ...]:
        """Keypoints of the skeleton that no file has."""
        return tuple(name for name in self.names if name not in self._file_names)

    @cached_property
    def _file_names(self) -> dict[str, None]:
        """Keypoints in the files' order, each once."""
        return dict.fromkeys(name for source in self.sources for name in source.file_names)

    # -- the states -----------------------------------------------------------------------------------------------

    @property
    def states_frame(self) -> Literal["world", "level"]:
        """What the place and the rotation in `states` refer to, as in `recon.geometry.frames`."""
        return "world" if self.knows_up else "level"

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the D unknowns of a frame, with their units."""
        return self.body.state_names

    @property
    def states(self) -> Array:
        """(T, D), NaN where a frame has no pose."""
        return self.solution.states

    @property
    def angle_names(self) -> tuple[str, ...]:
        """(A,): the root's yaw, pitch and roll, then the joints' angles."""
        return self.state_names[YAW:]

    @property
    def angles_rad(self) -> Array:
        """The angles of the A joints' axes in each of the T frames, shape (T, A), in rad."""
        return self.states[:, YAW:]

    @property
    def posture_names(self) -> tuple[str, ...]:
        """(P,), P = A - 1: the angles without the root's yaw, which says where the animal heads, not how it stands."""
        return self.state_names[PITCH:]

    @property
    def posture_rad(self) -> Array:
        """The P angles that the prior knows (without the heading) in each of the T frames, shape (T, P), in rad."""
        return self.states[:, PITCH:]

    @property
    def posture_sigma_rad(self) -> Array:
        """(T, P): their standard deviations."""
        return self.solution.angle_sigma_rad[:, PITCH - YAW :]

    @property
    def posture_data_share(self) -> Array:
        """(T, P): the part of their precision that comes from the pixels, 0 to 1."""
        return self.solution.angle_data_share[:, PITCH - YAW :]

    @cached_property
    def data_shares(self) -> dict[str, float]:
        """The same by name, the median over the frames; NaN where it is not known."""
        return dict(zip(self.posture_names, map(median, self.posture_data_share.T), strict=True))

    # -- upright: in the frame that the motion was solved in, z up, the world or the level frame --------------------

    @cached_property
    def upright(self) -> Pose3D:
        """The joints, called as their keypoints, with limbs as edges."""
        names = self.names
        edges = [(names[a], names[b]) for along in self.limbs.values() for a, b in pairwise(along)]
        pose = Pose3D(names, self.solution.joints_m, self.frames)
        return replace(pose, fps=self.fps, edges=tuple(dict.fromkeys(edges)))

    @property
    def upright_sigma_m(self) -> Array:
        """(T, J, 3): standard deviation of the joints along the axes, position and size included."""
        return _sigmas(self.solution.covariance_m2)

    @property
    def upright_relative_sigma_m(self) -> Array:
        """(T, J, 3): the same of the joints relative to the mean of all joints."""
        return _sigmas(self.solution.relative_covariance_m2)

    @property
    def segments(self) -> tuple[MotionSegment, ...]:
        """The stretches of the clip that have a pose, each with its own ground; all of it where there are none."""
        return self.solution.segments or (MotionSegment(slice(0, len(self.frames)), None),)

    # -- in the frame of reference --------------------------------------------------------------------------------

    @property
    def frame_of_reference(self) -> Literal["world", "camera"]:
        """ "world" where the camera file has extrinsics or the camera moves, otherwise "camera"."""
        return "world" if self.camera.has_extrinsics or self.camera_moves else "camera"

    @property
    def knows_up(self) -> bool:
        """Whether the frame of reference is a world with z up."""
        return self.camera.knows_up or self.camera_moves

    @cached_property
    def T_reference_world(self) -> Array:
        """(4, 4): from the frame that the motion was solved in to the frame of reference (`recon.geometry.frames`)."""
        return np.eye(4) if self.camera_moves else inverse(world_from_reference(self.camera))

    def in_reference(self, world_m: Array) -> Array:
        """Points (..., 3) of the solution's world frame in the frame of reference."""
        return moved(self.T_reference_world, world_m)

    @cached_property
    def joints_m(self) -> Array:
        """(T, J, 3), NaN without a pose."""
        return self.in_reference(self.solution.joints_m)

    @property
    def joints_camera_m(self) -> Array:
        """(T, J, 3) in the first camera's frame."""
        return self.solution.joints_camera_m

    @cached_property
    def solved(self) -> Bools:
        """(T,): frames that have a pose."""
        return self.solution.posed

    @property
    def root_name(self) -> str:
        """What the skeleton calls the root's origin: the marker there, or the root segment."""
        root = self.body.tree.segments[0].name
        return next((m.name for m in self.body.tree.markers if m.segment == root and not any(m.offset_m)), root)

    @cached_property
    def root_m(self) -> Array:
        """The origin of the root in each of the T frames, shape (T, 3), in metres."""
        return self.in_reference(self.states[:, ROOT])

    def below_m(self, segment: MotionSegment) -> Array | None:
        """(3,): the ground below the middle of the root's path in a segment, world frame; None: not known."""
        xy_m = self.states[segment.rows, :2]
        xy_m = xy_m[np.isfinite(xy_m[:, 0])]
        if segment.ground is None or not len(xy_m):
            return None
        middle = xy_m.mean(axis=0)
        return np.append(middle, segment.ground.height_m + segment.ground.slope @ middle)

    # -- pictures -------------------------------------------------------------------------------------------------

    @cached_property
    def pictures(self) -> tuple[Picture, ...]:
        """What each camera saw, in the order of the sources."""
        solution = self.solution
        found = []
        for source, view, *rest in zip(self.sources, solution.views, solution.noise_px, solution.weight, strict=True):
            pixels, _ = view.project(view.shift_to_exposure(solution.markers_m))
            if source.poses is not None:
                pixels = np.where(source.poses.known[:, None, None], pixels, np.nan)
            T_reference_camera = self.T_reference_world @ inverse(view.T_camera_world)
            joints_m = view.to_camera(view.shift_to_exposure(solution.joints_m))
            found.append(Picture(source, T_reference_camera, joints_m, pixels, *rest))
        return tuple(found)

    # -- how far it can be trusted --------------------------------------------------------------------------------

    @property
    def flags(self) -> tuple[tuple[str, ...], ...]:
        """(T,): what is doubtful about a frame; a frame without a pose has one that says why."""
        return self.solution.flags

    @property
    def alternative_m(self) -> Array:
        """(T,): mean distance of the joints in the second best solution, both centred, NaN where there is none."""
        return self.solution.alternative_m

    @property
    def joint_sigma_m(self) -> Array:
        """(T, J, 3): standard deviation along the axes of the frame of reference, place and size included."""
        return _sigmas(self._turned(self.solution.covariance_m2))

    def relative_covariance_m2(self, rows: slice = slice(None)) -> Array:
        """(T, J, 3, 3): of the joints relative to the mean of all joints, in the frame of reference, in these rows."""
        return self._turned(self.solution.relative_covariance_m2[rows])

    @property
    def relative_sigma_m(self) -> Array:
        """(T, J, 3): the same along the axes."""
        return _sigmas(self.relative_covariance_m2())

    @cached_property
    def relative_rms_m(self) -> Array:
        """(T,): root mean square of the expected distances of joints from their true places, both poses centred."""
        return np.sqrt(np.trace(self.solution.relative_covariance_m2, axis1=2, axis2=3).mean(axis=1))

    @cached_property
    def place_sigma_m(self) -> Array:
        """(T,): standard deviation of the mean of all joints along the first camera's line of sight."""
        # Joints are the mean plus offsets that sum to zero: mean covariances differ by the mean's own.
        of_mean = (self.solution.covariance_m2 - self.solution.relative_covariance_m2).mean(axis=1)
        ray = self.solution.joints_m.mean(axis=1) - self.solution.views[0].centre_m
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        return np.sqrt(np.maximum(np.einsum("ta,tab,tb->t", ray, of_mean, ray), 0.0))

    @cached_property
    def mean_weight(self) -> Array:
        """(T,): how far all cameras' detections were trusted on average, 0 to 1, NaN without any or without a pose."""
        return mean_along(self.solution.weight, (0, 2))

    def _turned(self, covariance_m2: Array) -> Array:
        R = self.T_reference_world[:3, :3]
        return R @ covariance_m2 @ R.T


def _sigmas(covariance: Array) -> Array:
    """Standard deviations (..., 3) along the axes."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
