"""Gait: stances, strides, duty factors, footfall order and the gait's name.

Feet are LH, RH, LF, RF (left and right, hind and fore). World frame, z up, metres; the ground may lie anywhere and
slope. Paths are cubic splines on a grid of ten times the frame rate (`recon.gait.kinematics`), and so are the
events' times. The body is the mean of `body`'s joints.

Stances: a foot may stand where its speed over the ground is below `SLOW[1]` of its own speed in the swing and its
height below `LOW[1]` of the leg's length; such a time is a stance if at least one instant in it is below `SLOW[0]` and
`LOW[0]` too (hysteresis). The stance lasts from the first instant in it below `LANDS` (`SLOW[0]` where it never is) to
the last below `LIFTS`: a foot lands flat, and rolls over its toes before it lifts. A foot's speed in the swing is its
95th percentile, or `SWING` times the body's mean speed where a clip shows less of it: at a gallop that is twice the
body's speed and at a walk four times, because the swing is short or long. Held against the body's speed, one threshold
cannot be right for both. The marker lies some centimetres above the sole and rises with the heel while the foot stands,
hence 0.15 of the leg (9 cm of 0.6 m) to count as low at all, and 0.3 for the end of the push-off. A foot that stands
seems to move by what the speed's error is, `SPEED_ERROR` of its stated deviation, whose square is taken off first.
Stances shorter than `MIN_STANCE_S` are noise. The ground is a plane through the slow feet's positions, fitted with
Tukey weights; clips of a few strides hardly fix its slope across the track, so that slopes have a prior of 0 +-
`SLOPE_SIGMA`. Every segment of a clip, a stretch that was reconstructed by itself, has a plane of its own. Where no
foot is slow, or the slow ones are `LOW[0]` of the leg off a plane, the ground cannot be told, and there are no stances.

Events' standard deviations: a foot's speed is known to what the path's errors leave, as much of their stated deviation
as standing feet seem to move by in nine of ten instants (`Tracks.unrest`); and the speed at which it lands or lifts to
`EVENT_SIGMAS` of that in the swing. Both over the foot's acceleration at the event are a time. No event is further off
than the stance's middle. What stances and intervals are worth against force plates and motion capture:
`benchmarks/gait.py`.

The leg's length is the body's median height above the ground, the length of Froude numbers.

Strides: across half a stride or more in which all four feet stand there is none: the animal stands still. A stance
that was missed makes two strides one, and a stance that was cut makes one two. A stride counts if it is within `AGREE`
of the median of all feet's strides at its time, or, where it is alone, of those before and after it. How long a stride
lasts is the mean of those that count or, in a clip without any, the period of the feet's motion relative to the body,
if the clip holds enough of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from recon.base import Array, Bools, Brief, decimals, length_text, mean, median
from recon.clip import frame_ranges
from recon.fit.posterior import radius
from recon.gait import kinematics
from recon.gait.kinematics import MIN_POINTS, Errors, Series
from recon.io.common import Pose3D

FEET: Mapping[str, str] = {"LH": "l_back_paw", "RH": "r_back_paw", "LF": "l_front_paw", "RF": "r_front_paw"}
BODY = ("neck_base", "tail_base")

OVERSAMPLING = 10
MAX_GAP_S = 0.05
"""Longer gaps of a foot or the body are not bridged: they could hide a touchdown."""
SLOW, SWING = (0.16, 0.32), 1.3
"""Speed over the ground of a standing foot, of its speed in the swing: surely, and at most; and the least speed in the
swing, of the body's."""
LANDS, LIFTS, EVENT_SIGMAS = 0.12, 0.22, (0.05, 0.1)
"""The same when it lands and when it lifts, against force plates, and one standard deviation of each."""
SPEED_ERROR = 0.6
"""How much of its speed's stated deviation a standing foot seems to move by: `benchmarks/gait.py --held-out` chooses it
by the stances of two of three kinds of recordings, and times the third with it."""
LOW = (0.15, 0.3)
"""Height of a standing foot above the ground, leg lengths: surely, and at most."""
INTERVAL = 0.9
"""What the intervals of times and duty factors hold."""
MIN_STANCE_S = 0.02
"""Far below a galloping cheetah's stances, some 0.06 s."""
SLOPE_SIGMA, HEIGHT_SIGMA_M = 0.1, 0.03
"""One sigma of the ground's slopes, and of a standing foot's marker about the plane."""

PERIOD_OF_CLIP, PERIOD_SIGMA, PERIODIC = (0.5, 1 / 0.6), 0.08, 0.9
"""A stride that is longer than half of a clip without a complete one, of the clip's time; one standard deviation of a
period so found, relative to it, of a dog's strides cut to 0.7 to 1.2 of their time; and the least share of the feet's
motion that it has to explain."""
AGREE = 0.2
"""A stride that misses a stance is twice as long; the ends of a right one are off by two frames of some ten at most."""

TOGETHER = 0.05
"""Two feet of a pair land together if less than this of a stride lies between: bound."""
ALTERNATE = 0.4
"""They alternate if at least this lies between (0.5 is exact): a symmetrical gait."""
IN_PHASE = 0.125
"""Trot and pace: how far the fore foot may be from its diagonal or same-sided hind foot (Hildebrand's eighths)."""
STEADY, MOST = 0.5, 2 / 3
"""What makes a gait of strides: mean resultant length of the phases; and the share of strides with a duty factor above
a half, of a walk, or below, of a run."""


@dataclass(frozen=True)
class Stance:
    """A foot's time on the ground."""

    foot: str
    start_s: float
    end_s: float
    start_frame: float
    """Counts rows of the clip and has fractions."""
    end_frame: float
    """Counts rows of the clip and has fractions."""
    begins: bool = True
    """False where the clip, or a gap in it, cuts the beginning, so that the time is only a bound."""
    ends: bool = True
    """The same of the end."""
    start_sigma_s: float = np.nan
    """One standard deviation, NaN where the clip cuts the beginning."""
    end_sigma_s: float = np.nan
    """The same of the end."""

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    @property
    def start_interval_s(self) -> tuple[float, float]:
        """Holds the touch-down with `INTERVAL`; NaN where the clip cuts it."""
        return interval_of(self.start_s, self.start_sigma_s)[1:]

    @property
    def end_interval_s(self) -> tuple[float, float]:
        """Holds the lift-off with `INTERVAL`; NaN where the clip cuts it."""
        return interval_of(self.end_s, self.end_sigma_s)[1:]


@dataclass(frozen=True)
class Plane:
    """Ground z = height_m + slope[0] (x - x0) + slope[1] (y - y0), through the middle (x0, y0) of the slow feet."""

    middle_m: tuple[float, float]
    height_m: float
    slope: tuple[float, float]
    spread_m: float
    """Robust standard deviation of the slow feet about it."""
    samples: int
    """Their number (fine grid), 0 if there was no slow foot and the plane is level, through the lowest position of
    any foot."""

    def above(self, xyz_m: Array) -> Array:
        """Heights (...) of points (..., 3) above the plane."""
        return xyz_m[..., 2] - self.height_m - (xyz_m[..., :2] - self.middle_m) @ np.array(self.slope)


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Brief):
    """The feet's and the body's motion on the fine grid, N times, F feet; NaN where unknown."""

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
    """(N, F): one standard deviation; 0 of paths without errors."""
    body_speed_m_s: Array
    """The horizontal speed of the body, shape (N,)."""
    slow_m_s: Array
    """(4, F): below which speed each foot surely stands, may stand at most, has landed, and has not lifted."""
    swing_m_s: Array
    """(F,): each foot's speed in the swing, above that at rest."""
    height_m: Array
    """(N, F): above the ground."""
    grounds: tuple[tuple[slice, Plane], ...]
    """The clip's rows and the plane under the feet in them, one for every segment of the clip."""
    leg_m: float

    @cached_property
    def unrest(self) -> float:
        """The speed that nine in ten instants of standing feet stay below, of its stated deviation; 1 without any."""
        rest = (self.foot_speed_m_s < self.slow_m_s[0]) & (self.height_m < LOW[0] * self.leg_m)
        rest &= self.foot_speed_sigma_m_s > 0
        relative = self.foot_speed_m_s[rest] / self.foot_speed_sigma_m_s[rest]
        return float(np.quantile(relative, 0.9)) if len(relative) else 1.0

    def above_ground(self, xyz_m: Array) -> Array:
        """Heights (N, ...) of points (N, ..., 3), each above its segment's ground; NaN outside of all."""
        return _above(self.grounds, xyz_m)


@dataclass(frozen=True)
class Stride:
    """From one touchdown of a foot to its next, or from one lift-off to the next where the clip holds no two
    touchdowns. One that is given is of no foot, length and duty factor NaN."""

    foot: str
    start_s: float
    end_s: float
    length_m: float
    """How far the body travels horizontally in the stride."""
    duty_factor: float
    """The duty factor of its stance, which lies in the clip from its beginning to its end."""
    duty_sigma: float
    """One standard deviation of it."""
    at: Literal["touchdown", "lift-off", "given"]
    """What it goes from and to."""
    others_s: float = np.nan
    """For a stride that does not count: how long the strides of all feet around its time last, median."""

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    @property
    def frequency_hz(self) -> float:
        return 1.0 / self.duration_s


@dataclass(frozen=True, repr=False)
class _GaitName(Brief):
    """What a gait is called."""

    name: str
    """walk, trot, pace, bound, half-bound, rotary gallop, transverse gallop, or unknown."""
    criterion: str
    """What it was decided on."""
    phase: Mapping[str, float]
    """Each foot's touchdown after the first foot's, in strides, [0, 1)."""
    duty_factor: float
    """Median over the strides, which one that was cut does not move, or NaN."""
    duty_sigma: float
    """One standard deviation of it, or NaN. What shifts a foot's events shifts them alike in all its strides, so that
    the feet count, not the strides."""

    @property
    def duty_interval(self) -> tuple[float, float]:
        """Holds the duty factor with `INTERVAL`."""
        _, low, high = interval_of(self.duty_factor, self.duty_sigma)
        return max(low, 0.0), min(high, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Gait(Brief):
    """The gait of a clip. Lengths and frequencies are means over complete strides, duty factors medians; NaN without
    any."""

    tracks: Tracks
    stances: tuple[Stance, ...]
    strides: tuple[Stride, ...]
    order: tuple[str, ...]
    """The feet in the order of their touchdowns (those the clip holds)."""
    stride_length_m: float
    stride_frequency_hz: float
    stride_s: float
    """How long a stride lasts: of complete ones, or by the pose's period; NaN where neither is known."""
    stride_sigma_s: float
    """One standard deviation of it."""
    duty_factor: Mapping[str, float]
    speed_m_s: float
    name: _GaitName
    doubtful: tuple[Stride, ...] = ()
    """Strides that the other feet's speak against; none of them is in `strides`."""

    def stride_time(self, start_s: float, end_s: float) -> tuple[float, float]:
        """How long the strides of a time last, and one standard deviation; the clip's where none is complete there."""
        near = [stride for stride in self.strides if stride.start_s < end_s and stride.end_s > start_s]
        return _mean_time(near, 1) if near else (self.stride_s, self.stride_sigma_s)


def interval_of(value: Any, sigma: Any) -> tuple[Any, Any, Any]:
    """A value, or an array of them, and what holds it with `INTERVAL`."""
    reach = radius(INTERVAL) * sigma
    return value, value - reach, value + reach


def interval_text(value: float, sigma: float, unit: str, sign: str = "") -> str:
    """As in 16.2 m/s (90 %: 14.2 to 18.1); the value alone where sigma is NaN. sign: + with a sign."""
    _, low, high = interval_of(value, sigma)
    form = sign + decimals(max(abs(value), -low, high))
    return f"{value:{form}} {unit}" + f" (90 %: {low:{form}} to {high:{form}})" * (not np.isnan(sigma))


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
    """The tracks of a pose of T frames, metres, z up, NaN where missing, with errors (T, J, 3) that add up.

    feet: joint of each foot, by LH, RH, LF, RF; body: joints whose mean stands for the body. segments: rows that have a
    ground of their own. restless: feet seem to move even when they stand, of poses that jitter; how fast, their own
    10th percentile says. Raises InputError with every joint that the pose lacks, ValueError.
    """
    where, n = kinematics.joint_index(pose, (*feet.values(), *body)), len(feet)
    time_s = kinematics.frame_times(pose.frames, fps)
    if len(time_s) < MIN_POINTS:
        raise ValueError(f"a gait needs at least {MIN_POINTS} frames, got {len(time_s)}")

    def path(points_m: Array, errors: Sequence[Errors] = ()) -> Series:
        return kinematics.series_kinematics(time_s, points_m, errors, oversampling=OVERSAMPLING, max_gap_s=MAX_GAP_S)

    def foot_path(at: int) -> tuple[Array, Array, Array]:
        """Positions, speeds and their deviations, of one foot after the other: a path of a long clip is large."""
        found = path(pose.xyz_m[:, at], [error[:, at] for error in errors])
        velocity, speed = found.rate[:, :2], np.linalg.norm(found.rate[:, :2], axis=1)
        deviation = (found.rate_sigma if len(errors) else 0 * found.rate)[:, :2]
        return found.value, speed, np.linalg.norm(velocity / np.maximum(speed, 1e-9)[:, None] * deviation, axis=1)

    foot, foot_speed, foot_speed_sigma = (np.stack(of, axis=1) for of in zip(*map(foot_path, where[:n]), strict=True))
    middle = path(pose.xyz_m[:, where[n:]].mean(axis=1))
    body_speed = np.linalg.norm(middle.rate[:, :2], axis=1)
    seen = [of[np.isfinite(of)] if np.isfinite(of).any() else np.zeros(1) for of in foot_speed.T]
    rest, fast = np.array([np.percentile(of, (10, 95)) for of in seen]).T * [[restless], [1]]
    swing_m_s = np.maximum(fast, SWING * mean(body_speed)) - rest
    slow_m_s = rest + np.multiply.outer((*SLOW, LANDS, LIFTS), swing_m_s)
    slow = foot_speed < slow_m_s[0]
    grounds = tuple((rows, ground_plane(foot[_fine(rows)], slow[_fine(rows)])) for rows in segments)
    return Tracks(
        feet=tuple(feet),
        time_s=middle.time_s,
        foot_m=foot,
        body_m=middle.value,
        foot_speed_m_s=foot_speed,
        foot_speed_sigma_m_s=foot_speed_sigma,
        body_speed_m_s=body_speed,
        slow_m_s=slow_m_s,
        swing_m_s=swing_m_s,
        height_m=_above(grounds, foot),
        grounds=grounds,
        leg_m=median(_above(grounds, middle.value)),
    )


def _fine(rows: slice) -> slice:
    """The fine grid, from the first of the clip's rows to the last."""
    return slice((rows.start or 0) * OVERSAMPLING, None if rows.stop is None else (rows.stop - 1) * OVERSAMPLING + 1)


def _above(grounds: Sequence[tuple[slice, Plane]], xyz_m: Array) -> Array:
    above = np.full(xyz_m.shape[:-1], np.nan)
    for rows, plane in grounds:
        above[_fine(rows)] = plane.above(xyz_m[_fine(rows)])
    return above


def ground_plane(foot_m: Array, slow: Bools) -> Plane:
    """The plane through the feet (N, F, 3) where they are slow (N, F), by least squares with Tukey's weights and a
    prior on its slopes; without any the level through the lowest position."""
    points_m = foot_m[slow]
    if not len(points_m):
        lowest = float(np.nanmin(foot_m[..., 2])) if np.isfinite(foot_m).any() else np.nan
        return Plane((0.0, 0.0), lowest, (0.0, 0.0), np.nan, 0)
    middle = np.median(points_m[:, :2], axis=0)
    design = np.column_stack([np.ones(len(points_m)), points_m[:, :2] - middle])
    # Samples of the fine grid within one stance say the same: the prior counts as one of them, not less.
    prior = np.diag([0.0, 1.0, 1.0]) * (HEIGHT_SIGMA_M / SLOPE_SIGMA) ** 2
    weight = np.ones(len(points_m))
    parameters, spread = np.zeros(3), 0.0
    for _ in range(20):
        normal = design.T @ (weight[:, None] * design) / OVERSAMPLING + prior
        parameters = np.linalg.solve(normal, design.T @ (weight * points_m[:, 2]) / OVERSAMPLING)
        off = points_m[:, 2] - design @ parameters
        spread = float(np.median(np.abs(off)) / 0.6745)
        limit = 4.685 * max(spread, HEIGHT_SIGMA_M)
        weight = np.where(np.abs(off) < limit, (1 - (off / limit) ** 2) ** 2, 0.0)
    (x, y), (height, along_x, along_y) = middle.tolist(), parameters.tolist()
    return Plane((x, y), height, (along_x, along_y), spread, len(points_m))


# -- stances ---------------------------------------------------------------------------------------------------------


def stances(moved: Tracks) -> tuple[Stance, ...]:
    """All feet's stances in the order of their beginnings (see the module); none where the ground cannot be told."""
    if why_no_ground(moved):
        return ()
    found = [s for k in range(len(moved.feet)) for s in _stances_of(moved, k)]
    return tuple(sorted(found, key=lambda s: (s.start_s, s.foot)))


def why_no_ground(moved: Tracks) -> str | None:
    """Why the ground under the feet cannot be told; None where it can."""
    planes = [plane for _, plane in moved.grounds if plane.samples]
    if not planes:
        return "the ground is not known: no foot is slow enough to stand"
    spread_m = max(plane.spread_m for plane in planes)
    if not spread_m < LOW[0] * moved.leg_m:
        return f"the ground is not known: slow feet are {length_text(spread_m)} off a plane (median)"
    return None


def _stances_of(moved: Tracks, k: int) -> list[Stance]:
    off, height = SPEED_ERROR * moved.foot_speed_sigma_m_s[:, k], moved.height_m[:, k]
    speed = np.sqrt(np.maximum(moved.foot_speed_m_s[:, k] ** 2 - off**2, 0.0))
    surely, at_most, lands, lifts = moved.slow_m_s[:, k]
    still = np.flatnonzero(speed < surely)
    sure = still[height[still] < LOW[0] * moved.leg_m]
    known = np.pad(np.isfinite(speed), 1)  # by the index after
    found = []
    slow = np.less(speed, at_most) & np.less(height, LOW[1] * moved.leg_m)
    for first, end in frame_ranges(np.flatnonzero(slow)):
        if np.any((sure >= first) & (sure < end)):
            within = speed[first:end]
            landed = within < (lands if within.min() < lands else surely)
            a, b = first + int(landed.argmax()), end - 1 - int((within < lifts)[::-1].argmax())
            seen = bool(a > first or known[first]), bool(b < end - 1 or known[end + 1])
            start_s, end_s = (float(moved.time_s[i]) for i in (a, b))
            sigmas = [
                _event_sigma_s(moved, k, i, (end_s - start_s) / 2, own) if is_seen else np.nan
                for i, is_seen, own in zip((a, b), seen, EVENT_SIGMAS, strict=True)
            ]
            found.append(Stance(moved.feet[k], start_s, end_s, a / OVERSAMPLING, b / OVERSAMPLING, *seen, *sigmas))
    return [s for s in found if s.duration_s >= MIN_STANCE_S or not (s.begins and s.ends)]


def _event_sigma_s(moved: Tracks, k: int, i: int, most_s: float, own: float) -> float:
    """The standard deviation in seconds of a landing or lift-off of the k-th foot at an instant, most_s from the
    stance's middle (see the module); own: the threshold's, relative to the speed in the swing."""
    about = slice(max(i - OVERSAMPLING // 2, 0), i + OVERSAMPLING // 2 + 1)
    speed, time = moved.foot_speed_m_s[about, k], moved.time_s[about]
    known = np.isfinite(speed)
    changes = np.ptp(speed[known]) / np.ptp(time[known])
    sigma = float(np.hypot(moved.unrest * moved.foot_speed_sigma_m_s[i, k], own * moved.swing_m_s[k]))
    return min(sigma / max(changes, 1e-9), most_s / radius(INTERVAL))


def match_stances(first: Sequence[Stance], second: Sequence[Stance]) -> list[tuple[Stance, Stance]]:
    """Pairs stances of the same foot that overlap, each with the one it overlaps most, if that is mutual."""

    def most(of: Stance, others: Sequence[Stance]) -> Stance | None:
        shared = [(min(of.end_s, o.end_s) - max(of.start_s, o.start_s), -i) for i, o in enumerate(others)]
        same = [pair for pair in shared if pair[0] > 0 and others[-pair[1]].foot == of.foot]
        return others[-max(same)[1]] if same else None

    pairs = [(a, b) for a in first if (b := most(a, second)) is not None]
    return [(a, b) for a, b in pairs if most(b, first) is a]


# -- strides and gait ------------------------------------------------------------------------------------------------


def gait(moved: Tracks) -> Gait:
    """Stances, strides and the gait's name, the strides of each foot held against those of all."""
    found = stances(moved)
    taken, doubtful = _counted(strides(moved, found))
    lengths, durations = [s.length_m for s in taken], [s.duration_s for s in taken]
    lasts_s, sigma_s = _stride_time(moved, taken)
    landed = sorted((s for s in found if s.begins), key=lambda s: s.start_s)
    doubt = why_no_ground(moved)
    if doubt is None and not {*FEET} <= {*moved.feet}:
        doubt = f"only gaits of four feet have names; here are {', '.join(moved.feet)}"
    return Gait(
        tracks=moved,
        stances=found,
        strides=taken,
        order=tuple(s.foot for s in landed),
        stride_length_m=mean(lengths),
        stride_frequency_hz=1.0 / mean(durations) if durations else np.nan,
        stride_s=lasts_s,
        stride_sigma_s=sigma_s,
        duty_factor={foot: median([s.duty_factor for s in taken if s.foot == foot]) for foot in moved.feet},
        speed_m_s=mean(moved.body_speed_m_s),
        name=name_gait(found, taken, lasts_s, doubt),
        doubtful=doubtful,
    )


def pose_gait(pose: Pose3D, fps: float, errors: Sequence[Errors] = (), **options) -> Gait:
    """The gait of a pose; options as `pose_tracks`. Raises InputError, ValueError."""
    return gait(pose_tracks(pose, fps, errors, **options))


def strides(moved: Tracks, found: tuple[Stance, ...]) -> tuple[Stride, ...]:
    """Complete strides: both touchdowns (or, for a foot without two, both lift-offs) and the stance are in the clip."""
    taken, still = [], _all_stand(moved, found)
    for foot in moved.feet:
        own = [s for s in found if s.foot == foot]
        landings = [(a.start_s, b.start_s, a) for a, b in pairwise(own) if a.begins and a.ends and b.begins]
        liftings = [(a.end_s, b.end_s, b) for a, b in pairwise(own) if a.ends and b.begins and b.ends]
        at: Literal["touchdown", "lift-off"] = "touchdown" if landings else "lift-off"
        for start, end, stance in landings or liftings:
            a, b = np.searchsorted(moved.time_s, [start, end])
            # A foot or a body that was lost in between may have hidden a stance.
            step = np.diff(moved.body_m[a : b + 1, :2], axis=0)
            lost = not np.isfinite(step).all() or np.isnan(moved.foot_m[a : b + 1, moved.feet.index(foot)]).any()
            if not lost and still[a : b + 1].mean() < 0.5:
                length = float(np.linalg.norm(step, axis=1).sum())
                sigma_s = float(np.hypot(stance.start_sigma_s, stance.end_sigma_s))
                duty, sigma = (of / (end - start) for of in (stance.duration_s, sigma_s))
                taken.append(Stride(foot, start, end, length, duty, sigma, at))
    return tuple(sorted(taken, key=lambda s: (s.start_s, s.foot)))


def _all_stand(moved: Tracks, found: Sequence[Stance]) -> Bools:
    """(N,): when all feet of an animal of four stand."""
    stands = np.zeros((len(moved.time_s), len(moved.feet)), dtype=bool)
    for stance in found:
        first, stop = np.searchsorted(moved.time_s, [stance.start_s, stance.end_s])
        stands[first:stop, moved.feet.index(stance.foot)] = True
    return np.asarray(stands.all(axis=1) & (len(moved.feet) >= 4))


def _counted(own: tuple[Stride, ...]) -> tuple[tuple[Stride, ...], tuple[Stride, ...]]:
    """Strides, in the order of their beginnings, that count, and those that do not."""
    counted, doubtful = [], []
    start_s, end_s, lasts_s = (np.array([getattr(s, of) for s in own]) for of in ("start_s", "end_s", "duration_s"))
    for stride in own:
        # Not all are looked at: in a long clip there are thousands.
        longest_s = lasts_s.max()
        near = slice(*np.searchsorted(start_s, [stride.start_s - 2 * longest_s, stride.end_s + longest_s]))
        same = (start_s[near] < stride.end_s) & (end_s[near] > stride.start_s)
        others_s = median(lasts_s[near][same] if same.sum() > 1 else lasts_s[near])
        if abs(others_s * stride.frequency_hz - 1) <= AGREE:
            counted.append(stride)
        else:
            doubtful.append(replace(stride, others_s=others_s))
    return tuple(counted), tuple(doubtful)


def doubtful_text(stride: Stride) -> str:
    """Why a stride does not count, in one sentence."""
    text = f"{stride.foot}'s stride from {stride.start_s:.3f} to {stride.end_s:.3f} s does not count"
    return f"{text}: strides of all feet around its time last {stride.others_s:.3f} s"


def _stride_time(moved: Tracks, taken: Sequence[Stride]) -> tuple[float, float]:
    """Seconds and one standard deviation: of complete strides, or by the pose's period; NaN without either."""
    if taken:
        return _mean_time(taken, len(taken))
    period = pose_period_s(moved)
    return period, period * PERIOD_SIGMA


def _mean_time(taken: Sequence[Stride], count: int) -> tuple[float, float]:
    """The mean time of strides and the standard deviation of the mean of so many of them."""
    lasts = np.array([stride.duration_s for stride in taken])
    events = np.array([stride.duty_sigma for stride in taken]) * lasts
    return float(lasts.mean()), float(np.hypot(lasts.std() / count**0.5, np.median(events)))


def pose_period_s(moved: Tracks) -> float:
    """Seconds of the stride of a clip that holds no complete one, NaN where it cannot be told.

    It is the period whose first two harmonics, with a weak prior against them, fit best where the feet are relative to
    the body."""
    values = (moved.foot_m - moved.body_m[:, None])[::OVERSAMPLING].reshape(-1, 3 * len(moved.feet))
    known = np.isfinite(values).all(axis=1)
    time, values = moved.time_s[::OVERSAMPLING][known], values[known]
    if len(time) < MIN_POINTS + 5:
        return np.nan
    periods = np.linspace(*PERIOD_OF_CLIP, 100) * (time[-1] - time[0])
    phase = 2 * np.pi / periods[:, None] * (time - time.mean())
    waves = np.stack([np.ones_like(phase), *(f(n * phase) for n in (1, 2) for f in (np.cos, np.sin))], axis=-1)
    moment = np.einsum("pta,tf->paf", waves, values)
    prior = 1e-3 * len(time) * np.diag([0, 1, 1, 4, 4])
    by_wave = np.linalg.solve(np.einsum("pta,ptb->pab", waves, waves) + prior, moment)
    left = np.sum(values**2) - np.einsum("paf,paf->p", moment, by_wave)
    best = int(left.argmin())
    explained = left[best] < (1 - PERIODIC) * len(time) * values.var(axis=0).sum()
    return float(periods[best]) if explained and 0 < best < len(periods) - 1 else np.nan


def name_gait(
    found: tuple[Stance, ...], taken: tuple[Stride, ...], stride_s: float, doubt: str | None = None
) -> _GaitName:
    """The gait by the four feet's phases: see `classify`. stride_s: how long a stride lasts, NaN where that is not
    known; doubt: why there are no stances, or not of all four."""
    duties = np.array([s.duty_factor for s in taken])
    feet = len({s.foot for s in taken})
    duty = median(duties), float(np.sqrt(mean([s.duty_sigma**2 for s in taken]) / feet)) if feet else np.nan
    if doubt is None and (lacking := [foot for foot in FEET if not any(s.foot == foot for s in found)]):
        doubt = f"no stance of {', '.join(lacking)}"
    if doubt is None and np.isnan(stride_s):
        doubt = "no complete stride, and too little of one to tell how long it lasts"
    if doubt is not None:
        return _GaitName("unknown", doubt, dict.fromkeys(FEET, np.nan), *duty)
    period = float(np.median([s.duration_s for s in taken])) if taken else stride_s
    phase = {"LH": 0.0} | {foot: _lag(found, "LH", foot, period) for foot in ("RH", "LF", "RF")}
    # A foot that never landed together with LH in view may have done so with RH.
    for foot in ("LF", "RF"):
        if np.isnan(phase[foot]):
            phase[foot] = (phase["RH"] + _lag(found, "RH", foot, period)) % 1.0
    name, criterion = classify(phase, duty[0])
    if not taken:
        criterion = f"no complete stride, but the motion is that of one of {period:.2f} s: {criterion}"
    if name in ("walk", "trot", "pace") and 1 - MOST < (share := float(np.mean(duties > 0.5))) < MOST:
        name, criterion = "unknown", f"{criterion}: over 0.5 in {share:.0%} of the strides, walk or run is open"
    return _GaitName(name, criterion, phase, *duty)


def _lag(found: tuple[Stance, ...], reference: str, foot: str, period_s: float) -> float:
    """Circular mean, [0, 1), of the time from a foot's touchdown to the nearest of another, in strides.

    Of the lift-offs where the clip holds no touchdown of one of them; NaN if it holds neither, or if the times are not
    `STEADY`.
    """
    for known, event in (("begins", "start_s"), ("ends", "end_s")):
        a, b = (
            np.array([getattr(s, event) for s in found if s.foot == f and getattr(s, known)]) for f in (reference, foot)
        )
        if len(a) and len(b):
            off = b - a[np.argmin(np.abs(b[:, None] - a), axis=1)]
            # Events further apart than a stride have drifted out of step.
            near = off[np.abs(off) <= max(period_s, np.abs(off).min())]
            towards = np.mean(np.exp(2j * np.pi * near / period_s))
            return float(np.angle(towards) / (2 * np.pi) % 1.0) if np.abs(towards) >= STEADY else np.nan
    return np.nan


def classify(phase: Mapping[str, float], duty_factor: float) -> tuple[str, str]:
    """Name and criterion from touchdown phases (strides, of LH, RH, LF, RF) and the mean duty factor.

    After Hildebrand (1965, 1977). Symmetrical, both pairs at least 0.4 apart: walk if the duty factor is over 0.5;
    otherwise trot or pace if the fore feet land within 0.125 of the diagonal or of the same-sided hind foot.
    Asymmetrical, both pairs less than 0.4 apart: bound if both pairs land within 0.05, half-bound if only the hind pair
    does; gallop if neither does, transverse if the same side leads (lands second) in both pairs, rotary if not.
    """
    if any(np.isnan(phase[foot]) for foot in FEET):
        lacking = ", ".join(foot for foot in FEET if np.isnan(phase[foot]))
        return "unknown", f"no steady phase of {lacking} over the strides"
    hind, fore = _signed(phase["RH"] - phase["LH"]), _signed(phase["RF"] - phase["LF"])
    seen = f"hind feet {abs(hind):.2f} of a stride apart, {_first(hind)}; fore feet {abs(fore):.2f}, {_first(fore)}"
    if min(abs(hind), abs(fore)) >= ALTERNATE:
        sides = np.exp(2j * np.pi * np.array([phase["LF"] - phase["LH"], phase["RF"] - phase["RH"]]))
        lateral = float(np.angle(sides.mean()) / (2 * np.pi) % 1.0)
        seen += f"; fore {lateral:.2f} after the same-sided hind foot, duty factor {duty_factor:.2f}"
        if np.isnan(duty_factor):
            return "unknown", seen + ": walk or run is open"
        if duty_factor > 0.5:
            return "walk", seen
        if abs(_signed(lateral - 0.5)) <= IN_PHASE:
            return "trot", seen
        return ("pace", seen) if abs(_signed(lateral)) <= IN_PHASE else ("unknown", seen + ": between trot and pace")
    if max(abs(hind), abs(fore)) >= ALTERNATE:
        return "unknown", seen + ": one pair alternates, the other does not"
    if abs(hind) < TOGETHER:
        return ("bound" if abs(fore) < TOGETHER else "half-bound"), seen
    if abs(fore) < TOGETHER:
        return "unknown", seen + ": the fore pair lands together, the hind pair does not"
    leads = ["right" if lag > 0 else "left" for lag in (hind, fore)]
    kind = "transverse" if leads[0] == leads[1] else "rotary"
    return f"{kind} gallop", f"{seen}; leading: {leads[0]} hind, {leads[1]} fore"


def _first(lag: float) -> str:
    """By how much the right foot of a pair lands after its left one."""
    return "left first" if lag > 0 else "right first"


def _signed(phase: float) -> float:
    """[-0.5, 0.5)"""
    return (phase + 0.5) % 1.0 - 0.5
