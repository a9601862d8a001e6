"""Find the stances of the feet, with the standard deviations of touch-down and lift-off, and the plane of the ground.

Feet are LH, RH, LF, RF (left and right, hind and fore). Positions are in metres in a world frame with z up. The ground
may lie at any height and may slope. Paths are cubic splines on a grid of ten times the frame rate
(`recon.gait.kinematics`), and touch-downs and lift-offs are timed on this grid. The mean of the `body` joints
represents the body.

A foot may stand while its speed over the ground is below `SLOW_SPEEDS[1]` of its own speed in the swing and its height
is below `LOW_HEIGHTS[1]` of the leg length. This time is a stance if at least one instant in it is also below
`SLOW_SPEEDS[0]` and `LOW_HEIGHTS[0]` (hysteresis). The stance lasts from the first instant below `TOUCH_DOWN_SPEED`
(`SLOW_SPEEDS[0]` if no instant is below `TOUCH_DOWN_SPEED`) to the last below `LIFT_OFF_SPEED`. The two thresholds
differ because a foot lands flat but rolls over its toes before it lifts. A foot's speed in the swing is the 95th
percentile of its speed, or `MIN_SWING_SPEED` times the body's mean speed if the percentile is lower. The speed in the
swing is twice the body's speed at a gallop and four times at a walk, so that no single threshold relative to the body's
speed suits both. The marker lies some centimetres above the sole and rises with the heel during the stance. A foot
therefore counts as low below 0.15 of the leg length (9 cm of 0.6 m), and below 0.3 at the end of the push-off. A
standing foot seems to move because of the error of its speed, which is `SPEED_ERROR` of the stated standard deviation.
The square of this error is subtracted first. Stances shorter than `MIN_STANCE_S` are noise.

The ground is a plane through the positions of the slow feet, fitted with Tukey weights. Clips of a few strides hardly
determine its slope across the track, so the slopes have a prior of 0 ± `SLOPE_SIGMA`. Every segment of a clip, which is
a stretch that was reconstructed separately, has its own plane. If no foot is slow, or if the slow feet are more than
`LOW_HEIGHTS[0]` of the leg length away from a plane, the ground is unknown and there are no stances.

The standard deviation of a touch-down or lift-off is an uncertainty of the foot's speed, divided by the foot's
acceleration at this time. It has two parts. One is the error of the speed, scaled to the apparent speed that standing
feet do not exceed in nine of ten instants (`Tracks.rest_sigmas`). The other is the uncertainty of the threshold,
`EVENT_SIGMAS` of the speed in the swing. The 90 % interval reaches at most to the middle of the stance.
`benchmarks/gait.py` compares stances and intervals with force plates and motion capture.

The leg length is the median height of the body above the ground, as used in Froude numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from recon.base.arrays import Array, Bools, Brief, mean, median
from recon.base.numbers import interval, length_text
from recon.clip import frame_ranges
from recon.fit.regions import radius
from recon.gait import kinematics
from recon.gait.series import Errors, Series, series_kinematics
from recon.gait.spline import MIN_POINTS
from recon.io.common import Pose3D

FEET: Mapping[str, str] = {"LH": "l_back_paw", "RH": "r_back_paw", "LF": "l_front_paw", "RF": "r_front_paw"}
FOOT_ROWS = ("LH", "RH", "RF", "LF")
"""Feet in the order of their rows in figures and on pages, from the top."""
BODY = ("neck_base", "tail_base")

OVERSAMPLING = 10
MAX_GAP_S = 0.05
"""Longest gap in the path of a foot or the body that is interpolated, s. A longer gap could hide a touch-down."""
SLOW_SPEEDS = (0.16, 0.32)
"""Maximum speeds of a foot that certainly stands and of a foot that may stand, as fractions of its swing speed."""
MIN_SWING_SPEED = 1.3
"""Minimum speed of a foot in the swing, as a multiple of the body's mean speed."""
MAX_REST_SPEED = 0.5
"""Maximum apparent speed of feet in stance due to jitter of the poses, as a fraction of the body's speed."""
TOUCH_DOWN_SPEED = 0.12
"""Speed of a foot at touch-down, as a fraction of its speed in the swing, fitted to force plate measurements."""
LIFT_OFF_SPEED = 0.22
"""Speed of a foot at lift-off, as a fraction of its speed in the swing, fitted to force plate measurements."""
EVENT_SIGMAS = (0.05, 0.1)
"""Standard deviations of a foot's speed at touch-down and at lift-off, as fractions of its speed in the swing."""
SPEED_ERROR = 0.6
"""Apparent speed of a standing foot, in standard deviations of its speed. `benchmarks/parts/gait.py --held-out` chooses
the value on two of three kinds of recordings and tests it on the stances of the third.
"""
LOW_HEIGHTS = (0.15, 0.3)
"""Maximum heights, in leg lengths, of a slow foot that certainly stands and of a slow foot that may stand."""
INTERVAL = 0.9
"""Probability that the stated interval of a time or a duty factor contains the true value."""
MIN_STANCE_S = 0.02
"""Shortest duration of a stance, s.

The stances of galloping cheetahs last 0.06 s or more (`python benchmarks/gait.py --only stances`).
"""
SLOPE_SIGMA = 0.1
"""Standard deviation of the prior on the slopes of the ground, in metres per metre."""
HEIGHT_SIGMA_M = 0.03
"""Standard deviation of a standing foot's marker about the ground plane."""


@dataclass(frozen=True)
class Stance:
    """Stance of a foot, which is on the ground from `start_s` to `end_s`."""

    foot: str
    start_s: float
    end_s: float
    start_row: float
    """Index of the frame at which the stance begins, which may lie between two frames."""
    end_row: float
    """Index of the frame at which the stance ends, which may lie between two frames."""
    begins: bool = True
    """False if the clip, or a gap in it, cuts the beginning, so that the stance may have begun earlier."""
    ends: bool = True
    """False if the clip, or a gap in it, cuts the end, so that the stance may have ended later."""
    start_sigma_s: float = np.nan
    """Standard deviation of the touch-down; NaN if the clip cuts the beginning."""
    end_sigma_s: float = np.nan
    """Standard deviation of the lift-off; NaN if the clip cuts the end."""

    @property
    def start_frame(self) -> float:
        """Return `start_row` under its former name. In tables, `start_frame` is the frame number in the video."""
        return self.start_row

    @property
    def end_frame(self) -> float:
        """Return `end_row` under its former name."""
        return self.end_row

    @property
    def duration_s(self) -> float:
        """Return the duration of the stance, s."""
        return self.end_s - self.start_s

    @property
    def start_interval_s(self) -> tuple[float, float]:
        """Return the ends of the 90 % interval of the touch-down, s; NaN if the clip cuts the touch-down."""
        return interval_of(self.start_s, self.start_sigma_s)[1:]

    @property
    def end_interval_s(self) -> tuple[float, float]:
        """Return the ends of the 90 % interval of the lift-off, s; NaN if the clip cuts the lift-off."""
        return interval_of(self.end_s, self.end_sigma_s)[1:]


@dataclass(frozen=True)
class Plane:
    """Plane of the ground, z = height_m + slope[0] (x - x0) + slope[1] (y - y0), fitted to the slow feet."""

    middle_m: tuple[float, float]
    height_m: float
    slope: tuple[float, float]
    spread_m: float
    """Robust standard deviation of the slow feet's heights above the plane."""
    samples: int
    """Number of positions of slow feet on the fine grid to which the plane was fitted.

    If there are none, the plane is horizontal through the lowest position of any foot.
    """

    def above(self, xyz_m: Array) -> Array:
        """Return the heights of points (..., 3) above the plane, m, shape (...)."""
        return xyz_m[..., 2] - self.height_m - (xyz_m[..., :2] - self.middle_m) @ np.array(self.slope)


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Brief):
    """Motion of F feet and of the body at the N times of the fine grid; NaN where unknown."""

    feet: tuple[str, ...]
    time_s: Array
    """Times of the samples, shape (N,)."""
    foot_m: Array
    """Positions of the feet, shape (N, F, 3)."""
    body_m: Array
    """Mean position of the joints that represent the body, shape (N, 3)."""
    foot_speed_m_s: Array
    """Horizontal speeds of the feet, shape (N, F)."""
    foot_speed_sigma_m_s: Array
    """Standard deviation of the feet's speeds, shape (N, F); 0 for paths without errors."""
    body_speed_m_s: Array
    """Horizontal speed of the body, shape (N,)."""
    slow_m_s: Array
    """Four thresholds of each foot's speed, shape (4, F).

    Below them, the foot certainly stands, may stand, has touched down, and has not yet lifted off.
    """
    swing_m_s: Array
    """Speed of each foot in the swing, minus its apparent speed at rest, shape (F,)."""
    height_m: Array
    """Heights of the feet above the ground, shape (N, F)."""
    grounds: tuple[tuple[slice, Plane], ...]
    """Frames of each segment of the clip, as a slice, with the segment's plane of the ground."""
    leg_m: float

    @cached_property
    def rest_sigmas(self) -> float:
        """Return the 90th percentile of the apparent speed of feet in stance.

        The unit is the stated standard deviation of the speed. Return 1 if there is no stance.
        """
        rest = (self.foot_speed_m_s < self.slow_m_s[0]) & (self.height_m < LOW_HEIGHTS[0] * self.leg_m)
        rest &= self.foot_speed_sigma_m_s > 0
        relative = self.foot_speed_m_s[rest] / self.foot_speed_sigma_m_s[rest]
        return float(np.quantile(relative, 0.9)) if len(relative) else 1.0

    def above_ground(self, xyz_m: Array) -> Array:
        """Return the heights of points (N, ..., 3) above the ground of their segment, m, shape (N, ...).

        The heights are NaN outside all segments.
        """
        return _above(self.grounds, xyz_m)


_Value = TypeVar("_Value", float, Array)


def interval_of(value: _Value, sigma: _Value | float) -> tuple[_Value, _Value, _Value]:
    """Return a value, unchanged, and the lower and the upper end of its 90 % interval.

    `sigma` is the standard deviation of the value, in the same unit.
    """
    reach = radius(INTERVAL) * sigma
    return value, value - reach, value + reach


def interval_text(value: float, sigma: float, unit: str, sign: str = "", least: float = -np.inf) -> str:
    """Return a value with its interval as text, such as "16.2 m/s (90 %: 14.2 to 18.1)".

    If `sigma` is not known, the text is the value alone. If `sign` is "+", positive values get a sign. `least` is the
    smallest possible value, which limits the interval.
    """
    _, low, high = interval_of(value, sigma)
    return interval(value, low, high, unit, level="90 %", sign=sign, least=least)


def pose_tracks(
    pose: Pose3D,
    fps: float,
    errors: Sequence[Errors] = (),
    feet: Mapping[str, str] = FEET,
    body: tuple[str, ...] = BODY,
    segments: Sequence[slice] = (slice(None),),
    restless: bool = False,
) -> Tracks:
    """Return the motion of the feet and the body on the fine grid, and the plane of the ground, for `stances`.

    Parameters
    ----------
    pose : Pose3D
        Positions of the joints in T frames, metres, z up, NaN where missing.
    fps : float
        Frames per second.
    errors : sequence of Errors
        Independent errors of the joints' positions, each (T, J, 3), metres.
    feet : mapping
        Name of each foot's joint, with LH, RH, LF and RF as keys.
    body : tuple of str
        Names of the joints whose mean position represents the body.
    segments : sequence of slice
        Frames of each segment of the clip, which has its own plane of the ground, as slices of the pose.
    restless : bool
        Whether the poses jitter. If so, the 10th percentile of a foot's speed counts as its apparent speed at rest.

    Raises
    ------
    InputError
        If the pose lacks joints. The error names all missing joints.
    ValueError
        If there are fewer than `MIN_POINTS` frames.
    """
    joint_rows, foot_count = kinematics.joint_index(pose, (*feet.values(), *body)), len(feet)
    time_s = kinematics.frame_times(pose.frames, fps)
    if len(time_s) < MIN_POINTS:
        raise ValueError(f"a gait needs at least {MIN_POINTS} frames, got {len(time_s)}")

    def path(points_m: Array, errors: Sequence[Errors] = ()) -> Series:
        grid = {"oversampling": OVERSAMPLING, "max_gap_s": MAX_GAP_S}
        # Only the standard deviations of the rates are used.
        return series_kinematics(time_s, points_m, errors, propagate=(1,), **grid)

    def foot_path(at: int) -> tuple[Array, Array, Array]:
        """Return positions (N, 3), speeds (N,) and the speeds' standard deviations (N,) of the foot with index `at`."""
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
    rest = np.minimum(rest, MAX_REST_SPEED * mean(body_speed))
    swing_m_s = np.maximum(fast, MIN_SWING_SPEED * mean(body_speed)) - rest
    slow_m_s = rest + np.multiply.outer((*SLOW_SPEEDS, TOUCH_DOWN_SPEED, LIFT_OFF_SPEED), swing_m_s)
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
    """Return the slice of the fine grid from the first to the last of the given frames."""
    return slice((rows.start or 0) * OVERSAMPLING, None if rows.stop is None else (rows.stop - 1) * OVERSAMPLING + 1)


def _above(grounds: Sequence[tuple[slice, Plane]], xyz_m: Array) -> Array:
    above = np.full(xyz_m.shape[:-1], np.nan)
    for rows, plane in grounds:
        above[_fine(rows)] = plane.above(xyz_m[_fine(rows)])
    return above


def ground_plane(foot_m: Array, slow: Bools) -> Plane:
    """Return a plane fitted to the positions (N, F, 3), m, of the feet, where the mask `slow` (N, F) is true.

    The fit uses least squares with Tukey weights and a prior on the slopes. If no foot is slow, the plane is horizontal
    through the lowest position.
    """
    points_m = foot_m[slow]
    if not len(points_m):
        lowest = float(np.nanmin(foot_m[..., 2])) if np.isfinite(foot_m).any() else np.nan
        return Plane((0.0, 0.0), lowest, (0.0, 0.0), np.nan, 0)
    middle = np.median(points_m[:, :2], axis=0)
    design = np.column_stack([np.ones(len(points_m)), points_m[:, :2] - middle])
    # Samples within a stance are not independent, so the prior has at least the weight of one sample.
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


def stances(tracks: Tracks) -> tuple[Stance, ...]:
    """Return the stances of all feet in the order of their start times, or () if the ground is unknown."""
    if why_no_ground(tracks):
        return ()
    result = [s for k in range(len(tracks.feet)) for s in _stances_of(tracks, k)]
    return tuple(sorted(result, key=lambda s: (s.start_s, s.foot)))


def why_no_ground(tracks: Tracks) -> str | None:
    """Return the reason why the plane of the ground is unknown, or None if it is known."""
    planes = [plane for _, plane in tracks.grounds if plane.samples]
    if not planes:
        return "the ground is not known, because no foot is slow enough to be standing"
    spread_m = max(plane.spread_m for plane in planes)
    if not spread_m < LOW_HEIGHTS[0] * tracks.leg_m:
        return f"the ground is not known, because slow feet are {length_text(spread_m)} (median) from a common plane"
    return None


def _stances_of(tracks: Tracks, k: int) -> list[Stance]:
    speed_error, height = SPEED_ERROR * tracks.foot_speed_sigma_m_s[:, k], tracks.height_m[:, k]
    speed = np.sqrt(np.maximum(tracks.foot_speed_m_s[:, k] ** 2 - speed_error**2, 0.0))
    certain_speed, largest_speed, landing_speed, lifting_speed = tracks.slow_m_s[:, k]
    slow_rows = np.flatnonzero(speed < certain_speed)
    certain_rows = slow_rows[height[slow_rows] < LOW_HEIGHTS[0] * tracks.leg_m]
    is_known = np.pad(np.isfinite(speed), 1)  # element i belongs to sample i - 1
    result = []
    may_stand = np.less(speed, largest_speed) & np.less(height, LOW_HEIGHTS[1] * tracks.leg_m)
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
    """Return the standard deviation of a touch-down or lift-off of foot k at sample i, s.

    `most_s` is the maximum half-width of the 90 % interval, the time from the event to the middle of the stance, s.
    `threshold_sigma` is the standard deviation of the speed threshold, relative to the speed in the swing.
    """
    nearby = slice(max(i - OVERSAMPLING // 2, 0), i + OVERSAMPLING // 2 + 1)
    speed, time = tracks.foot_speed_m_s[nearby, k], tracks.time_s[nearby]
    known = np.isfinite(speed)
    acceleration = np.ptp(speed[known]) / np.ptp(time[known])
    path_sigma_m_s = tracks.rest_sigmas * tracks.foot_speed_sigma_m_s[i, k]
    sigma = float(np.hypot(path_sigma_m_s, threshold_sigma * tracks.swing_m_s[k]))
    return min(sigma / max(acceleration, 1e-9), most_s / radius(INTERVAL))
