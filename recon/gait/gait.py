"""Find stances, strides, duty factors, the footfall order and the name of the gait.

Feet are LH, RH, LF, RF (left and right, hind and fore). The world frame has z up and metres; the ground may lie at any
height and may slope. Paths are cubic splines on a grid of ten times the frame rate (`recon.gait.kinematics`), and
events are timed on the same grid. The mean of `body`'s joints stands for the body.

Stances: a foot may stand while its speed over the ground is below `SLOW[1]` of its own speed in the swing and its
height is below `LOW[1]` of the leg's length. Such a time is a stance if at least one instant in it is below `SLOW[0]`
and `LOW[0]` too (hysteresis). The stance lasts from the first instant below `LANDS` (`SLOW[0]` if no instant is below
`LANDS`) to the last below `LIFTS`: a foot lands flat and rolls over its toes before it lifts. A foot's speed in the
swing is its 95th percentile, or `SWING` times the body's mean speed if the clip shows less. This speed is twice the
body's at a gallop and four times the body's at a walk, because the swing is short or long, so that one threshold
relative to the body's speed cannot be right for both. The marker lies some centimetres above the sole and rises with
the heel during the stance; hence 0.15 of the leg (9 cm of 0.6 m) for a low foot, and 0.3 for the end of the push-off. A
standing foot seems to move by the error of its speed, `SPEED_ERROR` of the stated standard deviation, whose square is
subtracted first. Stances shorter than `MIN_STANCE_S` are noise. The ground is a plane through the positions of the slow
feet, fitted with Tukey weights. Clips of a few strides hardly determine its slope across the track, so the slopes have
a prior of 0 ± `SLOPE_SIGMA`. Every segment of a clip, a stretch that was reconstructed separately, has a plane of its
own. If no foot is slow, or if the slow feet are `LOW[0]` of the leg away from a plane, the ground is unknown and there
are no stances.

Standard deviations of events: the uncertainty of a foot's speed has two parts. One is the path's error, scaled to the
speed below which standing feet seem to move in nine of ten instants (`Tracks.rest_sigmas`). The other is the landing or
lift-off threshold itself, `EVENT_SIGMAS` of the speed in the swing. Divided by the foot's acceleration at the event,
their sum is a time. No event is further off than the middle of the stance. `benchmarks/gait.py` compares stances and
intervals with force plates and motion capture.

The leg's length is the median height of the body above the ground, which is the length in Froude numbers.

Strides: an animal whose four feet all stand for half a stride or more stands still, and that time is not part of a
stride. A missed stance joins two strides into one, and a stance that is cut in two splits one stride. A stride counts
if its duration is within `AGREE` of the median over all feet's strides at its time or, without such strides, over the
strides before and after; the only stride of a clip is compared with the period of the motion, if this is known. The
stride's duration is the mean over the strides that count or, in a clip without any, the period of the feet's motion
relative to the body, if the clip holds enough of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from recon.base.arrays import Array, Bools, Brief, mean, median
from recon.base.numbers import interval, length_text, percent
from recon.clip import frame_ranges
from recon.fit.posterior import radius
from recon.gait import kinematics
from recon.gait.kinematics import MIN_POINTS, Errors, Series
from recon.io.common import Pose3D

FEET: Mapping[str, str] = {"LH": "l_back_paw", "RH": "r_back_paw", "LF": "l_front_paw", "RF": "r_front_paw"}
BODY = ("neck_base", "tail_base")

OVERSAMPLING = 10
MAX_GAP_S = 0.05
"""Longest gap of a foot or the body that is interpolated. A longer gap could hide a touch-down."""
SLOW = (0.16, 0.32)
"""Speed of a foot over the ground, relative to its speed in the swing: it certainly stands below the first value, and
may stand below the second.
"""
SWING = 1.3
"""Smallest speed of a foot in the swing relative to the body's speed."""
REST = 0.5
"""Largest speed at which feet stand in poses that jitter, relative to the body's speed."""
LANDS = 0.12
"""Relative speed of a foot at touch-down, fitted to force plates."""
LIFTS = 0.22
"""Relative speed of a foot at lift-off, fitted to force plates."""
EVENT_SIGMAS = (0.05, 0.1)
"""Standard deviations of these two speeds."""
SPEED_ERROR = 0.6
"""Apparent speed of a standing foot, in standard deviations of its speed. `benchmarks/parts/gait.py --held-out` chooses
the value on two of three kinds of recordings, and times the stances of the third with this value.
"""
LOW = (0.15, 0.3)
"""Height above the ground, in leg lengths, below which a slow foot certainly stands, and below which it may stand."""
INTERVAL = 0.9
"""Probability with which the intervals contain times and duty factors."""
MIN_STANCE_S = 0.02
"""Shortest stance, far below the 0.06 s of a galloping cheetah."""
SLOPE_SIGMA = 0.1
"""Standard deviation of the ground's slopes."""
HEIGHT_SIGMA_M = 0.03
"""Standard deviation of a standing foot's marker about the plane."""

PERIOD_OF_CLIP = (0.5, 1 / 0.6)
"""Shortest and longest period that is searched for in a clip without a complete stride, in durations of the clip."""
PERIOD_SIGMA = 0.08
"""Relative standard deviation of that period, measured on a dog's strides cut to 0.7 to 1.2 of their duration."""
PERIODIC = 0.9
"""Smallest fraction of the feet's motion that the period has to explain."""
AGREE = 0.2
"""Relative tolerance of a stride's duration. A stride with a missed stance in it is twice as long, and the ends of a
correct stride are off by at most two of about ten frames.
"""

TOGETHER = 0.05
"""Largest difference, in strides, between two touch-downs of a pair that land together (bound)."""
ALTERNATE = 0.4
"""Smallest difference, in strides, between feet of a pair that alternate (0.5 is exact), as in symmetrical gaits."""
IN_PHASE = 0.125
"""Largest phase of a fore foot relative to its diagonal (trot) or same-sided (pace) hind foot: Hildebrand's eighths."""
STEADY = 0.5
"""Smallest mean resultant length of a steady phase."""
MOST = 2 / 3
"""Fraction of strides with a duty factor above one half that makes a walk, or below one half that makes a run."""


WHOLE_CLIP = "whole clip"


class StrideWords(NamedTuple):
    """How messages and figures call a stride."""

    ends: str
    """What the stride begins and ends with."""
    title: str = "one stride of {foot}"
    """Title of a figure of the stride."""
    caption: str = "a stride: the first complete one of the foot with the most strides, which begins at 0 %"
    """Part of the side view's caption."""


STRIDE_WORDS: Mapping[str, StrideWords] = {
    "given": StrideWords("as given", "the given stride", "the given stride, which begins at 0 %"),
    "gait": StrideWords("from one touch-down, or lift-off, of the foot to the next"),
    "touchdown": StrideWords("from touch-down to touch-down"),
    "lift-off": StrideWords("from lift-off to lift-off"),
    "end effector": StrideWords(
        "between two rearmost positions of the foot",
        caption="the first stride of the end effector, which begins at 0 %",
    ),
    "return": StrideWords(
        "the clip has no complete stride: from a position of the foot to its nearest return there",
        "no complete stride: nearest return of {foot}",
        "the time after which the end effector returns; 0 %: its beginning",
    ),
    WHOLE_CLIP: StrideWords(
        "the clip has no complete stride: the whole clip",
        "whole clip: no complete stride",
        "the clip, which has no complete stride, with the times of the poses",
    ),
}
"""Words for a stride by the event at its ends (`Stride.at`); "gait" is a touch-down or a lift-off, and `WHOLE_CLIP` is
used without a stride.
"""


@dataclass(frozen=True)
class Stance:
    """One stance: the time for which a foot is on the ground."""

    foot: str
    start_s: float
    end_s: float
    start_row: float
    """Row of the clip at which the stance begins, with a fraction."""
    end_row: float
    """Row of the clip at which the stance ends, with a fraction."""
    begins: bool = True
    """False if the clip, or a gap in it, cuts the beginning, so that the stance may have begun earlier."""
    ends: bool = True
    """False if the clip, or a gap in it, cuts the end."""
    start_sigma_s: float = np.nan
    """Standard deviation of the beginning, NaN if the clip cuts it."""
    end_sigma_s: float = np.nan
    """Standard deviation of the end, NaN if the clip cuts it."""

    @property
    def start_frame(self) -> float:
        """Return `start_row` by its former name; in tables, `start_frame` is the frame of the video."""
        return self.start_row

    @property
    def end_frame(self) -> float:
        """Return `end_row` by its former name."""
        return self.end_row

    @property
    def duration_s(self) -> float:
        """Return how long the foot stands, s."""
        return self.end_s - self.start_s

    @property
    def start_interval_s(self) -> tuple[float, float]:
        """Return the `INTERVAL` of the touch-down, NaN if the clip cuts the touch-down."""
        return interval_of(self.start_s, self.start_sigma_s)[1:]

    @property
    def end_interval_s(self) -> tuple[float, float]:
        """Return the `INTERVAL` of the lift-off, NaN if the clip cuts the lift-off."""
        return interval_of(self.end_s, self.end_sigma_s)[1:]


@dataclass(frozen=True)
class Plane:
    """A ground plane z = height_m + slope[0] (x - x0) + slope[1] (y - y0), centred on the slow feet."""

    middle_m: tuple[float, float]
    height_m: float
    slope: tuple[float, float]
    spread_m: float
    """Robust standard deviation of the slow feet from the plane."""
    samples: int
    """Number of samples of slow feet (fine grid). If it is 0, the plane is level through the lowest position of any
    foot.
    """

    def above(self, xyz_m: Array) -> Array:
        """Return the heights (...) of points (..., 3) above the plane."""
        return xyz_m[..., 2] - self.height_m - (xyz_m[..., :2] - self.middle_m) @ np.array(self.slope)


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Brief):
    """Motion of the F feet and of the body at the N times of the fine grid, NaN if unknown."""

    feet: tuple[str, ...]
    time_s: Array
    """The times of the N samples, shape (N,)."""
    foot_m: Array
    """The positions of the F feet, shape (N, F, 3)."""
    body_m: Array
    """The position of the body, shape (N, 3)."""
    foot_speed_m_s: Array
    """The horizontal speeds of the feet, shape (N, F)."""
    foot_speed_sigma_m_s: Array
    """Standard deviation of the feet's speeds, shape (N, F); 0 for paths without errors."""
    body_speed_m_s: Array
    """The horizontal speed of the body, shape (N,)."""
    slow_m_s: Array
    """Speeds (4, F) below which each foot certainly stands, possibly stands, has landed, and has not lifted."""
    swing_m_s: Array
    """Speed of each foot in the swing, minus its apparent speed at rest, shape (F,)."""
    height_m: Array
    """Heights of the feet above the ground, shape (N, F)."""
    grounds: tuple[tuple[slice, Plane], ...]
    """Rows of the clip and the plane under the feet in these rows, one pair for each segment of the clip."""
    leg_m: float

    @cached_property
    def rest_sigmas(self) -> float:
        """Return the speed that standing feet stay below in nine of ten instants, relative to its standard deviation.

        The value is 1 if no foot stands.
        """
        rest = (self.foot_speed_m_s < self.slow_m_s[0]) & (self.height_m < LOW[0] * self.leg_m)
        rest &= self.foot_speed_sigma_m_s > 0
        relative = self.foot_speed_m_s[rest] / self.foot_speed_sigma_m_s[rest]
        return float(np.quantile(relative, 0.9)) if len(relative) else 1.0

    def above_ground(self, xyz_m: Array) -> Array:
        """Return the heights (N, ...) of points (N, ..., 3) above their segment's ground, NaN outside all segments."""
        return _above(self.grounds, xyz_m)


@dataclass(frozen=True)
class Stride:
    """One stride: the time from one touch-down of a foot to the next.

    If the clip does not contain two touch-downs of the foot, the stride lasts from one lift-off to the next. A stride
    given by the user does not belong to a foot; its length and duty factor are NaN. `STRIDE_WORDS` describes the
    others.
    """

    foot: str
    start_s: float
    end_s: float
    length_m: float
    """Horizontal distance that the body travels during the stride."""
    duty_factor: float
    """Fraction of the stride for which the foot stands, in a stance that is completely in the clip."""
    duty_sigma: float
    """Standard deviation of the duty factor."""
    at: Literal["touchdown", "lift-off", "end effector", "return", "given"]
    """Event at the beginning and the end of the stride."""
    others_s: float = np.nan
    """For a stride that does not count, the median duration of all feet's strides around its time, or the period of the
    motion.
    """

    @property
    def origin(self) -> str:
        """Return "gait" for a stride between two touch-downs or lift-offs, otherwise `at`."""
        return "gait" if self.at in ("touchdown", "lift-off") else self.at

    @property
    def duration_s(self) -> float:
        """Return the duration of the stride, s."""
        return self.end_s - self.start_s

    @property
    def frequency_hz(self) -> float:
        """Return the number of strides per second."""
        return 1.0 / self.duration_s


@dataclass(frozen=True, repr=False)
class _GaitName(Brief):
    """Name of a gait and the reasons for it."""

    name: str
    """walk, trot, pace, bound, half-bound, rotary gallop, transverse gallop, or unknown."""
    criterion: str
    """Criterion that decided the name."""
    phase: Mapping[str, float]
    """Touch-down of each foot after the first foot's, in strides, [0, 1)."""
    duty_factor: float
    """Median over the strides, which a single cut stance does not change; NaN without strides."""
    duty_sigma: float
    """Standard deviation of the duty factor, NaN without strides. A foot's events are shifted equally in all its
    strides, so only more feet reduce it, not more strides.
    """

    @property
    def duty_interval(self) -> tuple[float, float]:
        """Return the `INTERVAL` of the duty factor."""
        _, low, high = interval_of(self.duty_factor, self.duty_sigma)
        return max(low, 0.0), min(high, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Gait(Brief):
    """Gait of a clip.

    Lengths and frequencies are means over complete strides, duty factors are medians. All are NaN without complete
    strides; `quantities` of a clip's analysis then has those by the period of the motion.
    """

    tracks: Tracks
    stances: tuple[Stance, ...]
    strides: tuple[Stride, ...]
    order: tuple[str, ...]
    """Feet in the order of their touch-downs in the clip."""
    stride_length_m: float
    stride_frequency_hz: float
    stride_s: float
    """Duration of a stride, from complete strides or the period of the pose; NaN if neither is known."""
    stride_sigma_s: float
    """Standard deviation of the duration."""
    duty_factor: Mapping[str, float]
    speed_m_s: float
    name: _GaitName
    rejected_strides: tuple[Stride, ...] = ()
    """Strides whose durations contradict the other feet. They are not in `strides`."""

    def stride_time(self, start_s: float, end_s: float) -> tuple[float, float]:
        """Return the mean duration of the strides around a time, and its standard deviation.

        If no stride around that time is complete, the values are those of the whole clip.
        """
        near = [stride for stride in self.strides if stride.start_s < end_s and stride.end_s > start_s]
        return _mean_time(near, 1) if near else (self.stride_s, self.stride_sigma_s)


_Value = TypeVar("_Value", float, Array)


def interval_of(value: _Value, sigma: _Value | float) -> tuple[_Value, _Value, _Value]:
    """Return a value and the ends of its `INTERVAL`.

    Parameters
    ----------
    value, sigma : float or ndarray
        The value and its standard deviation, in the same unit.

    Returns
    -------
    value, low, high : tuple
        The value, unchanged, and the two ends.
    """
    reach = radius(INTERVAL) * sigma
    return value, value - reach, value + reach


def interval_text(value: float, sigma: float, unit: str, sign: str = "", least: float = -np.inf) -> str:
    """Format a value with its interval, such as "16.2 m/s (90 %: 14.2 to 18.1)", or the value alone without sigma.

    If `sign` is "+", positive values get a sign. `least` is the smallest possible value.
    """
    _, low, high = interval_of(value, sigma)
    return interval(value, low, high, unit, level="90 %", sign=sign, least=least)


# -- tracks ----------------------------------------------------------------------------------------------------------


def pose_tracks(
    pose: Pose3D,
    fps: float,
    errors: Sequence[Errors] = (),
    feet: Mapping[str, str] = FEET,
    body: tuple[str, ...] = BODY,
    segments: Sequence[slice] = (slice(None),),
    restless: bool = False,
) -> Tracks:
    """Return the motion of the feet and the body on the fine grid.

    Parameters
    ----------
    pose : Pose3D
        T frames, metres, z up, NaN where missing.
    fps : float
        Frames per second.
    errors : sequence of Errors
        Errors (T, J, 3) of the positions, metres, which add up.
    feet : mapping
        Joint of each foot, by LH, RH, LF, RF.
    body : tuple of str
        Joints whose mean represents the body.
    segments : sequence of slice
        Rows of each segment, which has its own ground.
    restless : bool
        Whether the poses jitter. Standing feet then seem to move, at the 10th percentile of their speed.

    Raises
    ------
    InputError
        If the pose lacks joints; names all of them.
    ValueError
        If there are fewer than `MIN_POINTS` frames.
    """
    joint_rows, foot_count = kinematics.joint_index(pose, (*feet.values(), *body)), len(feet)
    time_s = kinematics.frame_times(pose.frames, fps)
    if len(time_s) < MIN_POINTS:
        raise ValueError(f"a gait needs at least {MIN_POINTS} frames, got {len(time_s)}")

    def path(points_m: Array, errors: Sequence[Errors] = ()) -> Series:
        return kinematics.series_kinematics(time_s, points_m, errors, oversampling=OVERSAMPLING, max_gap_s=MAX_GAP_S)

    def foot_path(at: int) -> tuple[Array, Array, Array]:
        """Return positions, speeds and standard deviations of one foot; the path of a long clip needs much memory."""
        series = path(pose.xyz_m[:, at], [error[:, at] for error in errors])
        velocity, speed = series.rate[:, :2], np.linalg.norm(series.rate[:, :2], axis=1)
        deviation = (series.rate_sigma if len(errors) else 0 * series.rate)[:, :2]
        return series.value, speed, np.linalg.norm(velocity / np.maximum(speed, 1e-9)[:, None] * deviation, axis=1)

    foot, foot_speed, foot_speed_sigma = (
        np.stack(values, axis=1) for values in zip(*map(foot_path, joint_rows[:foot_count]), strict=True)
    )
    body_path = path(pose.xyz_m[:, joint_rows[foot_count:]].mean(axis=1))
    body_speed = np.linalg.norm(body_path.rate[:, :2], axis=1)
    known_speeds = [speed[np.isfinite(speed)] if np.isfinite(speed).any() else np.zeros(1) for speed in foot_speed.T]
    rest, fast = np.array([np.percentile(speed, (10, 95)) for speed in known_speeds]).T * [[restless], [1]]
    rest = np.minimum(rest, REST * mean(body_speed))
    swing_m_s = np.maximum(fast, SWING * mean(body_speed)) - rest
    slow_m_s = rest + np.multiply.outer((*SLOW, LANDS, LIFTS), swing_m_s)
    slow = foot_speed < slow_m_s[0]
    grounds = tuple((rows, ground_plane(foot[_fine(rows)], slow[_fine(rows)])) for rows in segments)
    return Tracks(
        feet=tuple(feet),
        time_s=body_path.time_s,
        foot_m=foot,
        body_m=body_path.value,
        foot_speed_m_s=foot_speed,
        foot_speed_sigma_m_s=foot_speed_sigma,
        body_speed_m_s=body_speed,
        slow_m_s=slow_m_s,
        swing_m_s=swing_m_s,
        height_m=_above(grounds, foot),
        grounds=grounds,
        leg_m=median(_above(grounds, body_path.value)),
    )


def _fine(rows: slice) -> slice:
    """Return the rows of the fine grid between the first and the last of the clip's rows."""
    return slice((rows.start or 0) * OVERSAMPLING, None if rows.stop is None else (rows.stop - 1) * OVERSAMPLING + 1)


def _above(grounds: Sequence[tuple[slice, Plane]], xyz_m: Array) -> Array:
    above = np.full(xyz_m.shape[:-1], np.nan)
    for rows, plane in grounds:
        above[_fine(rows)] = plane.above(xyz_m[_fine(rows)])
    return above


def ground_plane(foot_m: Array, slow: Bools) -> Plane:
    """Fit a plane to the feet (N, F, 3) where they are slow (N, F).

    The fit is by least squares with Tukey's weights and a prior on the slopes. If no foot is slow, the plane is level
    through the lowest position.
    """
    points_m = foot_m[slow]
    if not len(points_m):
        lowest = float(np.nanmin(foot_m[..., 2])) if np.isfinite(foot_m).any() else np.nan
        return Plane((0.0, 0.0), lowest, (0.0, 0.0), np.nan, 0)
    middle = np.median(points_m[:, :2], axis=0)
    design = np.column_stack([np.ones(len(points_m)), points_m[:, :2] - middle])
    # Samples of the fine grid within a stance are not independent: the prior has at least the weight of one of them.
    prior = np.diag([0.0, 1.0, 1.0]) * (HEIGHT_SIGMA_M / SLOPE_SIGMA) ** 2
    weight = np.ones(len(points_m))
    parameters, spread = np.zeros(3), 0.0
    for _ in range(20):
        normal = design.T @ (weight[:, None] * design) / OVERSAMPLING + prior
        parameters = np.linalg.solve(normal, design.T @ (weight * points_m[:, 2]) / OVERSAMPLING)
        residual_m = points_m[:, 2] - design @ parameters
        spread = float(np.median(np.abs(residual_m)) / 0.6745)
        cutoff_m = 4.685 * max(spread, HEIGHT_SIGMA_M)
        weight = np.where(np.abs(residual_m) < cutoff_m, (1 - (residual_m / cutoff_m) ** 2) ** 2, 0.0)
    (x, y), (height, along_x, along_y) = middle.tolist(), parameters.tolist()
    return Plane((x, y), height, (along_x, along_y), spread, len(points_m))


# -- stances ---------------------------------------------------------------------------------------------------------


def stances(tracks: Tracks) -> tuple[Stance, ...]:
    """Return the stances of all feet in the order of their beginnings; none if the ground is unknown."""
    if why_no_ground(tracks):
        return ()
    result = [s for k in range(len(tracks.feet)) for s in _stances_of(tracks, k)]
    return tuple(sorted(result, key=lambda s: (s.start_s, s.foot)))


def why_no_ground(tracks: Tracks) -> str | None:
    """Return why the ground under the feet is unknown, or None if it is known."""
    planes = [plane for _, plane in tracks.grounds if plane.samples]
    if not planes:
        return "the ground is not known: no foot is slow enough to be standing"
    spread_m = max(plane.spread_m for plane in planes)
    if not spread_m < LOW[0] * tracks.leg_m:
        return f"the ground is not known: slow feet are {length_text(spread_m)} off a plane (median)"
    return None


def _stances_of(tracks: Tracks, k: int) -> list[Stance]:
    speed_error, height = SPEED_ERROR * tracks.foot_speed_sigma_m_s[:, k], tracks.height_m[:, k]
    speed = np.sqrt(np.maximum(tracks.foot_speed_m_s[:, k] ** 2 - speed_error**2, 0.0))
    certain_speed, largest_speed, landing_speed, lifting_speed = tracks.slow_m_s[:, k]
    slow_rows = np.flatnonzero(speed < certain_speed)
    certain_rows = slow_rows[height[slow_rows] < LOW[0] * tracks.leg_m]
    is_known = np.pad(np.isfinite(speed), 1)  # index i of the array is for the step before sample i
    result = []
    may_stand = np.less(speed, largest_speed) & np.less(height, LOW[1] * tracks.leg_m)
    for first, end in frame_ranges(np.flatnonzero(may_stand)):
        if np.any((certain_rows >= first) & (certain_rows < end)):
            stance_speed = speed[first:end]
            has_landed = stance_speed < (landing_speed if stance_speed.min() < landing_speed else certain_speed)
            landing = first + int(has_landed.argmax())
            lift_off = end - 1 - int((stance_speed < lifting_speed)[::-1].argmax())
            is_seen = bool(landing > first or is_known[first]), bool(lift_off < end - 1 or is_known[end + 1])
            start_s, end_s = (float(tracks.time_s[i]) for i in (landing, lift_off))
            sigmas = [
                _event_sigma_s(tracks, k, i, (end_s - start_s) / 2, threshold_sigma) if event_seen else np.nan
                for i, event_seen, threshold_sigma in zip((landing, lift_off), is_seen, EVENT_SIGMAS, strict=True)
            ]
            result.append(
                Stance(
                    tracks.feet[k], start_s, end_s, landing / OVERSAMPLING, lift_off / OVERSAMPLING, *is_seen, *sigmas
                )
            )
    return [s for s in result if s.duration_s >= MIN_STANCE_S or not (s.begins and s.ends)]


def _event_sigma_s(tracks: Tracks, k: int, i: int, most_s: float, threshold_sigma: float) -> float:
    """Return the standard deviation, in seconds, of an event of the k-th foot at the i-th instant.

    most_s: time from the event to the middle of the stance. threshold_sigma: standard deviation of the threshold,
    relative to the speed in the swing.
    """
    nearby = slice(max(i - OVERSAMPLING // 2, 0), i + OVERSAMPLING // 2 + 1)
    speed, time = tracks.foot_speed_m_s[nearby, k], tracks.time_s[nearby]
    known = np.isfinite(speed)
    acceleration = np.ptp(speed[known]) / np.ptp(time[known])
    path_sigma_m_s = tracks.rest_sigmas * tracks.foot_speed_sigma_m_s[i, k]
    sigma = float(np.hypot(path_sigma_m_s, threshold_sigma * tracks.swing_m_s[k]))
    return min(sigma / max(acceleration, 1e-9), most_s / radius(INTERVAL))


def match_stances(first_set: Sequence[Stance], second_set: Sequence[Stance]) -> list[tuple[Stance, Stance]]:
    """Return the pairs of overlapping stances of the same foot in which each overlaps the other most."""

    def best_match(stance: Stance, candidates: Sequence[Stance]) -> Stance | None:
        overlaps = [(min(stance.end_s, o.end_s) - max(stance.start_s, o.start_s), -i) for i, o in enumerate(candidates)]
        same_foot = [pair for pair in overlaps if pair[0] > 0 and candidates[-pair[1]].foot == stance.foot]
        return candidates[-max(same_foot)[1]] if same_foot else None

    best_pairs = [(a, b) for a in first_set if (b := best_match(a, second_set)) is not None]
    return [(a, b) for a, b in best_pairs if best_match(b, first_set) is a]


# -- strides and gait ------------------------------------------------------------------------------------------------


def gait(tracks: Tracks) -> Gait:
    """Find stances, strides and the gait's name; each foot's strides are compared with those of all feet."""
    all_stances = stances(tracks)
    all_strides = strides(tracks, all_stances)
    counted, rejected = _counted(all_strides, pose_period_s(tracks) if len(all_strides) == 1 else np.nan)
    lengths, durations = [s.length_m for s in counted], [s.duration_s for s in counted]
    duration_s, sigma_s = _stride_time(tracks, counted)
    touch_downs = sorted((s for s in all_stances if s.begins), key=lambda s: s.start_s)
    why_unknown = why_no_ground(tracks)
    if why_unknown is None and not {*FEET} <= {*tracks.feet}:
        why_unknown = f"only gaits of four feet have names; the feet here are {', '.join(tracks.feet)}"
    return Gait(
        tracks=tracks,
        stances=all_stances,
        strides=counted,
        order=tuple(s.foot for s in touch_downs),
        stride_length_m=mean(lengths),
        stride_frequency_hz=1.0 / mean(durations) if durations else np.nan,
        stride_s=duration_s,
        stride_sigma_s=sigma_s,
        duty_factor={foot: median([s.duty_factor for s in counted if s.foot == foot]) for foot in tracks.feet},
        speed_m_s=mean(tracks.body_speed_m_s),
        name=name_gait(all_stances, counted, duration_s, why_unknown),
        rejected_strides=rejected,
    )


def pose_gait(pose: Pose3D, fps: float, errors: Sequence[Errors] = (), **options) -> Gait:
    """Return the gait of a pose; options are those of `pose_tracks`.

    Raises InputError for a joint that the pose lacks, ValueError for too few frames.
    """
    return gait(pose_tracks(pose, fps, errors, **options))


def strides(tracks: Tracks, all_stances: tuple[Stance, ...]) -> tuple[Stride, ...]:
    """Return the complete strides: both touch-downs and the stance are in the clip.

    For a foot without two touch-downs, strides last from one lift-off to the next.
    """
    result, all_stand = [], _all_stand(tracks, all_stances)
    for foot in tracks.feet:
        foot_stances = [s for s in all_stances if s.foot == foot]
        landings = [(a.start_s, b.start_s, a) for a, b in pairwise(foot_stances) if a.begins and a.ends and b.begins]
        liftings = [(a.end_s, b.end_s, b) for a, b in pairwise(foot_stances) if a.ends and b.begins and b.ends]
        event: Literal["touchdown", "lift-off"] = "touchdown" if landings else "lift-off"
        for start, end, stance in landings or liftings:
            a, b = np.searchsorted(tracks.time_s, [start, end])
            # A gap in the track of a foot or of the body may hide a stance.
            step = np.diff(tracks.body_m[a : b + 1, :2], axis=0)
            is_lost = not np.isfinite(step).all() or np.isnan(tracks.foot_m[a : b + 1, tracks.feet.index(foot)]).any()
            if not is_lost and all_stand[a : b + 1].mean() < 0.5:
                length = float(np.linalg.norm(step, axis=1).sum())
                sigma_s = float(np.hypot(stance.start_sigma_s, stance.end_sigma_s))
                duty, sigma = (seconds / (end - start) for seconds in (stance.duration_s, sigma_s))
                result.append(Stride(foot, start, end, length, duty, sigma, event))
    return tuple(sorted(result, key=lambda s: (s.start_s, s.foot)))


def _all_stand(tracks: Tracks, all_stances: Sequence[Stance]) -> Bools:
    """Return a mask (N,) of the times at which all feet of a four-footed animal stand."""
    stands = np.zeros((len(tracks.time_s), len(tracks.feet)), dtype=bool)
    for stance in all_stances:
        first, stop = np.searchsorted(tracks.time_s, [stance.start_s, stance.end_s])
        stands[first:stop, tracks.feet.index(stance.foot)] = True
    return np.asarray(stands.all(axis=1) & (len(tracks.feet) >= 4))


def _counted(all_strides: tuple[Stride, ...], period_s: float) -> tuple[tuple[Stride, ...], tuple[Stride, ...]]:
    """Split strides, sorted by their beginnings, into those that count and those that do not.

    The only stride of a clip is compared with the period of the motion in seconds, unless this is NaN.
    """
    counted, rejected = [], []
    start_s, end_s, duration_s = (
        np.array([getattr(s, field) for s in all_strides]) for field in ("start_s", "end_s", "duration_s")
    )
    for stride in all_strides:
        # A long clip has thousands of strides, so only nearby strides are examined.
        longest_s = duration_s.max()
        nearby = slice(*np.searchsorted(start_s, [stride.start_s - 2 * longest_s, stride.end_s + longest_s]))
        overlapping = (start_s[nearby] < stride.end_s) & (end_s[nearby] > stride.start_s)
        others_s = median(duration_s[nearby][overlapping] if overlapping.sum() > 1 else duration_s[nearby])
        others_s = others_s if np.isnan(period_s) else period_s
        if abs(others_s * stride.frequency_hz - 1) <= AGREE:
            counted.append(stride)
        else:
            rejected.append(replace(stride, others_s=others_s))
    return tuple(counted), tuple(rejected)


def rejection_text(stride: Stride) -> str:
    """Return a sentence on why a stride does not count."""
    text = f"{stride.foot}'s stride from {stride.start_s:.3f} to {stride.end_s:.3f} s does not count"
    return f"{text}: around its time the motion repeats after {stride.others_s:.3f} s"


def _stride_time(tracks: Tracks, counted: Sequence[Stride]) -> tuple[float, float]:
    """Return the stride's duration in seconds and its standard deviation, from strides or from the period of the pose.

    Both are NaN if neither is known.
    """
    if counted:
        return _mean_time(counted, len(counted))
    period = pose_period_s(tracks)
    return period, period * PERIOD_SIGMA


def _mean_time(counted: Sequence[Stride], count: int) -> tuple[float, float]:
    """Return the mean duration of strides and the standard deviation of the mean of `count` of them."""
    durations_s = np.array([stride.duration_s for stride in counted])
    event_sigmas_s = np.array([stride.duty_sigma for stride in counted]) * durations_s
    return float(durations_s.mean()), float(np.hypot(durations_s.std() / count**0.5, np.median(event_sigmas_s)))


def pose_period_s(tracks: Tracks) -> float:
    """Return the stride's duration in a clip without a complete stride, s; NaN if unknown.

    It is the period whose first two harmonics best fit the feet's positions relative to the body, with a weak prior on
    both harmonics.
    """
    values = (tracks.foot_m - tracks.body_m[:, None])[::OVERSAMPLING].reshape(-1, 3 * len(tracks.feet))
    is_known = np.isfinite(values).all(axis=1)
    time, values = tracks.time_s[::OVERSAMPLING][is_known], values[is_known]
    if len(time) < MIN_POINTS + 5:
        return np.nan
    periods = np.linspace(*PERIOD_OF_CLIP, 100) * (time[-1] - time[0])
    phase = 2 * np.pi / periods[:, None] * (time - time.mean())
    waves = np.stack([np.ones_like(phase), *(wave(n * phase) for n in (1, 2) for wave in (np.cos, np.sin))], axis=-1)
    moment = np.einsum("pta,tf->paf", waves, values)
    prior = 1e-3 * len(time) * np.diag([0, 1, 1, 4, 4])
    amplitudes = np.linalg.solve(np.einsum("pta,ptb->pab", waves, waves) + prior, moment)
    residuals = np.sum(values**2) - np.einsum("paf,paf->p", moment, amplitudes)
    best = int(residuals.argmin())
    explained = residuals[best] < (1 - PERIODIC) * len(time) * values.var(axis=0).sum()
    return float(periods[best]) if explained and 0 < best < len(periods) - 1 else np.nan


def name_gait(
    all_stances: tuple[Stance, ...], counted: tuple[Stride, ...], stride_s: float, why_unknown: str | None = None
) -> _GaitName:
    """Name the gait by the phases of the four feet (`classify`).

    `stride_s` is the duration of a stride, NaN if unknown. `why_unknown` is the reason why stances of four feet are
    missing.
    """
    duties = np.array([s.duty_factor for s in counted])
    feet = len({s.foot for s in counted})
    duty = median(duties), float(np.sqrt(mean([s.duty_sigma**2 for s in counted]) / feet)) if feet else np.nan
    if why_unknown is None and (lacking := [foot for foot in FEET if not any(s.foot == foot for s in all_stances)]):
        why_unknown = f"no stance of {', '.join(lacking)}"
    if why_unknown is None and np.isnan(stride_s):
        why_unknown = "no complete stride, and too little of a stride to determine its duration"
    if why_unknown is not None:
        return _GaitName("unknown", why_unknown, dict.fromkeys(FEET, np.nan), *duty)
    period = float(np.median([s.duration_s for s in counted])) if counted else stride_s
    phase = {"LH": 0.0} | {foot: _lag(all_stances, "LH", foot, period) for foot in ("RH", "LF", "RF")}
    # The times of LH and a foot may not overlap in the clip: then take the phase through RH.
    for foot in ("LF", "RF"):
        if np.isnan(phase[foot]):
            phase[foot] = (phase["RH"] + _lag(all_stances, "RH", foot, period)) % 1.0
    name, criterion = classify(phase, duty[0])
    if not counted:
        criterion = f"no complete stride, but the motion has a period of {period:.2f} s: {criterion}"
        # Stances that the clip cuts are at least as long. The order of the feet is not known well enough for a walk.
        longest_s = [max(s.duration_s for s in all_stances if s.foot == foot) for foot in FEET]
        if name != "unknown" and median(longest_s) > 0.5 * period:
            name, criterion = "unknown", f"{criterion}; but the feet stand for over half of the period"
    if name in ("walk", "trot", "pace") and 1 - MOST < (share := float(np.mean(duties > 0.5))) < MOST:
        name, criterion = "unknown", f"{criterion}: over 0.5 in {percent(share)} of strides, walk or run is undecided"
    return _GaitName(name, criterion, phase, *duty)


def _lag(all_stances: tuple[Stance, ...], reference: str, foot: str, period_s: float) -> float:
    """Return the phase of a foot's touch-down after another foot's, in strides, [0, 1), as a circular mean.

    Each time is taken to the nearest touch-down of the other foot. If the clip has no touch-down of one of the feet,
    lift-offs are used. The result is NaN if it has neither, or if the times are not `STEADY`.
    """
    for is_known, event in (("begins", "start_s"), ("ends", "end_s")):
        reference_s, foot_s = (
            np.array([getattr(s, event) for s in all_stances if s.foot == label and getattr(s, is_known)])
            for label in (reference, foot)
        )
        if len(reference_s) and len(foot_s):
            lags_s = foot_s - reference_s[np.argmin(np.abs(foot_s[:, None] - reference_s), axis=1)]
            # Events that are more than a stride apart have drifted out of phase.
            nearby_s = lags_s[np.abs(lags_s) <= max(period_s, np.abs(lags_s).min())]
            resultant = np.mean(np.exp(2j * np.pi * nearby_s / period_s))
            return float(np.angle(resultant) / (2 * np.pi) % 1.0) if np.abs(resultant) >= STEADY else np.nan
    return np.nan


def classify(phase: Mapping[str, float], duty_factor: float) -> tuple[str, str]:
    """Return the name of a gait and the criterion that decided it.

    In symmetrical gaits both pairs are at least 0.4 apart. The gait is a walk if the duty factor is over 0.5; otherwise
    a trot or a pace if the fore feet land within 0.125 of the diagonal or of the same-sided hind foot. In asymmetrical
    gaits both pairs are less than 0.4 apart. The gait is a bound if both pairs land within 0.05, and a half-bound if
    only the hind pair does; otherwise it is a gallop, transverse if the same side leads (lands second) in both pairs,
    else rotary.

    Parameters
    ----------
    phase : mapping
        Touch-down of LH, RH, LF and RF, in strides.
    duty_factor : float
        Fraction of a stride for which a foot stands.

    References
    ----------
    Hildebrand, M. (1965). Science 150:701. Hildebrand, M. (1977). BioScience 27:766.
    """
    if any(np.isnan(phase[foot]) for foot in FEET):
        lacking = ", ".join(foot for foot in FEET if np.isnan(phase[foot]))
        return "unknown", f"no steady phase of {lacking} over the strides"
    hind, fore = _signed(phase["RH"] - phase["LH"]), _signed(phase["RF"] - phase["LF"])
    measured = f"hind feet {abs(hind):.2f} of a stride apart, {_first(hind)}; fore feet {abs(fore):.2f}, {_first(fore)}"
    if min(abs(hind), abs(fore)) >= ALTERNATE:
        sides = np.exp(2j * np.pi * np.array([phase["LF"] - phase["LH"], phase["RF"] - phase["RH"]]))
        lateral = float(np.angle(sides.mean()) / (2 * np.pi) % 1.0)
        measured += f"; fore {lateral:.2f} after the same-sided hind foot, duty factor {duty_factor:.2f}"
        if np.isnan(duty_factor):
            return "unknown", measured + ": walk or run is undecided"
        if duty_factor > 0.5:
            return "walk", measured
        if abs(_signed(lateral - 0.5)) <= IN_PHASE:
            return "trot", measured
        return (
            ("pace", measured)
            if abs(_signed(lateral)) <= IN_PHASE
            else ("unknown", measured + ": between trot and pace")
        )
    if max(abs(hind), abs(fore)) >= ALTERNATE:
        return "unknown", measured + ": one pair alternates, the other does not"
    if abs(hind) < TOGETHER:
        return ("bound" if abs(fore) < TOGETHER else "half-bound"), measured
    if abs(fore) < TOGETHER:
        return "unknown", measured + ": the fore pair lands together, the hind pair does not"
    leads = ["right" if lag > 0 else "left" for lag in (hind, fore)]
    kind = "transverse" if leads[0] == leads[1] else "rotary"
    return f"{kind} gallop", f"{measured}; leading: {leads[0]} hind, {leads[1]} fore"


def _first(lag: float) -> str:
    """Return which foot of a pair lands first, given the right foot's lag behind the left foot."""
    return "left first" if lag > 0 else "right first"


def _signed(phase: float) -> float:
    """Return a phase in [-0.5, 0.5)."""
    return (phase + 0.5) % 1.0 - 0.5
