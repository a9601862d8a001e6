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
"""error: do not use the result; warning: use it with care; note: for information."""
Number = float | int | str | tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """A finding of a check; `recon.check.codes.CODES` has the severity and the text of each code."""

    code: str
    severity: Severity
    frames: tuple[int, int] | None = None
    """First frame number, and the one after the last; None means the whole clip."""
    camera: str | None = None
    """Name of the camera that the finding is about; None means all cameras, or the clip."""
    numbers: dict[str, Number] = field(default_factory=dict)
    """Evidence as plain numbers and names; the endings of the names give the units: rad, m, s, px."""

    def names(self, number: str) -> tuple[str, ...]:
        """Return the names among the finding's evidence under a key; empty if there are none."""
        value = self.numbers.get(number, ())
        return value if isinstance(value, tuple) else ()


Level = Literal["do not use", "check", "use"]
LEVELS: tuple[Level, ...] = ("do not use", "check", "use")
"""Levels of a verdict, in the order in which clips should be looked at."""


_NOTHING = 0.1
"""Lower end of an interval, relative to its upper end, below which the interval only says "at most"."""


@dataclass(frozen=True, repr=False)
class ExpectedError(Brief):
    """Expected size of an unknown error: the median, and the interval that holds 90 %."""

    expected: float
    low: float
    high: float
    widened_by: str = ""
    """Code of the finding whose possible effect makes up most of the upper end; empty if there is none."""

    def __repr__(self) -> str:
        return f"ExpectedError({self.expected:.3g}, 90 %: {self.low:.3g} to {self.high:.3g})"

    @property
    def in_words(self) -> str:
        """Return the error as text: in metres, or in millimetres if the upper end is below half a metre.

        A lower end close to zero is left out.
        """
        unit, error = ("mm", self.times(1000.0)) if self.high < 0.5 else ("m", self)
        cause = f", because the finding {self.widened_by} may be right" if self.widened_by else ""
        ends = error.expected, error.low, error.high
        return interval(*ends, unit, level="90 %", least=_NOTHING * error.high, remark=cause)

    def times(self, factor: float) -> ExpectedError:
        """Return the error multiplied by a factor, for another unit."""
        return replace(self, expected=factor * self.expected, low=factor * self.low, high=factor * self.high)


@dataclass(frozen=True, repr=False)
class Verdict(Brief):
    """Verdict on whether a clip may be used, with its expected errors (`recon.check.verdict`, docs/verdict.md)."""

    level: Level
    reason: str
    """Reason for the level, in one sentence."""
    pose_m: ExpectedError | None = None
    """Mean distance of the joints from their true positions, both centred (MPJPE); None without a pose."""
    pose_of_trunk: ExpectedError | None = None
    """Error of the pose as a fraction of the length of the trunk."""
    position_m: ExpectedError | None = None
    """Distance of the mean of all joints from its true position, as a mean over the frames."""
    warned: bool = False
    """Whether a finding warns that errors may be larger than stated."""

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the verdict as text: the level and its reason, and the expected errors if known."""
        verdict_line = f"{self.level}: {self.reason}"
        if self.pose_m is None or self.pose_of_trunk is None or self.position_m is None:
            return (verdict_line,)
        share = f"{percent(self.pose_of_trunk.expected)} of the trunk's length"
        prefix = "apart from that, " if self.warned else ""
        return (
            verdict_line,
            f"{prefix}pose error {self.pose_m.in_words}, {share}; position error {self.position_m.in_words}",
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
SINGLE = (
    "covariance_m2",
    "relative_covariance_m2",
    "angle_sigma_rad",
    "angle_data_share",
    "noise_px",
    "weight",
)
"""Arrays of the trajectory method that are kept in single precision, which is finer than their accuracy."""
OUTLIER_SIGMAS = 3.0
"""Distance of a detection from its joint's reprojection, in standard deviations, above which it is an outlier."""


@dataclass(frozen=True)
class Ground:
    """A ground plane z = height_m + slope . (x, y), with slopes (2,), and its height's standard deviation.

    The standard deviation is that under the animal.
    """

    height_m: float
    slope: Array
    sigma_m: float
    near_zero: bool | None = None
    """Whether the ground was assumed to be near z = 0; None if no file states it."""

    def about(self, origin_m: Array, size: float) -> Ground:
        """Return the ground in the world after a scene is scaled by a size and moved to an origin (3,), m."""
        height = origin_m[2] + size * self.height_m - self.slope @ origin_m[:2]
        return replace(self, height_m=float(height), sigma_m=size * self.sigma_m)


@dataclass(frozen=True)
class SecondCamera:
    """Test of the second of two cameras: the evidence that it is misplaced or late."""

    misplaced: float
    """Log-likelihood gain if the camera was turned or moved."""
    late: float
    """Log-likelihood gain if the camera's clock is off."""
    late_frames: float
    """Estimated delay in frames if the clock is off."""

    @property
    def is_misplaced(self) -> bool:
        """Return whether the camera has probably been turned or moved, and is not clearly more likely to be late."""
        return self.misplaced > max(0.0, self.late - 1.0)


@dataclass(frozen=True, repr=False)
class MotionSegment(Brief):
    """A part of the clip that was solved separately, because of long gaps without detections around it.

    Segments are in order and do not overlap.
    """

    rows: slice
    """Rows of the clip that the segment covers."""
    ground: Ground | None
    """The ground under the feet; None if no foot stood."""
    prior_misfit: float | None = None
    """Misfit of the motion under the prior, about 1 if it fits; None without a prior."""
    prior_weight: float = 1.0
    """Fraction of its weight that the prior kept; 1 if the motion fits.

    A prior without correlations between the angles has the rest of the weight.
    """
    unlike_prior: bool = False
    """Whether the motion is unlike all motions of the prior."""
    second_camera: SecondCamera | None = None
    """Test of the second camera; None if there are not two cameras, or the second camera's pose was not fixed."""


@dataclass(frozen=True, eq=False, repr=False)
class SolvedShape(Brief):
    """Lengths and keypoint offsets that a fit of several cameras estimated."""

    names: tuple[str, ...]
    """Names (L,) of the segments and markers whose distances from their carrying segments were estimated.

    Lengths on the right equal those on the left.
    """
    lengths_m: Array
    """(L,): estimated lengths of an animal of the estimated size."""
    lengths_sigma_m: Array
    """(L,): standard deviations of the lengths."""
    expected_lengths_m: Array
    """(L,): lengths that the skeleton or the subject's file states."""
    offsets_m: Array
    """(J, 3): keypoints minus markers, in the frames of the markers' segments, size included."""
    offsets_sigma_m: Array
    """(J, 3): standard deviations of the offsets."""
    expected_offsets_m: Array
    """(J, 3): offsets that were measured for the detector; 0 if none were."""


@dataclass(frozen=True, eq=False, repr=False)
class ReferencePath(Brief):
    """Path of the reference joint in the world, estimated from all T frames of a clip."""

    position_m: Array
    """Positions of the reference joint, shape (T, 3)."""
    velocity_m_s: Array
    """Velocities of the reference joint, shape (T, 3)."""
    acceleration_m_s2: Array
    """Accelerations of the reference joint, shape (T, 3)."""
    covariance: Array
    """Covariances of position, velocity and acceleration, shape (T, 9, 9), without the uncertainty of the size."""
    centre_m: Array
    """Position of the camera, shape (T, 3) or (3,): the size changes the distance from it."""
    size_sigma: float
    """Relative standard deviation of the size."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Brief):
    """An animal's motion over T frames, as every method returns it.

    The animal has J markers, D unknowns per frame and F feet; there are V views. Positions are in the world frame
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
    """(T, D): unknowns of each frame, for the body's lengths times `size`; the root's position is in the world."""
    size: float
    """Factor on the skeleton's lengths; the median over frames if a method estimates one for each."""
    joints_m: Array
    """(T, J, 3): the joints in the world, NaN without a pose."""
    covariance_m2: Array
    """(T, J, 3, 3): covariances of the joints, position and size included."""
    relative_covariance_m2: Array
    """(T, J, 3, 3): covariances of the joints relative to the mean of all joints."""
    angle_sigma_rad: Array
    """(T, D - 3): standard deviations of the root's rotation and the joints' angles, `states[:, 3:]`."""
    angle_data_share: Array
    """(T, D - 3): information fraction of the angles, the part of their precision from the pixels, 0 to 1."""
    noise_px: Array
    """(V, T, J): standard deviation assigned to each detection in each view."""
    weight: Array
    """(V, T, J): weight of each detection, 0 to 1, NaN if missing."""
    flags: tuple[tuple[str, ...], ...]
    """(T,): flags of each frame; in a frame without a pose, a flag gives the reason."""
    alternative_m: Array
    """(T,): mean distance between the joints of the two best solutions, both centred; NaN without a second one."""
    contact: Array
    """Contact of the feet with the ground, shape (T, F), 0 to 1; 0 if the method does not estimate contacts."""
    segments: tuple[MotionSegment, ...]
    """Parts of the clip that have a pose, each with its own ground."""
    stage_s: dict[str, float]
    """Seconds of the stages by name, with the whole solution as "all"; empty if the method does not measure them."""

    def findings(self) -> tuple[Finding, ...]:
        """Return the findings that only this method can make in its own solution."""
        return ()

    def report_sections(self) -> tuple[object, ...] | None:
        """Return the method's own sections of the report (`recon.show.report`), or None for the usual ones."""
        return None

    @property
    def constant_velocity_m_s(self) -> Array | None:
        """Return the speed of the constant-velocity starts of the search, (T,), m/s, if the method keeps it."""
        return None

    @property
    def position_error_time_s(self) -> float | None:
        """Return the correlation time of the position's error, s, if the method estimates the path separately."""
        return None

    @property
    def reference_path(self) -> ReferencePath | None:
        """Return the path of the reference joint, if the method estimates the path separately."""
        return None

    @property
    def posterior_factor(self) -> float:
        """Return the factor on the stated standard deviations of poses that makes them match the poses' errors."""
        return 1.0

    @property
    def posed(self) -> Bools:
        """Return a mask of the frames that have a pose, (T,)."""
        return np.asarray(np.isfinite(self.joints_m[:, 0, 0]))

    @cached_property
    def joints_camera_m(self) -> Array:
        """Return the joints in the first camera's frame, (T, J, 3)."""
        return self.views[0].to_camera(self.joints_m)

    @cached_property
    def markers_m(self) -> Array:
        """Return the positions at which the detector sees the joints, (T, J, 3)."""
        if not self.body.keypoint_offset_m:
            return self.joints_m
        return self.joints_m + (
            self.body.detected.pose(self.states, self.size).points_m
            - self.body.tree.pose(self.states, self.size).points_m
        )


@dataclass(frozen=True, eq=False, repr=False)
class TrajectorySolution(Solution):
    """Solution of the trajectory method, which flags "no data", "diverged", "data poor" and "ambiguous depth"."""

    size_sigma: float
    """Posterior standard deviation of the animal's size."""
    size_prior_sigma: float
    """Prior standard deviation of the size around 1."""
    size_from: tuple[str, ...]
    """Sources of the size: "prior", and "views" and "ground" if they determine it."""
    data_share: Array
    """(J,): information fraction of the joints, the part of their precision from the pixels, 0 to 1."""
    alternative_cost: float
    """Cost of the second-best solution minus that of the best solution."""
    prior: str
    status: Literal["converged", "not_converged"]
    cost_by_term: dict[str, float]
    """Cost of each term by its name: half the squared norm of its residuals, under the robust loss."""
    iterations: int
    starts: int
    """Number of starts of the search that were tried."""
    time_offset_frames: Array
    """(V,): delay of each camera's pictures beyond the stated offset; 0 if not estimated."""
    time_offset_sigma_frames: Array
    """(V,): standard deviations of the time offsets."""
    extrinsic_correction: Array
    """(V, 6): correction of each camera's pose, as in `View.corrected`; 0 if not estimated."""
    extrinsic_correction_sigma: Array
    """(V, 6): standard deviations of the extrinsic corrections."""
    focal: Array
    """(V,): logarithm of the factor on each camera's focal lengths; 0 if not estimated."""
    focal_sigma: Array
    """(V,): standard deviations of `focal`."""
    sideslip_rad: float
    """Constant angle, to the left, between the trunk and the direction of travel; 0 if not estimated."""
    sideslip_sigma_rad: float
    shape: SolvedShape | None = None
    """Lengths and keypoint offsets; None if they were not estimated."""

    method: ClassVar = "trajectory"
    record_tag: ClassVar = "trajectory"

    @property
    def longest_segment(self) -> MotionSegment | None:
        """Return the longest segment all of whose frames have states, or None."""
        segments = [segment for segment in self.segments if np.isfinite(self.states[segment.rows, 0]).all()]
        return max(segments, key=lambda segment: segment.rows.stop - segment.rows.start, default=None)

    @property
    def second_cameras(self) -> list[SecondCamera]:
        """Return the tests of the second camera, one per segment that has a test."""
        return [segment.second_camera for segment in self.segments if segment.second_camera is not None]
