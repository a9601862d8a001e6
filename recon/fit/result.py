"""Define the classes that hold the result of a fit: findings, the verdict, and solutions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array, Bools, Brief
from recon.base.numbers import interval, percent
from recon.clip import View

Severity = Literal["error", "warning", "note"]
"""Severity of a finding.

An error means that the result must not be used, a warning asks for care, and a note only informs.
"""
Number = float | int | str | tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """Problem or remark that a check found, with a code whose message is in `recon.check.codes.CODES`."""

    code: str
    severity: Severity
    frames: tuple[int, int] | None = None
    """First frame number of the finding, and the frame number after its last; None for the whole clip."""
    camera: str | None = None
    """Name of the camera that the finding is about; None for all cameras, or for the clip."""
    numbers: dict[str, Number] = field(default_factory=dict)
    """Evidence as numbers or strings, keyed by names that end in the unit (rad, m, s, px)."""

    def names(self, number: str) -> tuple[str, ...]:
        """Return the names that the evidence holds under the key `number`; empty if it holds none."""
        value = self.numbers.get(number, ())
        return value if isinstance(value, tuple) else ()


Level = Literal["do not use", "check", "use"]
LEVELS: tuple[Level, ...] = ("do not use", "check", "use")
"""Levels of a verdict, the worst first."""


NEGLIGIBLE = 0.1
"""Minimum ratio of an interval's lower end to its upper end for which the text gives both ends."""


@dataclass(frozen=True, repr=False)
class ExpectedError(Brief):
    """Expected size of an unknown error: the median of its distribution, and its 90 % interval."""

    expected: float
    low: float
    high: float
    widened_by: str = ""
    """Code of the finding that widens the interval most; empty if no finding does."""
    widened_if: str = ""
    """Clause that completes "if" and says what this finding suspects, such as "the focal length is wrong"."""

    def __repr__(self) -> str:
        return f"ExpectedError({self.expected:.3g}, 90 %: {self.low:.3g} to {self.high:.3g})"

    @property
    def in_words(self) -> str:
        """Return the error and its 90 % interval as text, in mm if `high` is below half a metre, otherwise in m.

        If the interval begins close to zero, the text gives only its upper end.
        """
        unit, error = ("mm", self.times(1000.0)) if self.high < 0.5 else ("m", self)
        cause = f", if {self.widened_if or f'the finding {self.widened_by} is right'}" if self.widened_by else ""
        ends = error.expected, error.low, error.high
        return interval(*ends, unit, level="90 %", least=NEGLIGIBLE * error.high, remark=cause)

    def times(self, factor: float) -> ExpectedError:
        """Return the error multiplied by a factor, to convert its unit."""
        return replace(self, expected=factor * self.expected, low=factor * self.low, high=factor * self.high)


@dataclass(frozen=True, repr=False)
class Verdict(Brief):
    """Verdict on whether the result for a clip may be used, with its expected errors (docs/verdict.md)."""

    level: Level
    reason: str
    """Reason for the level, in one sentence."""
    pose_m: ExpectedError | None = None
    """Mean distance of the joints from their true positions, both centred (MPJPE), m; None without a pose."""
    pose_of_trunk: ExpectedError | None = None
    """`pose_m` as a fraction of the trunk's length; None without a pose."""
    position_m: ExpectedError | None = None
    """Distance of the mean of all joints from its true position, averaged over the frames, m; None without a pose."""
    warned: bool = False
    """Whether a finding warns that errors may be larger than stated."""
    reason_code: str = ""
    """Subject of the reason: the code of a finding, `no_fault`, `no_serious_fault`, `not_all_checked`, `no_pose`, or
    the quantity that makes the expected error large; "" in results of earlier versions.
    """

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the verdict as text: the level and its reason, and the expected errors if known."""
        verdict_line = f"{self.level}: {self.reason}"
        if self.pose_m is None or self.pose_of_trunk is None or self.position_m is None:
            return (verdict_line,)
        fraction = f"{percent(self.pose_of_trunk.expected)} of the trunk's length"
        prefix = "apart from that, " if self.warned else ""
        return (
            verdict_line,
            f"{prefix}pose error {self.pose_m.in_words}, {fraction}; position error {self.position_m.in_words}",
        )


SHAPES = {
    "states": "TD",
    "joints_m": "TJ3",
    "covariance_m2": "TJ33",
    "relative_covariance_m2": "TJ33",
    "angle_sigma_rad": "TA",
    "angle_data_share": "TA",
    "noise_px": "VTJ",
    "weight": "VTJ",
    "alternative_m": "T",
    "contact": "TF",
}
"""Shapes of a solution's arrays: T frames, J joints, V views, D unknowns a frame, A angles, F feet."""
TRAJECTORY_SHAPES = SHAPES | {"flexion_sigma_rad": "TK"}
"""Shapes of the arrays of a solution of the trajectory method; K is the number of anatomical joints."""
SINGLE = (
    "covariance_m2",
    "relative_covariance_m2",
    "angle_sigma_rad",
    "angle_data_share",
    "flexion_sigma_rad",
    "noise_px",
    "weight",
)
"""Arrays of the trajectory method that are rounded to single precision, which is finer than their accuracy."""
OUTLIER_SIGMAS = 3.0
"""Maximum distance of an inlier detection from the reprojected joint, in standard deviations."""


@dataclass(frozen=True)
class Ground:
    """Ground plane z = height_m + slope . (x, y), with slopes (2,) and the height's standard deviation, m.

    The standard deviation applies to the ground below the animal.
    """

    height_m: float
    slope: Array
    sigma_m: float
    near_zero: bool | None = None
    """Whether the ground was assumed to be near z = 0; None if no file states where the ground is."""

    def about(self, origin_m: Array, size: float) -> Ground:
        """Return the ground in the world, where the scene of this ground has a given size and an origin (3,), m."""
        height = origin_m[2] + size * self.height_m - self.slope @ origin_m[:2]
        return replace(self, height_m=float(height), sigma_m=size * self.sigma_m)


@dataclass(frozen=True)
class SecondCamera:
    """Evidence that the second of two cameras was turned or moved, or that its clock is wrong."""

    misplaced: float
    """Gain in log-likelihood if the camera was turned or moved."""
    late: float
    """Gain in log-likelihood if the camera's clock is wrong."""
    late_frames: float
    """Estimated delay of the camera's pictures, in frames, if the clock is wrong."""

    @property
    def is_misplaced(self) -> bool:
        """Return whether the camera has probably been turned or moved, and a wrong clock is not clearly more likely."""
        return self.misplaced > max(0.0, self.late - 1.0)


@dataclass(frozen=True, repr=False)
class MotionSegment(Brief):
    """Part of a clip that was solved separately, between long gaps without detections.

    The segments of a clip are in order and do not overlap.
    """

    rows: slice
    """Slice of the clip's frames that the segment covers."""
    ground: Ground | None
    """Ground under the feet, in the world; None if no foot stood."""
    prior_misfit: float | None = None
    """Misfit of the motion under the prior, about 1 if the motion fits; None without a prior."""
    prior_weight: float = 1.0
    """Factor on the prior's weight, 0 to 1; 1 if the motion fits the prior.

    The rest of the weight is given to a prior without correlations between the angles.
    """
    unlike_prior: bool = False
    """Whether the motion is unlike all motions of the prior."""
    second_camera: SecondCamera | None = None
    """Test of the second of two cameras; None for another number of cameras, or if the second camera's pose was
    refined.
    """


@dataclass(frozen=True, eq=False, repr=False)
class SolvedShape(Brief):
    """Segment lengths and keypoint offsets, estimated by a fit to the detections of several cameras."""

    names: tuple[str, ...]
    """Names (L,) of the segments and markers whose distance from the origin of their parent segment was estimated.

    Lengths on the right equal those on the left.
    """
    lengths_m: Array
    """Estimated lengths, with the estimated size, m, shape (L,)."""
    lengths_sigma_m: Array
    """Standard deviations of the lengths, m, shape (L,)."""
    expected_lengths_m: Array
    """Lengths in the skeleton or in the subject's file, m, shape (L,)."""
    offsets_m: Array
    """Offsets of keypoints from markers, m, in the frames of the segments, with the estimated size, shape (J, 3)."""
    offsets_sigma_m: Array
    """Standard deviations of the offsets, m, shape (J, 3)."""
    expected_offsets_m: Array
    """Offsets that were measured for the detector, m, shape (J, 3); 0 if no offset was measured."""


@dataclass(frozen=True, eq=False, repr=False)
class ReferencePath(Brief):
    """Path of the reference joint in the world, estimated from all T frames of a clip."""

    position_m: Array
    """Positions of the reference joint in the world, shape (T, 3)."""
    velocity_m_s: Array
    """Velocities of the reference joint, shape (T, 3)."""
    acceleration_m_s2: Array
    """Accelerations of the reference joint, shape (T, 3)."""
    covariance: Array
    """Covariances of position, velocity and acceleration, in units of m and s, shape (T, 9, 9), at a fixed size."""
    centre_m: Array
    """Position of the camera, from which the size scales the path, shape (T, 3) or (3,)."""
    size_sigma: float
    """Relative standard deviation of the size."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Brief):
    """Motion of an animal over T frames, as every fitting method returns it.

    The animal has J markers, D unknowns per frame and F feet, and V cameras saw it. Positions are in the world frame
    (`recon.geometry.frames`), metres; NaN in frames without a pose.
    """

    method: ClassVar[str]
    """Name of the method in the report."""
    record_tag: ClassVar[str]
    """Tag of the class in motion files (`recon.fit.motion_forms.CLASSES`)."""
    jitters: ClassVar[bool] = False
    """Whether each frame was solved independently, so that paths jitter from frame to frame."""

    body: Body
    views: tuple[View, ...]
    """The fitted views, with the estimated time offsets."""
    states: Array
    """Unknowns of each frame, for lengths times `size` and a root position in the world, shape (T, D)."""
    size: float
    """Factor on the skeleton's lengths, the median over the frames if a method estimates a size for each frame."""
    joints_m: Array
    """Joints in the world, shape (T, J, 3); NaN without a pose."""
    covariance_m2: Array
    """Covariances of the joints, position and size included, shape (T, J, 3, 3)."""
    relative_covariance_m2: Array
    """Covariances of the joints relative to the mean of all joints, shape (T, J, 3, 3)."""
    angle_sigma_rad: Array
    """Standard deviations of the root's rotation and the joints' angles, `states[:, 3:]`, rad, shape (T, D - 3)."""
    angle_data_share: Array
    """Information fraction of the angles, the part of their precision from the pixels, 0 to 1, shape (T, D - 3)."""
    noise_px: Array
    """Standard deviation that the fit assigned to each detection, px, shape (V, T, J)."""
    weight: Array
    """Weight of each detection, 0 to 1, shape (V, T, J); NaN if missing."""
    flags: tuple[tuple[str, ...], ...]
    """Flags of each frame, shape (T,), including the reason in a frame without a pose."""
    alternative_m: Array
    """Mean distance between the joints of the two best solutions, both centred, m, shape (T,).

    The distance is NaN in frames without a second solution.
    """
    contact: Array
    """Contact of the feet with the ground, shape (T, F), 0 to 1; 0 if the method does not estimate contacts."""
    segments: tuple[MotionSegment, ...]
    """Parts of the clip that have a pose, each with its own ground."""
    stage_s: dict[str, float]
    """Duration of each stage of the fit in seconds, keyed by its name, and of all stages under the key "all".

    The dictionary is empty if the method measures no times.
    """

    def findings(self) -> tuple[Finding, ...]:
        """Return the findings that only the fitting method of the solution can provide."""
        return ()

    def report_sections(self) -> tuple[object, ...] | None:
        """Return the method's own sections of the report (`recon.show.report`), or None for all usual sections."""
        return None

    @property
    def constant_velocity_m_s(self) -> Array | None:
        """Return the speed (T,), m/s, of the straight run from which the search started; None if it is not stored."""
        return None

    @property
    def position_error_time_s(self) -> float | None:
        """Return the correlation time of the position's error, s; None unless the path is estimated separately."""
        return None

    @property
    def reference_path(self) -> ReferencePath | None:
        """Return the path of the reference joint; None unless the path is estimated separately."""
        return None

    @property
    def flexion_sigma_rad(self) -> Array | None:
        """Return the standard deviations (T, K) of the flexions of the K anatomical joints (`Body.anatomy`), rad.

        Return None if the method does not compute them from the covariances of the angles.
        """
        return None

    @property
    def posterior_factor(self) -> float:
        """Return the factor that scales the stated standard deviations of poses to the poses' usual errors."""
        return 1.0

    @property
    def posed(self) -> Bools:
        """Return a mask of the frames that have a pose, (T,)."""
        return np.asarray(np.isfinite(self.joints_m[:, 0, 0]))

    @cached_property
    def joints_camera_m(self) -> Array:
        """Return the joints in the first camera's frame, (T, J, 3), metres."""
        return self.views[0].to_camera(self.joints_m)

    @cached_property
    def markers_m(self) -> Array:
        """Return the positions at which the detector sees the joints, (T, J, 3), in the world, metres."""
        if not self.body.keypoint_offset_m:
            return self.joints_m
        return self.joints_m + (
            self.body.detected.pose(self.states, self.size).points_m
            - self.body.tree.pose(self.states, self.size).points_m
        )


@dataclass(frozen=True, eq=False, repr=False)
class TrajectorySolution(Solution):
    """Solution of the trajectory method.

    The flags of a frame are "no data", "diverged", "data poor" and "ambiguous depth".
    """

    size_sigma: float
    """Posterior standard deviation of the animal's size."""
    size_prior_sigma: float
    """Prior standard deviation of the animal's size about 1."""
    size_from: tuple[str, ...]
    """Sources of the size: always "prior", and also "views" or "ground" if these determine the size."""
    data_share: Array
    """Information fraction of the joints, the part of their precision from the pixels, 0 to 1, shape (J,)."""
    alternative_cost: float
    """Difference in cost between the second-best and the best solution."""
    prior: str
    status: Literal["converged", "not_converged"]
    cost_by_term: dict[str, float]
    """Cost of each term by its name, half the squared norm of its residuals under the robust loss."""
    iterations: int
    starts: int
    """Number of starts of the search that were tried."""
    time_offset_frames: Array
    """Delay of each camera's pictures beyond the stated offset, frames, shape (V,); 0 if not estimated."""
    time_offset_sigma_frames: Array
    """Standard deviations of the time offsets, frames, shape (V,)."""
    extrinsic_correction: Array
    """Correction of each camera's pose, rad and m, as in `View.corrected`, shape (V, 6); 0 if not estimated."""
    extrinsic_correction_sigma: Array
    """Standard deviations of the pose corrections, rad and m, shape (V, 6)."""
    focal: Array
    """Logarithm of the factor on each camera's focal lengths, shape (V,); 0 if not estimated."""
    focal_sigma: Array
    """Standard deviations of `focal`, shape (V,)."""
    sideslip_rad: float
    """Constant angle from the trunk to the direction of travel, rad, positive to the left; 0 if not estimated."""
    sideslip_sigma_rad: float
    shape: SolvedShape | None = None
    """Estimated lengths and keypoint offsets; None if they were not estimated."""
    flexion_sigma_rad: Array | None = None  # type: ignore[assignment]
    """Standard deviations (T, K) of the flexions of the K anatomical joints, rad; None in files of earlier versions."""

    method: ClassVar = "trajectory"
    record_tag: ClassVar = "trajectory"

    @property
    def longest_segment(self) -> MotionSegment | None:
        """Return the longest segment in which every frame has a pose; None if there is no such segment."""
        segments = [segment for segment in self.segments if np.isfinite(self.states[segment.rows, 0]).all()]
        return max(segments, key=lambda segment: segment.rows.stop - segment.rows.start, default=None)

    @property
    def second_cameras(self) -> list[SecondCamera]:
        """Return the tests of the second camera, for all segments that have one."""
        return [segment.second_camera for segment in self.segments if segment.second_camera is not None]
