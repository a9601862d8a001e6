"""What a fit gives back, as data: findings, the verdict, a `Solution`, and what the trajectory method adds."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array, Bools, Brief
from recon.clip import View

Severity = Literal["error", "warning", "note"]
"""error: the result is not to be used as it is; warning: it is to be used with care; note: nothing is wrong."""
Number = float | int | str | tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """What a check found. `recon.check.CODES` has the severity and the words of each code."""

    code: str
    severity: Severity
    frames: tuple[int, int] | None = None
    """First frame number, and the one after the last; None: the whole clip."""
    camera: str | None = None
    """The name of the camera that it is about; None: all of them, or the clip."""
    numbers: dict[str, Number] = field(default_factory=dict)
    """What says so, plain numbers and names. Radians, metres, seconds and pixels, as the names end."""

    def names(self, number: str) -> tuple[str, ...]:
        """The names that stand there; none where there is none."""
        found = self.numbers.get(number, ())
        return found if isinstance(found, tuple) else ()


Level = Literal["do not use", "check", "use"]
LEVELS: tuple[Level, ...] = ("do not use", "check", "use")
"""In the order in which they are to be looked at."""


@dataclass(frozen=True, repr=False)
class ExpectedError(Brief):
    """An error before it is known: the middle of its distribution, and the ends of the interval that holds 90 %."""

    expected: float
    low: float
    high: float

    @property
    def in_words(self) -> str:
        """The error in words: in metres, or in millimetres where the largest is below half a metre."""
        unit, error = ("mm", self.times(1000.0)) if self.high < 0.5 else ("m", self)
        expected, low, high = (f"{value:.2g}" if value < 10 else f"{value:.0f}" for value in astuple(error))
        return f"{expected} {unit} ({low} to {high})"

    def times(self, factor: float) -> ExpectedError:
        """The same in another unit."""
        return ExpectedError(factor * self.expected, factor * self.low, factor * self.high)


@dataclass(frozen=True, repr=False)
class Verdict(Brief):
    """On one clip. `recon.check.verdict` makes it; docs/verdict.md says what to do with it."""

    level: Level
    reason: str
    """Why the verdict is what it is, in one sentence."""
    pose_m: ExpectedError | None = None
    """Mean distance of the joints from their true places, both centred (MPJPE); None without a pose."""
    pose_of_trunk: ExpectedError | None = None
    """The same, relative to the length of the trunk."""
    position_m: ExpectedError | None = None
    """Distance of the mean of all joints from its true place, mean over the frames."""
    warned: bool = False
    """Whether a warning, the reason, says that errors may be larger."""

    @property
    def lines(self) -> tuple[str, ...]:
        """In words: the level and why, and what errors are expected, where that is known."""
        said = f"{self.level}: {self.reason}"
        if self.pose_m is None or self.pose_of_trunk is None or self.position_m is None:
            return (said,)
        share = f"{self.pose_of_trunk.expected:.0%} of the trunk's length"
        apart = "apart from that, " if self.warned else ""
        return said, f"{apart}pose off by {self.pose_m.in_words}, {share}; position by {self.position_m.in_words}"


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
"""The shapes of a solution's arrays: T frames, J joints, V views, D unknowns a frame, A angles, F feet."""
OUTLIER_SIGMAS = 3.0
"""A detection further than this from its joint's reprojection is named an outlier."""


@dataclass(frozen=True)
class Ground:
    """A plane: z = height_m + slope (2,) . (x, y), and the standard deviation of its height under the animal."""

    height_m: float
    slope: Array
    sigma_m: float
    near_zero: bool | None = None
    """Whether it was taken to lie near z = 0; None: nothing says that it should."""

    def about(self, origin_m: Array, size: float) -> Ground:
        """The same where the scene is scaled and its origin lies at (3,)."""
        height = origin_m[2] + size * self.height_m - self.slope @ origin_m[:2]
        return replace(self, height_m=float(height), sigma_m=size * self.sigma_m)


@dataclass(frozen=True)
class SecondCamera:
    """How much likelier the second of two cameras is turned or moved, or late by so many frames, than as well placed
    and in step as cameras are, as logarithms."""

    misplaced: float
    late: float
    late_frames: float


@dataclass(frozen=True, repr=False)
class MotionSegment(Brief):
    """A stretch of the clip that was solved by itself, as nothing was seen for long before and after: its rows, and the
    ground under its feet, None where none stood. Segments lie in their order, and apart."""

    rows: slice
    ground: Ground | None
    prior_misfit: float | None = None
    """The misfit of the motion under the prior, about 1 where that fits; None where there is none."""
    prior_weight: float = 1.0
    """The part of its weight that the prior kept, each angle on its own having the rest; 1 where the motion fits."""
    unlike_prior: bool = False
    """The motion is none that the prior knows."""
    second_camera: SecondCamera | None = None
    """None where there is no second of two, or its pose was not held."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Brief):
    """An animal's motion over T frames, as every method gives it: J markers, D unknowns a frame, F feet, V views. In
    the world frame (`recon.geometry.frames`) and metres; NaN in frames without a pose."""

    method: ClassVar[str]
    """What the report calls it."""
    described_by: ClassVar[str] = "recon.show.report"
    """The module whose `SECTIONS` are what is said of such a solution (`recon.show.report.Section`)."""
    jitters: ClassVar[bool] = False
    """Whether each frame was solved by itself, so that paths jitter from frame to frame."""

    body: Body
    views: tuple[View, ...]
    """What it was fitted to, with the time offsets that were found."""
    states: Array
    """(T, D): the root's place is in the world; the body's lengths are those of `body` times `size`."""
    size: float
    """The factor on the skeleton's lengths; the median where a method has one for each frame."""
    joints_m: Array
    """The joints in the world, shape (T, J, 3), NaN without a pose."""
    covariance_m2: Array
    """(T, J, 3, 3): of the joints, place and size included."""
    relative_covariance_m2: Array
    """(T, J, 3, 3): of the joints relative to the mean of all joints."""
    angle_sigma_rad: Array
    """(T, D - 3): of the root's rotation and the joints' angles, `states[:, 3:]`."""
    angle_data_share: Array
    """(T, D - 3): the part of their precision that comes from the pixels, 0 to 1."""
    noise_px: Array
    """(V, T, J): for each view, the standard deviation that a detection was given."""
    weight: Array
    """(V, T, J): how far it was trusted, 1 to 0, NaN where missing."""
    flags: tuple[tuple[str, ...], ...]
    """(T,): what is doubtful about a frame; a frame without a pose has one that says why."""
    alternative_m: Array
    """(T,): mean distance of the joints in the second best solution, both centred, NaN where there is none."""
    contact: Array
    """(T, F): of the feet with the ground, 0 to 1; 0 of a method that does not look for it."""
    segments: tuple[MotionSegment, ...]
    """The stretches of the clip that have a pose, each with its own ground."""
    stage_s: dict[str, float]
    """Seconds that it took to solve (all), and what came before, by name; empty where a method keeps none."""

    def findings(self) -> tuple[Finding, ...]:
        """What only this method can say of its own solution."""
        return ()

    @property
    def constant_velocity_m_s(self) -> Array | None:
        """(T,): the speed of the constant-velocity starts of the search, where the method keeps it."""
        return None

    @property
    def posed(self) -> Bools:
        """(T,): frames that have a pose."""
        return np.asarray(np.isfinite(self.joints_m[:, 0, 0]))

    @cached_property
    def joints_camera_m(self) -> Array:
        """(T, J, 3) in the first camera's frame."""
        return self.views[0].to_camera(self.joints_m)

    @cached_property
    def markers_m(self) -> Array:
        """(T, J, 3): where the detector sees the joints."""
        if not self.body.keypoint_offset_m:
            return self.joints_m
        return self.joints_m + (
            self.body.detected.pose(self.states, self.size).points_m
            - self.body.tree.pose(self.states, self.size).points_m
        )


@dataclass(frozen=True, eq=False, repr=False)
class TrajectorySolution(Solution):
    """A solution of the trajectory method. Flags: "no data", "diverged", "data poor", "ambiguous depth"."""

    size_sigma: float
    """The posterior standard deviation of the size."""
    size_prior_sigma: float
    """The standard deviation that the size was expected to have around 1."""
    size_from: tuple[str, ...]
    """What says the size: "prior", and where they do "views" and "ground"."""
    data_share: Array
    """(J,): the part of the posterior precision that comes from the pixels, 0 to 1."""
    alternative_cost: float
    """By how much the second best solution's cost is higher (half squared sigmas)."""
    prior: str
    status: Literal["converged", "not_converged"]
    cost_by_term: dict[str, float]
    """Half the squared norm, robust."""
    iterations: int
    starts: int
    """How many starts were tried."""
    time_offset_frames: Array
    """(V,): how much later than said each camera's pictures were taken, where several cameras show it, else 0."""
    time_offset_sigma_frames: Array
    """(V,): their standard deviations; 0 of a time offset that is not an unknown."""
    extrinsic_correction: Array
    """(V, 6): how far each camera lies beside its pose, as in `View.corrected`; 0 where that is not an unknown."""
    extrinsic_correction_sigma: Array
    """Standard deviations of the extrinsic corrections, shape (V, 6)."""
    focal: Array
    """(V,): the logarithm of each camera's factor on its focal lengths; 0 where that is not an unknown."""
    focal_sigma: Array
    """Standard deviations of the focal lengths' factors, shape (V,)."""
    sideslip_rad: float
    """By how much the animal goes to the left of where it looks, all the time; 0 where that is not an unknown."""
    sideslip_sigma_rad: float

    method: ClassVar = "trajectory"

    @property
    def second_cameras(self) -> list[SecondCamera]:
        return [segment.second_camera for segment in self.segments if segment.second_camera is not None]
