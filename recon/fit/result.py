"""Hold the result of a fit as data: findings, the verdict, a `Solution`, and the additions of the trajectory method."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array, Bools, Brief
from recon.base.numbers import percent
from recon.clip import View

Severity = Literal["error", "warning", "note"]
"""error: do not use the result; warning: use it with care; note: nothing is wrong."""
Number = float | int | str | tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """Hold what a check found. `recon.check.codes.CODES` has the severity and the words of each code."""

    code: str
    severity: Severity
    frames: tuple[int, int] | None = None
    """First frame number, and the one after the last; None: the whole clip."""
    camera: str | None = None
    """Name of the camera that the finding is about; None: all of them, or the clip."""
    numbers: dict[str, Number] = field(default_factory=dict)
    """Evidence, as plain numbers and names: radians, metres, seconds and pixels, as the names end."""

    def names(self, number: str) -> tuple[str, ...]:
        """Return the names stored under a number's name; none where there are none."""
        value = self.numbers.get(number, ())
        return value if isinstance(value, tuple) else ()


Level = Literal["do not use", "check", "use"]
LEVELS: tuple[Level, ...] = ("do not use", "check", "use")
"""Levels in the order in which clips are to be looked at."""


_NOTHING = 0.1
"""Low end of an interval, relative to its high end, that says no more than "at most"."""


@dataclass(frozen=True, repr=False)
class ExpectedError(Brief):
    """Hold an error before it is known: the middle of its distribution, and the interval that holds 90 %."""

    expected: float
    low: float
    high: float

    @property
    def in_words(self) -> str:
        """Return the error in words: in metres, or in millimetres where the largest is below half a metre.

        A low end that is next to nothing is left out.
        """
        unit, error = ("mm", self.times(1000.0)) if self.high < 0.5 else ("m", self)
        expected, low, high = (f"{value:.2g}" if value < 10 else f"{value:.0f}" for value in astuple(error))
        return f"{expected} {unit} ({f'{low} to' if self.low > _NOTHING * self.high else 'at most'} {high})"

    def times(self, factor: float) -> ExpectedError:
        """Return the same error in another unit."""
        return ExpectedError(factor * self.expected, factor * self.low, factor * self.high)


@dataclass(frozen=True, repr=False)
class Verdict(Brief):
    """Hold the verdict on one clip. `recon.check.verdict` makes it; docs/verdict.md says what to do with it."""

    level: Level
    reason: str
    """Reason of the level, in one sentence."""
    pose_m: ExpectedError | None = None
    """Mean distance of the joints from their true positions, both centred (MPJPE); None without a pose."""
    pose_of_trunk: ExpectedError | None = None
    """The pose's error relative to the length of the trunk."""
    position_m: ExpectedError | None = None
    """Distance of the mean of all joints from its true position, mean over the frames."""
    warned: bool = False
    """Whether the reason is a warning that errors may be larger."""

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the verdict in words: the level and its reason, and the expected errors where they are known."""
        verdict_line = f"{self.level}: {self.reason}"
        if self.pose_m is None or self.pose_of_trunk is None or self.position_m is None:
            return (verdict_line,)
        share = f"{percent(self.pose_of_trunk.expected)} of the trunk's length"
        prefix = "apart from that, " if self.warned else ""
        return (
            verdict_line,
            f"{prefix}pose off by {self.pose_m.in_words}, {share}; position by {self.position_m.in_words}",
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
OUTLIER_SIGMAS = 3.0
"""Number of standard deviations from its joint's reprojection at which a detection is an outlier."""


@dataclass(frozen=True)
class Ground:
    """Hold a plane, z = height_m + slope (2,) . (x, y), and the standard deviation of its height under the animal."""

    height_m: float
    slope: Array
    sigma_m: float
    near_zero: bool | None = None
    """Whether the ground was taken to lie near z = 0; None: nothing says that it should."""

    def about(self, origin_m: Array, size: float) -> Ground:
        """Return the ground in a scene that is scaled by the size and whose origin is at (3,)."""
        height = origin_m[2] + size * self.height_m - self.slope @ origin_m[:2]
        return replace(self, height_m=float(height), sigma_m=size * self.sigma_m)


@dataclass(frozen=True)
class SecondCamera:
    """Hold the test of the second of two cameras: how much likelier it is misplaced, or late, than as calibrated."""

    misplaced: float
    """Log-likelihood gain of a camera that is turned or moved."""
    late: float
    """Log-likelihood gain of a camera whose clock is off."""
    late_frames: float
    """Frames by which it would be late."""


@dataclass(frozen=True, repr=False)
class MotionSegment(Brief):
    """Hold a stretch of the clip that was solved by itself, as nothing was seen for long before and after.

    Segments are in order and do not overlap.
    """

    rows: slice
    """Rows of the clip."""
    ground: Ground | None
    """The ground under the feet; None where none stood."""
    prior_misfit: float | None = None
    """Misfit of the motion under the prior, about 1 where that fits; None where there is none."""
    prior_weight: float = 1.0
    """Part of its weight that the prior kept, the rest being on each angle alone; 1 where the motion fits."""
    unlike_prior: bool = False
    """Whether the motion is unlike all that the prior knows."""
    second_camera: SecondCamera | None = None
    """None where there is no second of two cameras, or its pose was not fixed."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Brief):
    """Hold an animal's motion over T frames, as every method gives it.

    It has J markers, D unknowns a frame, F feet and V views. It is in the world frame (`recon.geometry.frames`) and
    metres; NaN in frames without a pose.
    """

    method: ClassVar[str]
    """Name of the method in the report."""
    record_tag: ClassVar[str]
    """Tag of the class in files of motions (`recon.fit.motion_forms.CLASSES`)."""
    jitters: ClassVar[bool] = False
    """Whether each frame was solved by itself, so that paths jitter from frame to frame."""

    body: Body
    views: tuple[View, ...]
    """The views that it was fitted to, with the time offsets that were found."""
    states: Array
    """(T, D): the root's position is in the world; the body's lengths are those of `body` times `size`."""
    size: float
    """Factor on the skeleton's lengths; the median where a method has one for each frame."""
    joints_m: Array
    """(T, J, 3): the joints in the world, NaN without a pose."""
    covariance_m2: Array
    """(T, J, 3, 3): of the joints, position and size included."""
    relative_covariance_m2: Array
    """(T, J, 3, 3): of the joints relative to the mean of all joints."""
    angle_sigma_rad: Array
    """(T, D - 3): of the root's rotation and the joints' angles, `states[:, 3:]`."""
    angle_data_share: Array
    """(T, D - 3): information fraction of the angles, the part of their precision from the pixels, 0 to 1."""
    noise_px: Array
    """(V, T, J): for each view, the standard deviation that a detection was given."""
    weight: Array
    """(V, T, J): weight of each detection, 1 to 0, NaN where missing."""
    flags: tuple[tuple[str, ...], ...]
    """(T,): flags of each frame; a frame without a pose has one that says why."""
    alternative_m: Array
    """(T,): mean distance of the joints in the second best solution, both centred, NaN where there is none."""
    contact: Array
    """(T, F): contact of the feet with the ground, 0 to 1; 0 of a method that does not look for it."""
    segments: tuple[MotionSegment, ...]
    """Stretches of the clip that have a pose, each with its own ground."""
    stage_s: dict[str, float]
    """Seconds of the stages, by name, with all of the solution as "all"; empty where a method keeps none."""

    def findings(self) -> tuple[Finding, ...]:
        """Return what only this method can find in its own solution."""
        return ()

    def report_sections(self) -> tuple[object, ...] | None:
        """Return the method's own sections of the report (`recon.show.report`), None if they are the usual ones."""
        return None

    @property
    def constant_velocity_m_s(self) -> Array | None:
        """Return the speed of the constant-velocity starts of the search, (T,), where the method keeps it."""
        return None

    @property
    def position_lasts_s(self) -> float | None:
        """Time for which an error of the animal's position lasts, where the method estimates the path by itself."""
        return None

    @property
    def posterior_factor(self) -> float:
        """Factor by which the poses' stated standard deviations are to be enlarged for the errors that they have."""
        return 1.0

    @property
    def posed(self) -> Bools:
        """Return which frames have a pose, (T,)."""
        return np.asarray(np.isfinite(self.joints_m[:, 0, 0]))

    @cached_property
    def joints_camera_m(self) -> Array:
        """Return the joints in the first camera's frame, (T, J, 3)."""
        return self.views[0].to_camera(self.joints_m)

    @cached_property
    def markers_m(self) -> Array:
        """Return where the detector sees the joints, (T, J, 3)."""
        if not self.body.keypoint_offset_m:
            return self.joints_m
        return self.joints_m + (
            self.body.detected.pose(self.states, self.size).points_m
            - self.body.tree.pose(self.states, self.size).points_m
        )


@dataclass(frozen=True, eq=False, repr=False)
class TrajectorySolution(Solution):
    """Hold a solution of the trajectory method. Flags: "no data", "diverged", "data poor", "ambiguous depth"."""

    size_sigma: float
    """Posterior standard deviation of the size."""
    size_prior_sigma: float
    """Prior standard deviation of the size around 1."""
    size_from: tuple[str, ...]
    """Sources of the size: "prior", and where they show it "views" and "ground"."""
    data_share: Array
    """(J,): information fraction of the joints, the part of their precision from the pixels, 0 to 1."""
    alternative_cost: float
    """Cost of the second best solution minus that of the best (half squared sigmas)."""
    prior: str
    status: Literal["converged", "not_converged"]
    cost_by_term: dict[str, float]
    """Half the squared norm of the residuals, robust, by term."""
    iterations: int
    starts: int
    """Number of starts that were tried."""
    time_offset_frames: Array
    """(V,): how much later than said each camera's pictures were taken; 0 where that is not unknown."""
    time_offset_sigma_frames: Array
    """(V,): standard deviations of the time offsets."""
    extrinsic_correction: Array
    """(V, 6): correction of each camera's pose, as in `View.corrected`; 0 where it is not unknown."""
    extrinsic_correction_sigma: Array
    """(V, 6): standard deviations of the extrinsic corrections."""
    focal: Array
    """(V,): logarithm of each camera's factor on its focal lengths; 0 where it is not unknown."""
    focal_sigma: Array
    """(V,): standard deviations of the focal lengths' factors."""
    sideslip_rad: float
    """Angle, to the left, between the trunk and the direction of travel, all the time; 0 where it is not unknown."""
    sideslip_sigma_rad: float

    method: ClassVar = "trajectory"
    record_tag: ClassVar = "trajectory"

    @property
    def second_cameras(self) -> list[SecondCamera]:
        """Return the tests of the second camera, one for each segment that has one."""
        return [segment.second_camera for segment in self.segments if segment.second_camera is not None]
