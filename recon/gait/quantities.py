"""Summarise a clip's gait by speed, strides, steps, limb phases and asymmetry, each with its uncertainty.

The standard deviation of a mean has four independent parts:

- the standard error from the scatter of the strides
- the errors of touch-down and lift-off, which are the same in all strides of a foot, so that only more feet reduce them
- the error of the animal's path
- errors common to the whole clip, which are proportional to the value: the error of the animal's size, which scales all
  lengths seen by a single camera, and the error of the focal length, which scales the distance from the camera and thus
  the motion along the line of sight

If no foot completes a stride, the stride duration is the period of the motion (`recon.gait.gait.pose_period_s`). The
stride length is then the speed times the period, and the duty factor is the duration of complete stances divided by the
period. A period much longer than the clip is not used.

The asymmetry is (left - right) / mean of both. Errors of touch-down and lift-off that are equal for both feet cancel.
Errors that differ from stride to stride contribute to the scatter of the strides. The asymmetry is not computed if the
pose of one side comes from the prior rather than from the video.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from recon.base.arrays import Array, mean
from recon.base.numbers import percent
from recon.fit.motion import MEASURED_FRACTION, Motion
from recon.fit.result import TrajectorySolution
from recon.gait.gait import NO_PERIOD, Gait, Stride
from recon.gait.kinematics import JointKinematics
from recon.gait.series import Errors
from recon.gait.stances import Stance, interval_of

Origin = Literal["path", "footfalls", "period of the motion"]
PAIRS = {"fore": ("LF", "RF"), "hind": ("LH", "RH")}
"""Left and right foot of the fore and of the hind limbs."""
NEXT_STEP = 0.6
"""Longest time between the touch-downs of the left and the right foot that counts as a step, in strides.

A step takes half a stride in symmetrical gaits, to which the value adds a margin of 0.1 strides.
"""
MAX_PERIOD = 1.3
"""Longest period of the motion that is used as the stride duration, as a multiple of the clip's duration.

A clip that is much shorter than a stride does not determine the period.
"""
MIN_STRIDES = 3
"""Minimum number of strides of each foot required to compute an asymmetry."""
SIDE_SIGMA = {"stance": 0.05, "excursion": 0.02}
"""Standard deviation of the apparent asymmetry that results if a single camera sees one side better than the other.

With these values, the intervals have the correct coverage for a dog's walks and runs (`python benchmarks/gait.py --only
asymmetry`).
"""


@dataclass(frozen=True, eq=False)
class AnalysedClip:
    """Parts of a clip's analysis from which the quantities of the gait are computed."""

    motion: Motion
    gait: Gait | None
    errors: Sequence[Errors]
    reference_motion: JointKinematics
    """Motion of the reference joint, with standard deviations from all errors."""
    unsized_motion: JointKinematics
    """Motion of the reference joint, with standard deviations from all errors except the error of the animal's size."""
    why_no_speed: str | None


@dataclass(frozen=True)
class GaitQuantity:
    """A quantity of a clip's gait with its uncertainty."""

    name: str
    """Name of the quantity with its unit, such as stride_length_m."""
    value: float
    """Value of the quantity; NaN if unknown."""
    sigma: float
    """Standard deviation of the value from all errors; NaN if unknown."""
    own_sigma: float
    """Standard deviation from errors that differ between clips, without errors of the size and the focal length."""
    between_sigma: float
    """Standard deviation of the quantity between strides; NaN for fewer than two strides."""
    count: int
    """Number of strides or steps in the mean; 0 if the value comes from the path or the period of the motion."""
    source: Origin
    bounds: tuple[float, float] = (-np.inf, np.inf)
    """Smallest and largest possible value of the quantity."""
    why_unknown: str = ""
    """Reason why the value is unknown; empty if it is known."""

    @property
    def interval(self) -> tuple[float, float]:
        """Return the ends of the 90 % interval, limited to `bounds`."""
        low, high = interval_of(self.value, self.sigma)[1:]
        least, greatest = self.bounds
        return (low, high) if np.isnan(low) else (float(max(low, least)), float(min(high, greatest)))


def gait_quantities(analysis: AnalysedClip) -> dict[str, GaitQuantity]:
    """Return a dictionary of the quantities of a clip's gait, with their names as keys.

    Lengths and speeds are in metres and metres per second, phases in strides after the left hind foot's touch-down,
    asymmetries relative to the mean of both sides. For a chain without feet, the only quantity is the speed.
    """
    quantities = [_speed(analysis)]
    if (gait := analysis.gait) is not None:
        gait = _without_long_period(gait)
        quantities += _stride_quantities(analysis, gait, quantities[0])
        quantities += _duty_factors(gait)
        quantities += _phases(gait)
        for girdle, feet in PAIRS.items():
            if {*feet} <= {*gait.tracks.feet}:
                quantities += [_overlap(gait, girdle, feet), _step_width(analysis, gait, girdle, feet)]
                quantities += _asymmetries(analysis, gait, girdle, feet)
    return {quantity.name: quantity for quantity in quantities}


def shared_sigma(motion: Motion) -> float:
    """Return the relative standard deviation that all lengths of a clip share, due to animal size and focal length."""
    return float(np.hypot(_size_sigma(motion), _focal_sigma(motion)))


def shared_sigma_columns(motion: Motion) -> dict[str, float]:
    """Return a dictionary of the relative standard deviations that `recon compare` needs to combine cameras.

    `size_sigma` is the standard deviation that lengths share (`shared_sigma`). `size_prior_sigma` is the standard
    deviation of the animal's size before the fit. `focal_sigma` is the standard deviation of the speed due to the focal
    length alone.
    """
    size_sigma, prior_sigma = _size_sigma(motion), getattr(motion.solution, "size_prior_sigma", None) or 0.0
    return {
        "size_sigma": shared_sigma(motion),
        "size_prior_sigma": max(prior_sigma / motion.solution.size, size_sigma) if size_sigma else 0.0,
        "focal_sigma": _focal_sigma(motion),
    }


def _size_sigma(motion: Motion) -> float:
    """Return the relative standard deviation of the animal's size, which scales all lengths; 0 with several cameras."""
    solution = motion.solution
    size_sigma: float | None = getattr(solution, "size_sigma", None)
    return 0.0 if size_sigma is None or len(solution.views) > 1 else size_sigma / solution.size


def _focal_sigma(motion: Motion) -> float:
    """Return the relative standard deviation of the speed due to the error of the focal length.

    The focal length f scales the distance from the camera. An error of f therefore scales u, the component of the speed
    v along the line of sight, so that dv / v = (u / v)^2 df / f.
    """
    solution = motion.solution
    if not isinstance(solution, TrajectorySolution) or len(solution.views) != 1 or not solution.focal_sigma[0] > 0:
        return 0.0
    root_m = motion.root_m[motion.solved]
    if len(root_m) < 2:
        return 0.0
    travel_m, centre_m = root_m[-1] - root_m[0], np.asarray(solution.views[0].centre_m).reshape(-1, 3)[0]
    sight_m = root_m.mean(axis=0) - centre_m
    cosine = travel_m @ sight_m / max(float(np.linalg.norm(travel_m) * np.linalg.norm(sight_m)), 1e-9)
    return float(cosine**2 * solution.focal_sigma[0])


def path_speed_sigma(errors: Sequence[Errors], moved: JointKinematics, start_s: float, end_s: float) -> float:
    """Return the standard deviation of the mean speed between two times, m/s.

    Errors of the path are correlated in time, so only times that are far enough apart count as independent. `errors`
    are the independent errors of the path, and `moved` is the motion along the path.
    """
    sigma = moved.speed_sigma_m_s[(moved.series.time_s >= start_s) & (moved.series.time_s <= end_s)]
    lasting_s = max(error.correlation_s for error in errors if error.correlation_s < np.inf)
    independent = max(1.0, (end_s - start_s) / (2 * lasting_s))
    return float(np.sqrt(np.nanmean(sigma**2) / independent)) if np.isfinite(sigma).any() else np.nan


def _speed(analysis: AnalysedClip) -> GaitQuantity:
    moved = analysis.unsized_motion
    if analysis.why_no_speed is not None:
        return _unknown("speed_m_s", "path", analysis.why_no_speed)
    value = analysis.reference_motion.mean_speed_m_s
    unshared = path_speed_sigma(analysis.errors, moved, *analysis.motion.time_s[[0, -1]])
    return _quantity("speed_m_s", value, unshared, shared_sigma(analysis.motion) * value, "path", bounds=(0.0, np.inf))


def _quantity(
    name: str,
    value: float,
    unshared: float,
    shared: float,
    source: Origin,
    between: float = np.nan,
    count: int = 0,
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> GaitQuantity:
    return GaitQuantity(name, value, float(np.hypot(unshared, shared)), unshared, between, count, source, bounds)


def _unknown(name: str, source: Origin, reason: str) -> GaitQuantity:
    return GaitQuantity(name, np.nan, np.nan, np.nan, np.nan, 0, source, why_unknown=reason)


def _scatter(values: Array) -> tuple[float, float]:
    """Return the standard deviation of values (N,) and of their mean; NaN and 0 for a single value."""
    if len(values) < 2:
        return np.nan, 0.0
    between = float(np.std(values, ddof=1))
    return between, between / len(values) ** 0.5


def event_sigma_s(stride: Stride) -> float:
    """Return the standard deviation of the time between two touch-downs or two lift-offs of a stride's foot, s."""
    return stride.duty_sigma * stride.duration_s


def _stride_quantities(analysis: AnalysedClip, gait: Gait, speed: GaitQuantity) -> Iterator[GaitQuantity]:
    positive = (0.0, np.inf)
    if not gait.strides:
        yield from _by_period(gait, speed)
        return
    strides, count = gait.strides, len(gait.strides)
    feet = len({stride.foot for stride in strides})
    lengths, durations = (np.array([getattr(s, name) for s in strides]) for name in ("length_m", "duration_s"))
    events_s = np.sqrt(np.mean([event_sigma_s(stride) ** 2 for stride in strides]) / feet)
    duration_between, duration_scatter = _scatter(durations)
    duration_sigma = float(np.hypot(duration_scatter, events_s))
    yield _quantity(
        "stride_s", float(durations.mean()), duration_sigma, 0.0, "footfalls", duration_between, count, positive
    )
    moved = analysis.unsized_motion
    first_s, last_s = min(s.start_s for s in strides), max(s.end_s for s in strides)
    path_sigma = 0.0 if analysis.why_no_speed else path_speed_sigma(analysis.errors, moved, first_s, last_s)
    between, scatter = _scatter(lengths)
    pace = lengths.mean() / durations.mean()
    unshared = float(np.linalg.norm([scatter, pace * events_s, path_sigma * durations.mean()]))
    length = gait.stride_length_m
    shared = shared_sigma(analysis.motion) * length
    yield _quantity("stride_length_m", length, unshared, shared, "footfalls", between, count, positive)
    frequency = gait.stride_frequency_hz
    between = _scatter(1 / durations)[0]
    unshared = duration_sigma * frequency**2
    yield _quantity("stride_frequency_hz", frequency, unshared, 0.0, "footfalls", between, count, positive)


def _by_period(gait: Gait, speed: GaitQuantity) -> Iterator[GaitQuantity]:
    source: Origin = "period of the motion"
    period_s, period_sigma_s, positive = gait.stride_s, gait.stride_sigma_s, (0.0, np.inf)
    if np.isnan(period_s):
        yield from (
            _unknown(name, source, NO_PERIOD) for name in ("stride_s", "stride_length_m", "stride_frequency_hz")
        )
        return
    yield _quantity("stride_s", period_s, period_sigma_s, 0.0, source, bounds=positive)
    length = speed.value * period_s
    unshared = float(np.hypot(speed.own_sigma * period_s, speed.value * period_sigma_s))
    shared = float(np.sqrt(max(speed.sigma**2 - speed.own_sigma**2, 0.0))) * period_s
    yield _quantity("stride_length_m", length, unshared, shared, source, bounds=positive)
    yield _quantity("stride_frequency_hz", 1 / period_s, period_sigma_s / period_s**2, 0.0, source, bounds=positive)


def _without_long_period(gait: Gait) -> Gait:
    """Return the gait without its stride duration if the duration is a period longer than `MAX_PERIOD`."""
    if gait.strides or not gait.stride_s > MAX_PERIOD * np.ptp(gait.tracks.time_s):
        return gait
    return replace(gait, stride_s=np.nan, stride_sigma_s=np.nan)


def _duty_factors(gait: Gait) -> Iterator[GaitQuantity]:
    """Yield the duty factor of all feet together and of each foot."""
    bounds = 0.0, 1.0
    for foot in ("", *gait.tracks.feet):
        name = f"duty_factor_{foot}" if foot else "duty_factor"
        strides = [stride for stride in gait.strides if foot in ("", stride.foot) and np.isfinite(stride.duty_factor)]
        if strides:
            between, scatter = _scatter(np.array([stride.duty_factor for stride in strides]))
            feet = len({stride.foot for stride in strides})
            events = np.sqrt(np.mean([stride.duty_sigma**2 for stride in strides]) / feet)
            value = gait.duty_factor[foot] if foot else gait.name.duty_factor
            unshared = float(np.hypot(scatter, events))
            yield _quantity(name, value, unshared, 0.0, "footfalls", between, len(strides), bounds)
        elif gait.strides or np.isnan(gait.stride_s):
            yield _unknown(name, "footfalls", "no complete stride")
        else:
            stances = [s for s in _whole(gait.stances) if foot in ("", s.foot)]
            if not foot and len(stances) == 1:
                yield _unknown(name, "period of the motion", "only one complete stance")
            else:
                yield _duty_by_period(gait, name, stances)


def _whole(stances: Sequence[Stance]) -> list[Stance]:
    """Return the stances whose touch-down and lift-off are in the clip."""
    return [stance for stance in stances if stance.begins and stance.ends]


def _duty_by_period(gait: Gait, name: str, stances: Sequence[Stance]) -> GaitQuantity:
    source: Origin = "period of the motion"
    if not stances:
        return _unknown(name, source, "no complete stance")
    lasting_s = np.array([stance.duration_s for stance in stances])
    feet = len({stance.foot for stance in stances})
    events_s = np.sqrt(np.mean([s.start_sigma_s**2 + s.end_sigma_s**2 for s in stances]) / feet)
    between, scatter = _scatter(lasting_s)
    value = float(lasting_s.mean() / gait.stride_s)
    relative = [scatter / lasting_s.mean(), events_s / lasting_s.mean(), gait.stride_sigma_s / gait.stride_s]
    sigma = value * float(np.linalg.norm(relative))
    return _quantity(name, value, sigma, 0.0, source, between / gait.stride_s, len(stances), (0.0, 1.0))


def _phases(gait: Gait) -> Iterator[GaitQuantity]:
    """Yield the phase of each foot's touch-down after the touch-down of the left hind foot, in strides."""
    if np.isnan(gait.stride_s):
        return
    source: Origin = "footfalls" if gait.strides else "period of the motion"
    for foot, phase in gait.name.phase.items():
        if foot == "LH" or np.isnan(phase):
            continue
        lags = _lags(gait, "LH", foot, phase)
        events_s = _event_sigma_s([s for s in gait.stances if s.foot in ("LH", foot)]) * np.sqrt(2)
        between, scatter = _scatter(lags)
        period_error = min(phase, 1 - phase) * gait.stride_sigma_s / gait.stride_s
        unshared = float(np.linalg.norm([scatter, events_s / gait.stride_s, period_error]))
        yield _quantity(f"phase_{foot}", phase, unshared, 0.0, source, between, len(lags))


def _event_sigma_s(stances: Sequence[Stance]) -> float:
    """Return the root mean square of the touch-downs' standard deviations, s."""
    sigmas = np.array([stance.start_sigma_s for stance in stances if stance.begins])
    return float(np.sqrt(np.mean(sigmas**2))) if len(sigmas) else np.nan


def _lags(gait: Gait, reference: str, foot: str, near: float) -> Array:
    """Return the phases of a foot's touch-downs relative to the nearest touch-downs of the reference foot, in strides.

    The phases are shifted by whole strides to be within half a stride of `near`.
    """
    reference_s, foot_s = (
        np.array([s.start_s for s in gait.stances if s.foot == label and s.begins]) for label in (reference, foot)
    )
    if not len(reference_s) or not len(foot_s):
        return np.zeros(0)
    lags = (foot_s - reference_s[np.argmin(np.abs(foot_s[:, None] - reference_s), axis=1)]) / gait.stride_s
    return near + (lags - near + 0.5) % 1.0 - 0.5


def _steps(gait: Gait, feet: tuple[str, str]) -> list[tuple[Stance, Stance]]:
    """Return the pairs of successive stances of a left and a right foot that form a step."""
    in_order = [stance for stance in gait.stances if stance.foot in feet]
    return [
        (first, second)
        for first, second in pairwise(in_order)
        if first.foot != second.foot
        and first.begins
        and second.begins
        and not second.start_s - first.start_s > NEXT_STEP * gait.stride_s
    ]


def _overlap(gait: Gait, girdle: str, feet: tuple[str, str]) -> GaitQuantity:
    """Return the overlap of successive left and right stances, s; negative if both feet are in the air in between."""
    name, source = f"overlap_{girdle}_s", "footfalls"
    steps = [(first, second) for first, second in _steps(gait, feet) if first.ends]
    if not steps:
        return _unknown(name, source, "the clip has no two consecutive stances of the pair")
    between, scatter = _scatter(np.array([first.end_s - second.start_s for first, second in steps]))
    events_s = np.sqrt(np.mean([first.end_sigma_s**2 + second.start_sigma_s**2 for first, second in steps]))
    value = float(np.mean([first.end_s - second.start_s for first, second in steps]))
    return _quantity(name, value, float(np.hypot(scatter, events_s)), 0.0, source, between, len(steps))


def _step_width(analysis: AnalysedClip, gait: Gait, girdle: str, feet: tuple[str, str]) -> GaitQuantity:
    """Return the step width, the distance of the left foot from the right foot across the direction of travel."""
    name, source, tracks = f"step_width_{girdle}_m", "footfalls", gait.tracks
    steps = _steps(gait, feet)
    if not steps:
        return _unknown(name, source, "the clip has no two consecutive stances of the pair")
    widths, variances = [], []
    for step in steps:
        left, right = sorted(step, key=lambda stance: stance.foot)  # sorting by label puts the left foot first
        middles = [(stance.start_s + stance.end_s) / 2 for stance in (left, right)]
        points_m = [_at(tracks.time_s, tracks.foot_m[:, tracks.feet.index(s.foot)], s) for s in (left, right)]
        ends = [_at(tracks.time_s, tracks.body_m, stance) for stance in step]
        travel = (ends[1] - ends[0])[:2]
        if not np.isfinite([*points_m[0], *points_m[1], *travel]).all() or not np.linalg.norm(travel) > 0:
            continue
        across = np.array([-travel[1], travel[0], 0.0]) / np.linalg.norm(travel)
        widths.append(float((points_m[0] - points_m[1]) @ across))
        variances.append(_distance_variance(analysis, (left.foot, right.foot), middles, across))
    if not widths:
        return _unknown(name, source, "the positions of the standing feet are not known")
    between, scatter = _scatter(np.array(widths))
    value = float(np.mean(widths))
    unshared = float(np.hypot(scatter, np.sqrt(mean(variances))))
    return _quantity(name, value, unshared, shared_sigma(analysis.motion) * abs(value), source, between, len(widths))


def _at(time_s: Array, points_m: Array, stance: Stance) -> Array:
    """Return the mean position (3,) of a point during a stance, from its positions (N, 3), m, at the times (N,), s."""
    first, stop = np.searchsorted(time_s, [stance.start_s, stance.end_s])
    return np.asarray(points_m[first : max(stop, first + 1)].mean(axis=0))


def _distance_variance(
    analysis: AnalysedClip, feet: tuple[str, str], middles_s: Sequence[float], across: Array
) -> float:
    """Return the variance of the distance between two feet at two times along the direction `across`, m^2.

    Errors of the animal's position that persist from one time to the other cancel. Errors of the pose do not.
    """
    motion = analysis.motion
    rows = [int(np.argmin(np.abs(motion.time_s - middle_s))) for middle_s in middles_s]
    joints = [motion.names.index(motion.foot_names[foot]) for foot in feet]
    lag_s, variance = middles_s[1] - middles_s[0], 0.0
    *common, of_pose = [error for error in analysis.errors if error.correlation_s < np.inf]
    for error in (*common, of_pose):
        first, second = (error.sigma[row, joint] * across for row, joint in zip(rows, joints, strict=True))
        shared = np.exp(-0.5 * (lag_s / error.correlation_s) ** 2) if common and error is not of_pose else 0.0
        variance += float(np.sum(first**2 + second**2 - 2 * shared * first * second))
    return variance


def _asymmetries(analysis: AnalysedClip, gait: Gait, girdle: str, feet: tuple[str, str]) -> Iterator[GaitQuantity]:
    """Yield the asymmetry of the stance durations and of the excursions of a left and a right foot."""
    reason = _why_no_asymmetry(analysis.motion, gait, feet)
    for kind in SIDE_SIGMA:
        name, sides = f"asymmetry_{kind}_{girdle}", asymmetry_values(gait, kind, feet)
        if reason is None and not np.isfinite(np.concatenate(sides)).all():
            reason = "the position of a foot is not known throughout a stride"
        if reason is not None:
            yield _unknown(name, "footfalls", reason)
            continue
        (left, left_sigma), (right, right_sigma) = ((side.mean(), _scatter(side)[1]) for side in sides)
        half = (left + right) / 2
        unshared = float(np.linalg.norm([left_sigma / half, right_sigma / half, _side_sigma(analysis, kind)]))
        yield _quantity(name, float((left - right) / half), unshared, 0.0, "footfalls", count=min(map(len, sides)))


def asymmetry_values(gait: Gait, kind: str, feet: tuple[str, str]) -> list[Array]:
    """Return two arrays, one for each foot, with the values of the strides that an asymmetry compares.

    `kind` is "stance" for the time on the ground, s, or "excursion" for the distance that the foot moves relative to
    the body, m.
    """

    def value(stride: Stride) -> float:
        return stride.duty_factor * stride.duration_s if kind == "stance" else _excursion_m(gait, stride)

    return [np.array([value(stride) for stride in gait.strides if stride.foot == foot]) for foot in feet]


def _side_sigma(analysis: AnalysedClip, kind: str) -> float:
    """Return the standard deviation of an asymmetry due to viewing directions, smaller with several cameras."""
    return SIDE_SIGMA[kind] / len(analysis.motion.sources) ** 0.5


def _why_no_asymmetry(motion: Motion, gait: Gait, feet: tuple[str, str]) -> str | None:
    """Return the reason why the asymmetry of two feet cannot be measured, or None if it can."""
    if motion.side is not None:
        return "only one side was fitted"
    solution = motion.solution
    if not isinstance(solution, TrajectorySolution):
        return "the method does not report how much of each limb the cameras see"
    for foot in feet:
        joints = next(limb for limb in motion.limbs.values() if motion.names.index(motion.foot_names[foot]) in limb)
        if (fraction := float(np.mean(solution.data_share[[*joints]]))) < MEASURED_FRACTION:
            return (
                f"the limb of {foot} comes mostly from the prior: pixels determine {percent(fraction)} of its position"
            )
    for foot in feet:
        if (count := sum(stride.foot == foot for stride in gait.strides)) < MIN_STRIDES:
            return f"{count} complete strides of {foot}; {MIN_STRIDES} are needed"
    return None


def _excursion_m(gait: Gait, stride: Stride) -> float:
    """Return the distance that a foot moves relative to the body during a stride, along the direction of travel, m."""
    tracks = gait.tracks
    first, stop = np.searchsorted(tracks.time_s, [stride.start_s, stride.end_s])
    body_m = tracks.body_m[first:stop, :2]
    travel = body_m[-1] - body_m[0]
    relative_m = tracks.foot_m[first:stop, tracks.feet.index(stride.foot), :2] - body_m
    return float(np.ptp(relative_m @ travel) / max(float(np.linalg.norm(travel)), 1e-9))
