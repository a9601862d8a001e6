"""The result of a fit: the animal's motion, what it was fitted to, and how far it can be trusted.

`Motion` is what both methods give; `FrameMotion` and `TrajectoryMotion` add what is particular to each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon.body import Body, Side
from recon.camera import Camera
from recon.clip import Source
from recon.frames import inverse, level_from_camera, moved, rigid
from recon.keypoints import CleaningReport, Keypoints
from recon.kinematics import ROOT, YAW
from recon.skeleton import Skeleton
from recon.solve import FrameReport, Solution, Spell, TrajectorySolution

Array = NDArray[np.float64]

OUTLIER_SIGMAS = 3.0
"""A detection further than this from its joint's reprojection is named an outlier."""
FEW_POINTS_SHARE = 0.75
"""Of the frame method: frames with a smaller part of the joints detected are flagged "few points"."""
TRUSTED_SHARE = 1 / 3
"""Of the frame method: frames with a smaller part of the joints detected and trusted are flagged "data poor"."""


@dataclass(frozen=True, eq=False)
class Picture:
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
        """Of the camera."""
        return self.camera.name

    @property
    def detected_px(self) -> Array:
        """(T, J, 2), NaN where missing."""
        return self.source.keypoints.xy_px

    @property
    def present(self) -> NDArray[np.bool_]:
        """(T, J): detected."""
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
    def outliers(self) -> NDArray[np.bool_]:
        """(T, J): detections that the pose does not explain."""
        return self.distance_px > OUTLIER_SIGMAS * self.sigma_px

    @cached_property
    def distance_m(self) -> Array:
        """(T,): of the mean of all joints from the camera."""
        return np.linalg.norm(self.joints_camera_m.mean(axis=1), axis=-1)


@dataclass(frozen=True, eq=False)
class Motion:
    """T frames of an animal with J joints and D unknowns, of which A are angles.

    keypoints: what was fitted, cleaned, in the order of the joints, all-missing for joints that the file does not have.
    cleaning: what happened to the file's points. file_names: all keypoints of the file. side: whose limbs were fitted,
    None for both, and side_reason why. Of a clip with several cameras the first one's; `pictures` has all.
    """

    camera: Camera
    keypoints: Keypoints
    cleaning: CleaningReport
    file_names: tuple[str, ...]
    side: Side | None
    side_reason: str

    def __post_init__(self) -> None:
        if self.keypoints.fps is None:
            raise ValueError("keypoints without a frame rate")
        if self.keypoints.names != self._expected_names():
            raise ValueError(f"keypoints {self.keypoints.names} are not those of the joints {self._expected_names()}")

    # -- what each method has in its own way ----------------------------------------------------------------------

    def _expected_names(self) -> tuple[str, ...]:
        raise NotImplementedError

    @property
    def animal(self) -> Skeleton | Body:
        """What was fitted: a chain, or a whole animal."""
        raise NotImplementedError

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,): what the skeleton calls them."""
        raise NotImplementedError

    @property
    def state_names(self) -> tuple[str, ...]:
        """(D,)"""
        raise NotImplementedError

    @cached_property
    def states(self) -> Array:
        """(T, D), NaN where a frame has no pose."""
        raise NotImplementedError

    @property
    def angle_names(self) -> tuple[str, ...]:
        """(A,)"""
        raise NotImplementedError

    @property
    def angles_rad(self) -> Array:
        """(T, A)"""
        raise NotImplementedError

    @cached_property
    def joints_camera_m(self) -> Array:
        """(T, J, 3) in the camera frame, NaN without a pose."""
        raise NotImplementedError

    @property
    def root_name(self) -> str:
        """What the skeleton calls the reference point that `root_m` is the path of."""
        raise NotImplementedError

    @cached_property
    def root_m(self) -> Array:
        """(T, 3): path of the reference point, the skeleton's root, in the frame of reference."""
        raise NotImplementedError

    @property
    def sources(self) -> tuple[Source, ...]:
        """What each camera saw."""
        return (Source(self.camera, self.keypoints, self.cleaning, self.file_names),)

    @cached_property
    def pictures(self) -> tuple[Picture, ...]:
        """Of each camera, in the same order."""
        raise NotImplementedError

    @cached_property
    def flags(self) -> tuple[tuple[str, ...], ...]:
        """(T,): what is doubtful about a frame; a frame without a pose has one that says why."""
        raise NotImplementedError

    @property
    def alternative_m(self) -> Array:
        """(T,): mean distance of the joints in the second best solution, both centred, NaN where there is none."""
        raise NotImplementedError

    @cached_property
    def mean_weight(self) -> Array:
        """(T,): how far all cameras' detections were trusted on average, 0 to 1, NaN without any or without a pose."""
        raise NotImplementedError

    @cached_property
    def place_sigma_m(self) -> Array:
        """(T,): standard deviation of the mean of all joints along the first camera's line of sight."""
        raise NotImplementedError

    @cached_property
    def relative_rms_m(self) -> Array:
        """(T,): what is expected of a joint's distance from its true place once both poses are centred, root mean
        square over the joints."""
        raise NotImplementedError

    # -- what both have -------------------------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """Of the skeleton, one line."""
        return self.animal.title

    @cached_property
    def limbs(self) -> dict[str, tuple[int, ...]]:
        """Joints along each limb, as indices, for drawing."""
        index = {joint: j for j, joint in enumerate(self.joints)}
        return {limb: tuple(index[joint] for joint in along) for limb, along in self.animal.limbs.items()}

    @cached_property
    def limb_sides(self) -> dict[str, Side | None]:
        """The side of each limb; None: the middle."""
        return self.animal.limb_sides(self.side)

    @property
    def forward(self) -> tuple[int, int]:
        """Two joints, from rear to front."""
        rear, front = self.animal.forward
        return self.joints.index(rear), self.joints.index(front)

    @cached_property
    def feet(self) -> tuple[int, ...]:
        return tuple(self.joints.index(foot) for foot in self.animal.feet)

    @cached_property
    def foot_labels(self) -> tuple[str, ...]:
        """Of the feet: LF, RF, LH, RH."""
        return tuple(self.animal.feet_by_label(self.side))

    @property
    def names(self) -> tuple[str, ...]:
        """(J,): the joints' keypoints, as the file calls them."""
        return self.keypoints.names

    @property
    def fps(self) -> float:
        assert self.keypoints.fps is not None
        return self.keypoints.fps

    @property
    def frames(self) -> NDArray[np.int64]:
        """(T,): frame numbers of the keypoint file."""
        return self.keypoints.frames

    @cached_property
    def time_s(self) -> Array:
        """(T,): since frame 0 of the file."""
        return self.frames / self.fps

    @cached_property
    def detections(self) -> NDArray[np.int64]:
        """(T,): points that the cameras saw together."""
        return np.sum([source.keypoints.present.sum(axis=1) for source in self.sources], axis=0)

    @property
    def unused_keypoints(self) -> tuple[str, ...]:
        """Of a file, but not of the skeleton."""
        return tuple(name for name in self._of_files if name not in self.names)

    @property
    def missing_keypoints(self) -> tuple[str, ...]:
        """Of the skeleton, but of no file."""
        return tuple(name for name in self.names if name not in self._of_files)

    @cached_property
    def _of_files(self) -> dict[str, None]:
        """Keypoints in the files' order, each once."""
        return dict.fromkeys(name for source in self.sources for name in source.file_names)

    @cached_property
    def solved(self) -> NDArray[np.bool_]:
        """(T,): frames that have a pose."""
        return np.asarray(np.isfinite(self.joints_camera_m[:, 0, 0]))

    @property
    def frame_of_reference(self) -> Literal["world", "camera"]:
        """ "world" where the camera file has extrinsics or the camera moves, otherwise "camera"."""
        return "world" if self.camera.has_extrinsics or self.camera_moves else "camera"

    @property
    def camera_moves(self) -> bool:
        """The first: along a track, in a world with z up."""
        return self.sources[0].moves

    @property
    def knows_up(self) -> bool:
        """Whether the frame of reference is a world with z up."""
        return self.camera.knows_up or self.camera_moves

    @cached_property
    def joints_m(self) -> Array:
        """(T, J, 3) in the frame of reference."""
        return self._in_reference(self.joints_camera_m)

    def _in_reference(self, points_camera_m: Array) -> Array:
        return self.camera.camera_to_world(points_camera_m) if self.camera.has_extrinsics else points_camera_m

    # -- the first camera's picture -------------------------------------------------------------------------------

    @property
    def detected_px(self) -> Array:
        return self.pictures[0].detected_px

    @property
    def reprojected_px(self) -> Array:
        return self.pictures[0].reprojected_px

    @property
    def sigma_px(self) -> Array:
        return self.pictures[0].sigma_px

    @property
    def image_error_px(self) -> Array:
        return self.pictures[0].image_error_px

    @property
    def distance_px(self) -> Array:
        return self.pictures[0].distance_px

    @property
    def outliers(self) -> NDArray[np.bool_]:
        return self.pictures[0].outliers


@dataclass(frozen=True, eq=False)
class FrameMotion(Motion):
    """Of the frame method: one side of the animal as a chain, one frame after the other."""

    skeleton: Skeleton
    solution: Solution

    def _expected_names(self) -> tuple[str, ...]:
        assert self.side is not None
        return self.skeleton.keypoint_names(self.side)

    @property
    def animal(self) -> Skeleton:
        return self.skeleton

    @property
    def joints(self) -> tuple[str, ...]:
        return self.skeleton.joints

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.skeleton.state_names

    @cached_property
    def states(self) -> Array:
        return self.solution.states

    @property
    def angle_names(self) -> tuple[str, ...]:
        return self.skeleton.angle_names

    @property
    def angles_rad(self) -> Array:
        """(T, A): theta and phi of the links."""
        return self.states[:, : 2 * self.skeleton.n_angles]

    @cached_property
    def joints_camera_m(self) -> Array:
        solved = np.isfinite(self.states[:, 0])
        joints = np.full((len(self.frames), len(self.joints), 3), np.nan)
        joints[solved] = self.skeleton.pose(self.states[solved]).joints_m
        return joints

    @property
    def root_name(self) -> str:
        return self.joints[0]

    @cached_property
    def root_m(self) -> Array:
        return self.joints_m[:, 0]

    @cached_property
    def pictures(self) -> tuple[Picture, ...]:
        (source,), camera = self.sources, self.camera
        T_camera_reference = np.eye(4)
        if camera.rotation is not None and camera.translation_m is not None:
            T_camera_reference = rigid(camera.rotation, camera.translation_m)
        trusted = self.mean_weight[:, None]
        return (
            Picture(
                source,
                inverse(T_camera_reference),
                self.joints_camera_m,
                camera.project(self.joints_camera_m)[0],
                np.repeat(self._of_reports("sigma_px")[:, None], len(self.joints), axis=1),
                np.where(source.keypoints.present, trusted, np.nan),
            ),
        )

    @property
    def reports(self) -> tuple[FrameReport | None, ...]:
        """One a frame, None without data."""
        return self.solution.reports

    @cached_property
    def status(self) -> tuple[str, ...]:
        """(T,): converged, not_converged or no_data."""
        return tuple("no_data" if r is None else r.status for r in self.reports)

    @cached_property
    def flags(self) -> tuple[tuple[str, ...], ...]:
        present, trusted = self.keypoints.present.sum(axis=1), self.mean_weight
        doubtful = {
            "no data": [r is None for r in self.reports],
            "ran away": [r is not None and not r.in_view for r in self.reports],
            "few points": [r is not None for r in self.reports] & (present < FEW_POINTS_SHARE * len(self.names)),
            "data poor": present * trusted < TRUSTED_SHARE * len(self.names),
            "outliers": self.outliers.any(axis=1),
            "not converged": [status == "not_converged" for status in self.status],
            "stopped early": [r is not None and r.stopped for r in self.reports],
            "at range limit": (self.beyond_range_rad > 0).any(axis=1),
            "at rate limit": (self.beyond_rate_rad_s > 0).any(axis=1),
        }
        return tuple(tuple(name for name, which in doubtful.items() if which[t]) for t in range(len(self.frames)))

    @cached_property
    def beyond_range_rad(self) -> Array:
        """(T, A): how far angles lie beyond their expected ranges; negative inside, NaN without a pose."""
        middle, tolerance = (self._expected(name) for name in ("mean_rad", "tolerance_rad"))
        return np.abs(self.angles_rad - middle) - tolerance

    @cached_property
    def beyond_rate_rad_s(self) -> Array:
        """(T, A): chord rate since the solved frame before, above its limit; NaN for the first and without a pose."""
        rows = np.flatnonzero(self.solved)
        change = np.diff(self.angles_rad[rows], axis=0)
        dt_s = np.diff(self.time_s[rows])[:, None]
        beyond = np.full(self.angles_rad.shape, np.nan)
        beyond[rows[1:]] = 2 * np.abs(np.sin(change / 2)) / dt_s - self._expected("max_rate_rad_s")
        return beyond

    def _expected(self, field: str) -> Array:
        """(A,): of theta and phi."""
        return np.concatenate([getattr(ranges, field) for ranges in (self.skeleton.theta, self.skeleton.phi)])

    @property
    def alternative_m(self) -> Array:
        """Of all starts only the best is kept."""
        return np.full(len(self.frames), np.nan)

    @cached_property
    def mean_weight(self) -> Array:
        return self._of_reports("mean_weight")

    @cached_property
    def place_sigma_m(self) -> Array:
        """Given the frame before."""
        return self._of_reports("place_sigma_m")

    @cached_property
    def relative_rms_m(self) -> Array:
        """Given the frame before."""
        return self._of_reports("relative_rms_m")

    def _of_reports(self, field: str) -> Array:
        """(T,)"""
        return np.array([np.nan if r is None else getattr(r, field) for r in self.reports])


@dataclass(frozen=True, eq=False)
class TrajectoryMotion(Motion):
    """Of the trajectory method: a whole body over the whole clip. skeleton: the chain that the body stands for, if any.

    `states` are the chain's where there is one, otherwise the body's, in the world frame of `recon.frames`.
    """

    solution: TrajectorySolution
    skeleton: Skeleton | None = None
    others: tuple[Source, ...] = ()
    """What further cameras saw; `camera` and `keypoints` are the first one's."""
    T_camera_world: Array | None = None
    """(T, 4, 4): of a first camera that moves, as in `Source`."""
    intrinsics_px: Array | None = None
    """(T, 4): of one that zooms, likewise."""

    @property
    def sources(self) -> tuple[Source, ...]:
        """All cameras' parts, in the order of the solution's views."""
        first = Source(
            self.camera,
            self.keypoints,
            self.cleaning,
            self.file_names,
            self.solution.views[0].lead_frames,
            self.T_camera_world,
            self.intrinsics_px,
        )
        return (first, *self.others)

    def _expected_names(self) -> tuple[str, ...]:
        if self.skeleton is None:
            return self.body.markers
        assert self.side is not None
        return self.skeleton.keypoint_names(self.side)

    @property
    def body(self) -> Body:
        return self.solution.body

    @property
    def animal(self) -> Skeleton | Body:
        return self.skeleton or self.body

    @property
    def joints(self) -> tuple[str, ...]:
        return self.body.markers

    # -- the states -----------------------------------------------------------------------------------------------

    @property
    def states_frame(self) -> Literal["world", "level", "camera"]:
        """What the place and the rotation in `states` refer to; level and world as in `recon.frames`. camera, of a
        chain: where the camera moves, a level one in the world's origin that looks along y."""
        if self.skeleton is not None:
            return "camera"
        return "world" if self.knows_up else "level"

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.body.state_names if self.skeleton is None else self.skeleton.state_names

    @cached_property
    def states(self) -> Array:
        of_body, known = self.solution.states, np.isfinite(self.solution.states).all(axis=1)
        if self.skeleton is None:
            return of_body
        view = self.solution.views[0]
        about_camera = of_body.copy()
        if view.still:
            about_camera[:, ROOT] -= view.centre_m
        R_camera_world = view.rotation if view.still else level_from_camera(self.camera.up).T
        states = np.full((len(of_body), self.skeleton.n_state), np.nan)
        states[known] = self.skeleton.state_from_body(about_camera[known], self.solution.size, R_camera_world)
        return states

    @property
    def angle_names(self) -> tuple[str, ...]:
        return self.state_names[YAW:] if self.skeleton is None else self.skeleton.angle_names

    @property
    def angles_rad(self) -> Array:
        """(T, A): theta and phi of a chain's links; else yaw, pitch and roll of the root and the joints' angles."""
        return self.states[:, YAW:] if self.skeleton is None else self.states[:, : 2 * self.skeleton.n_angles]

    @cached_property
    def T_reference_world(self) -> Array:
        """(4, 4): from the frame that the motion was solved in to the frame of reference (`recon.frames`)."""
        camera, view = self.camera, self.solution.views[0]
        if self.knows_up:
            return np.eye(4)
        if camera.rotation is None or camera.translation_m is None:
            return view.T_camera_world
        return inverse(rigid(camera.rotation, camera.translation_m)) @ view.T_camera_world

    def in_reference(self, world_m: Array) -> Array:
        """Points (..., 3) of the solution's world frame in the frame of reference."""
        return moved(self.T_reference_world, world_m)

    def below_m(self, spell: Spell) -> Array | None:
        """(3,): the ground below the middle of the root's path in a spell, world frame; None where it is not known."""
        xy_m = self.solution.states[spell.rows, :2]
        xy_m = xy_m[np.isfinite(xy_m[:, 0])]
        if spell.ground is None or not len(xy_m):
            return None
        middle = xy_m.mean(axis=0)
        return np.append(middle, spell.ground.height_m + spell.ground.slope @ middle)

    # -- joints and picture ---------------------------------------------------------------------------------------

    @cached_property
    def joints_camera_m(self) -> Array:
        return self.solution.joints_camera_m

    @property
    def root_name(self) -> str:
        """The marker in the root's origin, or the root segment."""
        root = self.body.tree.segments[0].name
        return next((m.name for m in self.body.tree.markers if m.segment == root and not any(m.offset_m)), root)

    @cached_property
    def root_m(self) -> Array:
        return self.in_reference(self.solution.states[:, ROOT])

    @cached_property
    def joints_m(self) -> Array:
        return self.in_reference(self.solution.joints_m)

    @cached_property
    def pictures(self) -> tuple[Picture, ...]:
        solution = self.solution
        given = zip(self.sources, solution.views, solution.noise_px, solution.weight, strict=True)
        return tuple(
            Picture(
                source,
                self.T_reference_world @ inverse(view.T_camera_world),
                view.to_camera(view.at_its_time(solution.joints_m)),
                self._where_known(source, view.project(view.at_its_time(solution.markers_m))[0]),
                noise_px,
                weight,
            )
            for source, view, noise_px, weight in given
        )

    def _where_known(self, source: Source, pixels: Array) -> Array:
        """Pixels (T, J, 2), NaN in frames in which it is not known where the camera was."""
        if source.T_camera_world is None:
            return pixels
        return np.where(np.isfinite(source.T_camera_world[:, 0, 0])[:, None, None], pixels, np.nan)

    # -- how far it can be trusted --------------------------------------------------------------------------------

    @cached_property
    def flags(self) -> tuple[tuple[str, ...], ...]:
        return self.solution.flags

    @property
    def alternative_m(self) -> Array:
        return self.solution.alternative_m

    @cached_property
    def joint_sigma_m(self) -> Array:
        """(T, J, 3): standard deviation along the axes of the frame of reference, place and size included."""
        return self._along_axes(self.solution.covariance_m2)

    @cached_property
    def relative_covariance_m2(self) -> Array:
        """(T, J, 3, 3): of the joints relative to the mean of all joints, in the frame of reference."""
        return self._turned(self.solution.relative_covariance_m2)

    @cached_property
    def relative_sigma_m(self) -> Array:
        """(T, J, 3): the same along the axes."""
        return self._along_axes(self.solution.relative_covariance_m2)

    @cached_property
    def relative_rms_m(self) -> Array:
        return np.sqrt(np.trace(self.solution.relative_covariance_m2, axis1=2, axis2=3).mean(axis=1))

    @cached_property
    def place_sigma_m(self) -> Array:
        # Joints are the mean plus offsets that sum to zero: mean covariances differ by the mean's own.
        of_mean = (self.solution.covariance_m2 - self.solution.relative_covariance_m2).mean(axis=1)
        ray = self.solution.joints_m.mean(axis=1) - self.solution.views[0].centre_m
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        return np.sqrt(np.maximum(np.einsum("ta,tab,tb->t", ray, of_mean, ray), 0.0))

    @cached_property
    def mean_weight(self) -> Array:
        weight = self.solution.weight
        seen = np.isfinite(weight).sum(axis=(0, 2))
        return np.where(seen > 0, np.nansum(weight, axis=(0, 2)) / np.maximum(seen, 1), np.nan)

    def _turned(self, covariance_m2: Array) -> Array:
        R = self.T_reference_world[:3, :3]
        return R @ covariance_m2 @ R.T

    def _along_axes(self, covariance_m2: Array) -> Array:
        return np.sqrt(np.diagonal(self._turned(covariance_m2), axis1=2, axis2=3))
