"""Turn an animal's motion into a reference for legged robots, and transfer the reference to a quadruped.

The reference has the animal's size and timing. In its world, z is up, the ground is at 0, and x is the direction of
travel. The base is the middle of the trunk. Height, pitch and roll of the base are deviations from their means, because
a robot stands in its own pose. The roll is measured from the lines between the hips and between the shoulders. Height,
angles and heading are smoothed over `SMOOTH_S`, because errors of a fit last a few frames and a heavy body does not
move that fast.

Feet are in heading axes (x forward, y left, horizontal). Horizontally, a foot's position is relative to the base and
to the middle of the foot's path, which is halfway between the foremost and the rearmost position along x, and the mean
along y. The height of a foot is above the ground, minus the mean height in stance, because a marker is above the sole.

One factor, the scale, turns the animal's lengths into the robot's. The robot's base follows the scaled path of the
animal at the robot's own height. The scaled deviations of height, pitch and roll are added, limited to `MAX_BODY_RISE`,
`PITCH_RAD` and `ROLL_RAD` by a tanh. A foot's position is its neutral position under the hip, plus the scaled
displacement of the animal's foot from the middle of its path. A robot's foot stands when the animal's foot stands. The
lift of the animal's foot is scaled, and limited by a tanh to the fraction `MAX_FOOT_LIFT` of the height by which the
robot's leg can be folded.

By default, the scale is the largest one up to stand_m / leg_m at which all feet are within reach and joint limits, in
the clip and in the repeating stride. By default, the motion is slowed down only as much as the rate limits of the
joints require, and is never sped up. If the scale is given, a foot out of reach is moved towards its neutral position
until it is within reach.

In stance a foot stays at the stance's mean position, on the ground. In swing, the animal's path is shifted smoothly
from the previous foothold to the next. The robot's foot leaves the ground for this path, and returns from it, within
the fraction `EASE_FRACTION` of the swing, so that its acceleration does not jump at lift-off and touch-down.

In a gallop, an animal with a flexible back brings its feet so close together that the fore and hind legs of a robot
with a rigid body would meet. The robot's hind feet then pass outside its fore feet, as a cheetah's do, by the smallest
of `SPREADS` that keeps the lines of the legs `LEGS_APART` from each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array, Bools, Index
from recon.base.errors import InputError, Problem
from recon.clip import frame_ranges
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.gait import Gait
from recon.gait.stances import Tracks
from recon.robotics.quadruped import LEGS, Quadruped, RobotLeg, body_pose, feet_in_world, leg_targets

SMOOTH_S = 0.02
"""Standard deviation of the Gaussian that smooths the animal's height, angles and heading, seconds."""
MIN_SAMPLES = 40
"""Minimum number of samples of a reference, which is four frames of ten samples each."""
HARMONICS = 8
"""Number of Fourier harmonics kept in a repeating stride, few enough to smooth the seam where its ends meet."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Motion for a robot to follow, at N evenly spaced times."""

    time_s: Array
    """Times, shape (N,), seconds."""
    base_m: Array
    """Positions of the base: x and y in the world, and the height's deviation from its mean, shape (N, 3), metres."""
    roll_pitch_yaw_rad: Array
    """Roll, pitch and yaw of the trunk, shape (N, 3), rad."""
    feet_m: Array
    """Positions of the feet in heading axes, shape (N, 4, 3), metres, in the order of `LEGS`."""
    standing: Bools
    """Whether each foot is in stance, shape (N, 4)."""
    leg_m: float
    """Length of the animal's legs, metres."""
    advance_m: Array | None = None
    """Displacement from the first to the last sample of a closed stride, shape (2,), metres; None for a clip.

    Except for this displacement, the two samples are equal.
    """


@dataclass(frozen=True)
class StrideWindow:
    """Indices of the first and the last sample of a stride in a reference."""

    first: int
    last: int
    source: str
    """Origin of the stride: "given" by the user, "stride" or "return".

    "stride" is a complete stride of one foot. "return" is the part of the clip after which all feet come closest to
    where they started.
    """
    gap_percent: float
    """Distance between a foot's first and last position, in percent of its path's extent, as the mean of four feet."""


@dataclass(frozen=True, eq=False)
class Animal:
    """An animal's motion and the reference made from it."""

    reference: Reference
    analysis: ClipAnalysis
    gait: Gait
    rotation: Rotation
    """Rotation from the upright frame to the reference's world, about origin_m."""
    origin_m: Array
    rows: Index
    """Indices of the samples in the analysis's fine time grid from which the reference is made, shape (N,)."""


def reference_of(motion: Motion, stride_s: tuple[float, float] | None = None) -> Animal:
    """Convert an animal's motion to a reference for robots.

    Parameters
    ----------
    motion : Motion
        The animal's motion.
    stride_s : tuple of float, optional
        Start and end of a stride in seconds, as for `analyse`.

    Raises
    ------
    InputError
        If the clip does not show all four feet, or if too few consecutive frames show all feet and the trunk.
    """
    analysis = analyse(motion, stride_s=stride_s)
    if (gait := analysis.gait) is None or not {*LEGS} <= {*motion.foot_names}:
        detail = ", ".join(sorted(motion.foot_names)) or "none"
        expected = "all four feet: fit the whole animal, not the chain of one side"
        raise InputError(Problem(motion.file, "feet", detail, expected))
    tracks = gait.tracks
    rear, front = (analysis.moved(name).series.value for name in motion.forward_names)
    rows = _longest_complete(motion, tracks, front - rear)
    time, body, trunk = tracks.time_s[rows], tracks.body_m[rows], (front - rear)[rows]
    chord = body[-1] - body[0]
    if np.hypot(*chord[:2]) < tracks.leg_m / 2:
        chord = trunk.mean(axis=0)
    to_world = Rotation.from_euler("z", -np.arctan2(chord[1], chord[0]))
    height = tracks.above_ground(tracks.body_m)[rows]
    origin = np.append(body[0, :2], body[0, 2] - height[0])

    smoothed = gaussian_filter1d(
        np.column_stack([height - height.mean(), _angles(analysis, rows, to_world, trunk)]),
        SMOOTH_S / float(time[1] - time[0]),
        axis=0,
        mode="nearest",
    )
    smoothed[:, :3] -= smoothed[:, :3].mean(axis=0)
    heading = Rotation.from_euler("z", -smoothed[:, 3:])
    order = [tracks.feet.index(foot) for foot in LEGS]
    feet = np.stack([heading.apply(to_world.apply(tracks.foot_m[rows, k] - body)) for k in order], axis=1)
    standing = _standing(gait, time)
    _centre_feet(feet, tracks.height_m[rows][:, order], standing)
    reference = Reference(
        time_s=time,
        base_m=np.column_stack([to_world.apply(body - origin)[:, :2], smoothed[:, 0]]),
        roll_pitch_yaw_rad=smoothed[:, 1:],
        feet_m=feet,
        standing=standing,
        leg_m=tracks.leg_m,
    )
    return Animal(reference, analysis, gait, to_world, origin, rows)


def _longest_complete(motion: Motion, tracks: Tracks, trunk: Array) -> Index:
    """Return the samples of the longest part of the clip that shows all feet and the trunk, shape (N,)."""
    columns = np.column_stack([tracks.foot_m.reshape(len(tracks.time_s), -1), tracks.body_m, trunk])
    ranges = frame_ranges(np.flatnonzero(np.isfinite(columns).all(axis=1)))
    rows = np.arange(*max(ranges, key=lambda stretch: stretch[1] - stretch[0], default=(0, 0)))
    if len(rows) < MIN_SAMPLES:
        detail = f"{len(rows) // 10} consecutive frames with all feet and the trunk"
        raise InputError(Problem(motion.file, "frames", detail, f"at least {MIN_SAMPLES // 10} frames"))
    return rows


def _standing(gait: Gait, time_s: Array) -> Bools:
    """Return a mask (N, 4) of the times at which each foot is in stance, in the order of `LEGS`."""
    standing = np.zeros((len(time_s), len(LEGS)), bool)
    for stance in gait.stances:
        is_stance = (time_s >= stance.start_s - 1e-9) & (time_s <= stance.end_s + 1e-9)
        standing[is_stance, LEGS.index(stance.foot)] = True
    return standing


def _centre_feet(feet_m: Array, heights_m: Array, standing: Bools) -> None:
    """Shift the path of each foot, feet_m (N, 4, 3), in place so that its middle is at 0 and its stances at height 0.

    `heights_m` (N, 4) are the heights above the ground.
    """
    feet_m[..., 0] -= (feet_m[..., 0].min(axis=0) + feet_m[..., 0].max(axis=0)) / 2
    feet_m[..., 1] -= feet_m[..., 1].mean(axis=0)
    for k, (heights, stands) in enumerate(zip(heights_m.T, standing.T, strict=True)):
        feet_m[:, k, 2] = heights - (heights[stands].mean() if stands.any() else heights.min())


def _angles(analysis: ClipAnalysis, rows: Index, to_world: Rotation, trunk: Array) -> Array:
    """Return roll, pitch and yaw (N, 3) of the trunk, rad.

    The roll is measured from the lines between the first joints of left and right limbs.
    """
    motion, ahead = analysis.motion, to_world.apply(trunk)
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    pitch = -np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))
    limbs = {motion.names[along[-1]]: [motion.names[j] for j in along] for along in reversed(motion.limbs.values())}
    across = np.zeros((len(rows), 3))
    for end in "FH":
        legs = (limbs.get(motion.foot_names[f"{side}{end}"], []) for side in "LR")
        for left, right in [pair for pair in zip(*legs, strict=False) if pair[0] != pair[1]][:1]:
            across += analysis.moved(left).series.value[rows] - analysis.moved(right).series.value[rows]
    if not np.isfinite(across).all() or not across.any():
        return np.column_stack([np.zeros(len(rows)), pitch, yaw])
    in_body = (Rotation.from_euler("ZY", np.column_stack([yaw, pitch])).inv() * to_world).apply(across)
    return np.column_stack([np.arctan2(in_body[:, 2], in_body[:, 1]), pitch, yaw])


def stride_window(animal: Animal) -> StrideWindow:
    """Return the given stride for a robot to repeat, or a complete stride, or the part of the clip that nearly closes.

    The complete stride is the first stride of the foot with the most strides. If no foot lands twice, the stride lasts
    at least from the first touch-down to the end of the clip.
    """
    feet, time = animal.reference.feet_m, animal.reference.time_s
    complete = [s for s in animal.gait.strides if time[0] - 1e-9 <= s.start_s and s.end_s <= time[-1] + 1e-9]
    of_feet = [s.foot for s in complete]
    source, stride = "stride", min(complete, key=lambda s: (-of_feet.count(s.foot), s.start_s), default=None)
    if (window_given := animal.analysis.given) is not None:
        source, stride = "given", window_given
    if stride is not None:
        first, last = (int(np.argmin(np.abs(time - t))) for t in (stride.start_s, stride.end_s))
        if time[last] - time[first] < 0.8 * (stride.end_s - stride.start_s):
            expected = f"START:END between {time[0]:.3f} and {time[-1]:.3f} s, where all feet are seen"
            raise InputError(Problem("--stride", "times", f"{stride.start_s:g}:{stride.end_s:g} s", expected))
    else:
        source, first, last = "return", 0, len(time) - 1
        duration = float(time[-1] - time[0])
        landed = min((s.start_s for s in animal.gait.stances if s.begins), default=float(time[0]))
        least = min(duration, max(duration / 2, float(time[-1]) - landed))
        flat, best = feet.reshape(len(time), -1), np.inf
        for start in range(0, len(time), max(1, len(time) // 200)):
            ends = np.flatnonzero(time - time[start] >= least - 1e-9)
            distances = np.linalg.norm(flat[ends] - flat[start], axis=1)
            if distances.min(initial=np.inf) < best:
                best, first, last = float(distances.min()), start, int(ends[np.argmin(distances)])
    extent = np.linalg.norm(np.ptp(feet[first : last + 1], axis=0), axis=-1)
    gap = 100 * float(np.mean(np.linalg.norm(feet[last] - feet[first], axis=-1) / extent))
    return StrideWindow(first, last, source, gap)


def closed_stride(animal: Animal, window: StrideWindow) -> Reference:
    """Turn a window of an animal's reference into a stride that repeats along a straight line.

    The gap between the ends is spread evenly over the stride, and `HARMONICS` harmonics are kept. A foot without stance
    in the window stands at the phases at which it stands elsewhere in the clip.
    """
    whole = animal.reference
    n = window.last - window.first
    time = whole.time_s[window.first : window.last + 1]
    period = float(time[-1] - time[0])
    values = np.column_stack([whole.base_m, whole.roll_pitch_yaw_rad, whole.feet_m.reshape(len(whole.time_s), -1)])
    values = values[window.first : window.last + 1]
    ramp = np.linspace(0.0, 1.0, n + 1)[:, None]
    advance = values[-1, :2] - values[0, :2]
    values = values - ramp * (values[-1] - values[0])
    spectrum = np.fft.rfft(values[:-1], axis=0)
    spectrum[HARMONICS + 1 :] = 0.0
    values = np.fft.irfft(spectrum, n, axis=0)
    values[:, 5] -= values[:, 5].mean()
    values = np.concatenate([values, values[:1]])
    turned = Rotation.from_euler("z", -np.arctan2(advance[1], advance[0]))
    values[:, :2] = turned.apply(np.column_stack([values[:, :2], np.zeros(n + 1)]))[:, :2]
    length = float(np.hypot(*advance))
    values[:, 0] += length * ramp[:, 0] - values[0, 0]

    standing = whole.standing[window.first : window.last + 1].copy()
    for k in np.flatnonzero(~standing.any(axis=0)):
        indices = np.flatnonzero(whole.standing[:, k]) - window.first
        standing[indices % n, k] = True
    standing[-1] = standing[0] = standing[0] | standing[-1]
    return replace(
        whole,
        time_s=np.linspace(0.0, period, n + 1),
        base_m=values[:, :3],
        roll_pitch_yaw_rad=values[:, 3:6],
        feet_m=values[:, 6:].reshape(n + 1, -1, 3),
        standing=standing,
        advance_m=np.array([length, 0.0]),
    )


PITCH_RAD = 0.25
"""Largest pitch of the body, rad."""
ROLL_RAD = 0.15
"""Largest roll of the body, rad."""
MAX_BODY_RISE = 0.15
"""Largest rise of the body, as a fraction of the standing height of the hips."""
MAX_FOOT_LIFT = 0.7
"""Largest lift of a foot, as a fraction of the height by which its leg can be folded."""
SPREADS = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Distances by which the hind feet may pass outside the fore feet, as fractions of the hips' standing height, in the
order in which they are tried."""
LEGS_APART = 0.15
"""Smallest distance between the centre lines of two legs, as a fraction of the hips' standing height.

Legs are about this thick.
"""
SCALES = 0.97 ** np.arange(76)
"""Scales to try, in decreasing order, as fractions of the largest scale."""
_SAMPLE_STEP = 5
"""Step, in samples, of tests on a part of a motion. Five samples are half a frame."""
_BISECTIONS = 25
GROUND_BEND_HEIGHT = 0.05
"""Height below which paths of swinging feet are bent away from the ground, as a fraction of the standing height."""
EASE_FRACTION = 0.28
"""Fraction of a swing in which a foot leaves or reaches its foothold."""
PATH_BEND_FRACTION = 0.1
"""Fraction of a path's height within which the path is bent to stay above the ground."""


@dataclass(frozen=True, eq=False)
class KeptMotion:
    """A robot's motion at N times as plain arrays.

    The 4 legs are in the order of `LEGS`, the joints in the order of the robot's `joints`.
    """

    scale: float
    slower: float
    time_s: Array
    """Time of each frame of the robot's motion, shape (N,), seconds."""
    angles_rad: Array
    """Joint angles, shape (N, joints), rad."""
    position_m: Array
    """Position of the body in the world, shape (N, 3), metres."""
    quaternion_xyzw: Array
    """Rotation of the body in the world as quaternions, shape (N, 4)."""
    feet_m: Array
    """Intended positions of the feet in the world, shape (N, 4, 3), metres."""
    standing: Bools
    """Whether each foot is in stance, shape (N, 4)."""
    short: Bools
    """Whether each foot was out of reach, shape (N, 4)."""
    advance_m: Array | None = None
    """Displacement over a repeating stride, shape (2,), metres, as in `Reference`."""


@dataclass(frozen=True, eq=False)
class RobotMotion(KeptMotion):
    """Motion of a particular robot, with the quantities derived from it."""

    robot: Quadruped = field(kw_only=True)

    @cached_property
    def pose(self) -> RigidTransform:
        """Return the N poses of the base in the world, T_world_body."""
        return RigidTransform.from_components(self.position_m, Rotation.from_quat(self.quaternion_xyzw))

    def leg_angles(self, label: str) -> Array:
        """Return the joint angles (N, n) of one leg, rad."""
        counts = [len(leg.joints) for leg in self.robot.legs.values()]
        return np.split(self.angles_rad, np.cumsum(counts)[:-1], axis=1)[LEGS.index(label)]

    @cached_property
    def _spline(self) -> CubicSpline:
        """Return a spline through the states of `Quadruped.tree` at the sample times.

        For a repeating stride, the displacement of the body is subtracted first, so that the spline is periodic.
        """
        turn = np.unwrap(self.pose.rotation.as_euler("ZYX"), axis=0)
        states = np.hstack([self.position_m, turn, self.angles_rad])
        if self.advance_m is None:
            return CubicSpline(self.time_s, states)
        states[:, :2] -= np.linspace(0.0, 1.0, len(states))[:, None] * self.advance_m
        return CubicSpline(self.time_s, np.concatenate([states[:-1], states[:1]]), bc_type="periodic")

    def states(self, time_s: Array, derivative: int = 0) -> Array:
        """Return the states (K, 6 + joints) of `Quadruped.tree` at times (K,), or their derivatives.

        The states are values of cubic splines through the samples. Each frame of the clip has ten samples.
        """
        states = self._spline(time_s, derivative)
        if self.advance_m is not None and derivative < 2:
            fraction = (time_s - self.time_s[0], np.ones(len(time_s)))[derivative] / (self.time_s[-1] - self.time_s[0])
            states[:, :2] += fraction[:, None] * self.advance_m
        return states

    def stands_at(self, time_s: Array) -> Bools:
        """Return a mask (K, 4) of the feet in stance, taken from the samples nearest to times (K,), s."""
        return self.standing[np.argmin(np.abs(self.time_s[None] - time_s[:, None]), axis=1)]

    @cached_property
    def rate_share(self) -> Array:
        """Return the largest rate of each joint between two samples, as a fraction of the joint's limit, (joints,)."""
        rates = np.diff(self.angles_rad, axis=0) / np.diff(self.time_s)[:, None]
        return np.abs(rates).max(axis=0) / self.robot.limits()[2]

    @cached_property
    def margin_rad(self) -> Array:
        """Return the smallest distance (joints,) of each joint from its limits in rad, negative beyond a limit."""
        lower, upper, _ = self.robot.limits()
        return np.minimum(self.angles_rad - lower, upper - self.angles_rad).min(axis=0)

    def points(self, label: str) -> Array:
        """Return the hip, the joints and the foot of a leg in the world (N, points, 3), metres."""
        along = self.robot.legs[label].chain.positions(self.leg_angles(label))
        return feet_in_world(self.pose, np.zeros(3), along)

    @cached_property
    def apart_m(self) -> float:
        """Return the smallest distance between the fore and the hind leg of a side, metres.

        The distance is computed between nine points on each link, in every half frame.
        """
        fraction, legs = np.linspace(0.0, 1.0, 9)[:, None], {}
        for label in LEGS:
            points = self.points(label)[::_SAMPLE_STEP]
            links = points[:, :-1, None] * (1 - fraction) + points[:, 1:, None] * fraction
            legs[label] = links.reshape(len(points), -1, 3)
        pairs = ((legs[f"{side}F"][:, :, None], legs[f"{side}H"][:, None]) for side in "LR")
        return float(min(np.linalg.norm(fore - hind, axis=-1).min() for fore, hind in pairs))

    @cached_property
    def slip_m(self) -> Array:
        """Return the largest slip of each foot (4,) in any stance, metres.

        The slip is computed from the joint angles at and between samples, and is 0 for a foot that never stands.
        """
        fine = np.linspace(self.time_s[0], self.time_s[-1], 2 * len(self.time_s) - 1)
        feet = self.robot.tree.pose(self.states(fine)).points_m[:, self.robot.foot_markers]
        stood = [[feet[2 * a : 2 * b + 1, k] for a, b in stances(self.standing[:, k])] for k in range(len(LEGS))]
        return np.array([max((np.linalg.norm(p - p[0], axis=1).max() for p in every), default=0.0) for every in stood])

    @cached_property
    def closing_percent(self) -> float:
        """Return the largest change of an angle between the ends of a repeating stride, in percent of its range."""
        return 100 * float(np.max(np.abs(self.angles_rad[-1] - self.angles_rad[0]) / np.ptp(self.angles_rad, axis=0)))


@dataclass(frozen=True, eq=False)
class Retargeting:
    """A robot's motion that follows an animal's motion."""

    animal: Animal
    window: StrideWindow
    clip: RobotMotion
    """Motion over the whole clip."""
    stride: RobotMotion
    """Motion of a stride that repeats."""
    spread_m: float
    """Distance by which each hind foot is outside its neutral position, metres."""


def retarget(
    animal: Animal,
    robot: Quadruped,
    scale: float | None = None,
    slower: float | None = None,
    window: StrideWindow | None = None,
) -> Retargeting:
    """Transfer an animal's motion to a robot.

    Parameters
    ----------
    animal : Animal
        The animal's motion and the reference made from it.
    robot : Quadruped
        The robot that follows the reference.
    scale : float, optional
        Factor on lengths; by default the largest within reach and joint limits.
    slower : float, optional
        Factor on times; by default as large as the joints' rates require.
    window : StrideWindow, optional
        The stride that repeats; by default chosen by `stride_window`.
    """
    window = window or stride_window(animal)
    moved, repeats, spread = on_robot(animal.reference, closed_stride(animal, window), robot, scale, slower)
    return Retargeting(animal, window, moved, repeats, spread)


def on_robot(
    clip: Reference, stride: Reference, robot: Quadruped, scale: float | None = None, slower: float | None = None
) -> tuple[RobotMotion, RobotMotion, float]:
    """Transfer a clip and one of its strides to a robot, and return both motions and the hind feet's shift.

    The shift is the distance of each hind foot outside its neutral position, m.

    `scale` and `slower` are as in `retarget`.
    """
    tried: list[tuple[float, list[RobotMotion], float]] = []
    enough = LEGS_APART * robot.stand_m
    for fraction in SPREADS:
        spread = fraction * robot.stand_m
        chosen = largest_scale((clip, stride), robot, spread) if scale is None else scale
        motions = []
        for reference in (clip, stride):
            moved = posed(robot, reference.time_s - reference.time_s[0], *place(reference, robot, chosen, spread))
            advance = None if reference.advance_m is None else chosen * reference.advance_m
            motions.append(replace(moved, scale=chosen, advance_m=advance))
        tried.append((min(motion.apart_m for motion in motions), motions, spread))
        if tried[-1][0] >= enough:
            break
    _, motions, spread = max(tried, key=lambda reference: min(reference[0], enough))
    if slower is None:
        slower = max(1.0, *(float(motion.rate_share.max()) for motion in motions))
    moved, repeats = (slowed(motion, slower) for motion in motions)
    return moved, repeats, spread


def slowed(motion: RobotMotion, factor: float) -> RobotMotion:
    """Return a motion with all times multiplied by a factor."""
    return replace(motion, slower=factor * motion.slower, time_s=factor * motion.time_s)


def largest_scale(references: tuple[Reference, ...], robot: Quadruped, spread_m: float = 0.0) -> float:
    """Return the largest scale at which every foot is within reach, or half of the first scale tried if none fits.

    The scales are the fractions `SCALES` of the ratio of the robot's standing height to the animal's leg length.
    `spread_m` is the distance by which each hind foot is outside its neutral position, m.
    """
    largest = robot.stand_m / references[0].leg_m

    def fits(scale: float, every: int) -> bool:
        for reference in references:
            pose, feet, _ = place(reference, robot, scale, spread_m)
            targets = leg_targets(pose, np.zeros(3), feet)[::every]
            if not all(np.isfinite(leg.angles(targets[:, k])).all() for k, leg in enumerate(robot.legs.values())):
                return False
        return True

    scales = (float(scale) for scale in largest * SCALES)
    return next((scale for scale in scales if fits(scale, _SAMPLE_STEP) and fits(scale, 1)), largest / 2)


def place(
    reference: Reference, robot: Quadruped, scale: float, spread_m: float = 0.0
) -> tuple[RigidTransform, Array, Bools]:
    """Compute body poses and foot positions of a robot that follows a reference at a given scale.

    `spread_m` is the distance by which each hind foot is outside its neutral position, m.

    Returns
    -------
    pose : RigidTransform
        T_world_body of each of the N samples.
    feet_m : (N, 4, 3)
        Feet in the world, metres; a foot in stance stays on its foothold.
    standing : (N, 4)
        Whether each foot is in stance.
    """
    roll, pitch, yaw = reference.roll_pitch_yaw_rad.T
    position = scale * reference.base_m
    position[:, 2] = _within(position[:, 2], MAX_BODY_RISE * robot.stand_m) - robot.ground_m
    pose = body_pose(position, _within(roll, ROLL_RAD), _within(pitch, PITCH_RAD), yaw)
    level = body_pose(position * (1.0, 1.0, 0.0), 0.0, 0.0, yaw)
    neutral = np.array([leg.neutral_m * (1.0, 1.0, 0.0) for leg in robot.legs.values()])
    neutral[:, 1] += [spread_m * (label[1] == "H") * (1 if label[0] == "L" else -1) for label in LEGS]
    ways = scale * reference.feet_m
    # Legs that cannot bend get a small positive limit, to avoid a division by 0.
    room = np.maximum(MAX_FOOT_LIFT * robot.folding_m, 1e-9)
    ways[..., 2] = np.where(ways[..., 2] > 0, _within(ways[..., 2], room), ways[..., 2])
    standing = reference.standing
    advance = None if reference.advance_m is None else scale * reference.advance_m

    def on_ground(raw: Array) -> Array:
        paths = [planted(reference.time_s, raw[:, k], standing[:, k], advance) for k in range(len(LEGS))]
        return np.stack(paths, axis=1)

    # Footholds shift the middle of each foot's path, so centre the path under the hip again.
    moved = leg_targets(level, neutral, on_ground(feet_in_world(level, neutral, ways)))[..., 0]
    ways[..., 0] -= (moved.min(axis=0) + moved.max(axis=0)) / 2
    return pose, on_ground(feet_in_world(level, neutral, ways)), standing


def posed(robot: Quadruped, time_s: Array, pose: RigidTransform, feet_m: Array, standing: Bools) -> RobotMotion:
    """Build the motion of a robot from N poses T_world_body and the positions (N, 4, 3) of its feet in the world, m.

    `standing` (N, 4) marks the feet that stand. Feet out of reach are moved into reach.
    """
    targets = leg_targets(pose, np.zeros(3), feet_m)
    solved = [within_reach(leg, targets[:, k]) for k, leg in enumerate(robot.legs.values())]
    angles = np.concatenate([angles for angles, _ in solved], axis=1)
    short = np.stack([short for _, short in solved], axis=1)
    position, quaternion = pose.translation, pose.rotation.as_quat()
    return RobotMotion(1.0, 1.0, time_s, angles, position, quaternion, feet_m, standing, short, robot=robot)


def within_reach(leg: RobotLeg, feet_m: Array) -> tuple[Array, Bools]:
    """Return joint angles in rad, shape (T, n), for feet (T, 3) in body axes, and a mask (T,) of feet out of reach.

    A foot out of reach is moved towards its neutral position as little as possible.
    """
    angles = leg.angles(feet_m)
    short = ~np.asarray(np.isfinite(angles).all(axis=1))
    if not short.any():
        return angles, short
    to_target = feet_m[short] - leg.neutral_m
    shares, step = np.zeros(len(to_target)), 0.5
    angles[short] = leg.angles(leg.neutral_m[None])
    for _ in range(_BISECTIONS):
        tried = leg.angles(leg.neutral_m + (shares + step)[:, None] * to_target)
        good = np.isfinite(tried).all(axis=1)
        angles[np.flatnonzero(short)[good]] = tried[good]
        shares, step = shares + step * good, step / 2
    return angles, short


def _within(values: Array, limit: float | Array) -> Array:
    """Limit the magnitudes of values by a tanh, which hardly changes values far below the limit."""
    return limit * np.tanh(values / limit)


def stances(standing: Bools) -> list[tuple[int, int]]:
    """Return the indices of the first and last sample of each stance of a foot, from a mask (N,) of its stances."""
    return [(first, end - 1) for first, end in frame_ranges(np.flatnonzero(standing))]


def planted(time_s: Array, path_m: Array, standing: Bools, advance_m: Array | None = None) -> Array:
    """Return a path (N, 3) that stays on a foothold in stance and never goes below the ground, z = 0.

    `standing` (N,) is the mask of the samples in stance. `advance_m` (2,) is the displacement from the first to the
    last sample of a repeating stride; None for a clip.
    """
    if advance_m is not None:
        n, period, ahead = len(time_s) - 1, time_s[-1] - time_s[0], np.append(advance_m, 0.0)
        time = np.concatenate([time_s[:-1] - period, time_s[:-1], time_s + period])
        path = np.concatenate([path_m[:-1] - ahead, path_m[:-1], path_m + ahead])
        out = planted(time, path, np.concatenate([standing[:-1], standing[:-1], standing]))[n : 2 * n + 1]
        out[-1] = out[0] + ahead
        return out
    footholds, ends = np.zeros_like(path_m), []
    for first, last in stances(standing):
        footholds[first : last + 1, :2] = path_m[first : last + 1, :2].mean(axis=0)
        ends += [first, last]
    knots = np.unique(ends or [0])
    moving = path_m.copy()
    if len(knots) > 1:
        shift = CubicHermiteSpline(time_s[knots], (footholds - path_m)[knots], np.zeros((len(knots), 3)))
        moving += shift(np.clip(time_s, time_s[knots[0]], time_s[knots[-1]]))
    moving[:, 2] = (moving[:, 2] + np.hypot(moving[:, 2], PATH_BEND_FRACTION * np.ptp(path_m[:, 2]))) / 2
    if not ends:
        return moving
    last_standing, next_standing, since, until, lasts = _swings(time_s, standing)
    fraction = np.minimum(np.minimum(since, until) / (EASE_FRACTION * lasts), 1.0)[:, None]
    hold = footholds[np.where(since <= until, last_standing, np.minimum(next_standing, len(time_s) - 1))]
    return hold + fraction**2 * (6 - 8 * fraction + 3 * fraction**2) * (moving - hold)


class _Swings(NamedTuple):
    """Stances of one foot before and after each of N samples, and the time to them; arrays of shape (N,)."""

    last_standing: Array
    """Index of the last sample in stance up to this sample, -1 if there is none."""
    next_standing: Array
    """Index of the next sample in stance, N if there is none."""
    since_s: Array
    """Time since the last sample in stance, seconds."""
    until_s: Array
    """Time until the next sample in stance, seconds."""
    duration_s: Array
    """Duration of the swing, seconds; for samples in stance and for cut swings, the duration of the longest swing."""


def _swings(time_s: Array, standing: Bools) -> _Swings:
    samples = np.arange(len(time_s))
    last_standing = np.maximum.accumulate(np.where(standing, samples, -1))
    next_standing = np.minimum.accumulate(np.where(standing, samples, len(samples))[::-1])[::-1]
    since, until = time_s - np.append(time_s, -np.inf)[last_standing], np.append(time_s, np.inf)[next_standing] - time_s
    swing = since + until
    # A swing that the clip cuts is assumed to last as long as the longest complete swing.
    longest = swing[np.isfinite(swing)].max() or time_s[-1] - time_s[0]
    duration_s = np.where(np.isfinite(swing) & ~standing, swing, longest)
    return _Swings(last_standing, next_standing, since, until, duration_s)


def swinging(motion: RobotMotion) -> Array:
    """Return a weight (N, 4) of each foot that rises smoothly from 0 in stance to 1 in the middle of a swing."""
    time, standing, n = motion.time_s, motion.standing, len(motion.time_s) - 1
    if motion.advance_m is not None:
        lasts = time[-1] - time[0]
        time = np.concatenate([time[:-1] - lasts, time[:-1], time + lasts])
        standing = np.concatenate([standing[:-1], standing[:-1], standing])
    weights = np.ones(standing.shape)
    for foot in np.flatnonzero(standing.any(axis=0)):
        _, _, since, until, lasts = _swings(time, standing[:, foot])
        fraction = np.minimum(2 * np.minimum(since, until) / lasts, 1.0)
        weights[:, foot] = fraction**3 * (10 - 15 * fraction + 6 * fraction**2)
    return weights if motion.advance_m is None else weights[n : 2 * n + 1]


def moved_by(motion: RobotMotion, shifts: Array, robot: Quadruped | None = None) -> RobotMotion:
    """Return a motion with its base moved by `shifts` (N, 6) of the position (m) and of yaw, pitch and roll (rad).

    Standing feet stay in place, and swinging feet move with the base. `robot` may be the same robot with other limits.
    """
    yaw, pitch, roll = motion.pose.rotation.as_euler("ZYX").T + shifts[:, 3:].T
    pose, loose = body_pose(motion.pose.translation + shifts[:, :3], roll, pitch, yaw), swinging(motion)[..., None]
    along = feet_in_world(pose, np.zeros(3), leg_targets(motion.pose, np.zeros(3), motion.feet_m))
    feet = motion.feet_m + loose * (along - motion.feet_m)
    feet[..., 2] = (
        feet[..., 2] + np.hypot(feet[..., 2], GROUND_BEND_HEIGHT * motion.robot.stand_m * loose[..., 0])
    ) / 2
    moved = replace(posed(robot or motion.robot, motion.time_s, pose, feet, motion.standing), robot=motion.robot)
    return replace(moved, scale=motion.scale, slower=motion.slower, advance_m=motion.advance_m)
