"""A reference motion on a quadruped: footholds, the body's pose, joint angles, and how well they do.

One factor, the scale, turns the animal's lengths into the robot's. The robot's base goes where the scaled animal's
does; it stands at its own height, to which the scaled deviations of height, pitch and roll are added, held within
`LIFT`, `PITCH_RAD` and `ROLL_RAD` by a tanh. A foot is at its neutral place under the hip, moved by the scaled way of
the animal's foot from its middle place, and plants itself where the animal's does.
It is lifted as high as the scaled animal's, but held by a tanh within `CLEARANCE` of what the leg can be folded by.

Unless it is given, the scale is the largest up to stand_m / leg_m at which all feet, of the clip and of the stride that
repeats, are within the legs' reach and the joints' limits; and the motion is as slow as the joints' rates ask for, but
not faster than the animal's. With a given scale, a foot out of reach is drawn towards its neutral place until it is
not.

For its footholds, a foot's path gets a correction. In a stance it takes the foot to the stance's mean place, on the
ground; over a swing it goes from that of the stance before to that of the next by a cubic. At either end its rate is
such that the foot lifts off and lands without a jump of its speed; this wears off within the share `EASE` of the swing,
as otherwise the foot would trail far behind where it should be. Before the first and after the last stance of a clip
the correction comes to rest.

An animal with a back that bends gathers its feet so far in a gallop that on a rigid body fore and hind legs would meet.
Hind feet go outside of the fore feet then, as a cheetah's do: by the least of `SPREADS` that keeps the legs' lines
`LEGS_APART` from each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform

from recon.base.arrays import Array, Bools
from recon.clip.keypoints import frame_ranges
from recon.robotics.robot.quadruped import LEGS, Quadruped, RobotLeg, body_pose, feet_in_world, leg_targets
from recon.robotics.robot.reference import (
    Animal,
    Reference,
    StrideWindow,
    closed_stride,
    stride_window,
)

PITCH_RAD, ROLL_RAD = 0.25, 0.15
LIFT = 0.15
"""How high a swinging foot rises, as a share of the height that the hips stand at."""
CLEARANCE = 0.7
SPREADS = (0.0, 0.1, 0.2, 0.3, 0.4)
LEGS_APART = 0.15
"""Both of the height that the hips stand at; legs are about as thick."""
TINY_M = 1e-9
"""How high the feet of a robot that cannot bend its legs are lifted."""
SMALLEST = 0.1
"""Scale below which none is sought, of the largest."""
STEP = 0.97
"""Between the scales that are tried."""
_EVERY = 5
"""Samples from one to the next that a scale is tried on; half a frame."""
_BISECTIONS = 25
EASE = 0.5
_ALONG = 9
"""Points on a link."""


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """A robot's motion at N times, its 4 legs in the order of `LEGS`, its joints in that of robot.joints."""

    robot: Quadruped
    scale: float
    slower: float
    time_s: Array
    """(N,): the robot's."""
    angles_rad: Array
    """(N, joints)"""
    pose: RigidTransform
    """(N): T_world_body."""
    feet_m: Array
    """(N, 4, 3): where the feet should be, in the world."""
    standing: Bools
    """(N, 4)"""
    short: Bools
    """(N, 4): feet that were out of reach."""
    advance_m: Array | None = None
    """As of the reference."""

    def leg_angles(self, label: str) -> Array:
        """(N, n) of one leg."""
        counts = [len(leg.joints) for leg in self.robot.legs.values()]
        start = sum(counts[: LEGS.index(label)])
        return self.angles_rad[:, start : start + counts[LEGS.index(label)]]

    @cached_property
    def _spline(self) -> CubicSpline:
        """Through the states of `Quadruped.tree`, less the way of a stride that repeats."""
        turn = np.unwrap(self.pose.rotation.as_euler("ZYX"), axis=0)
        states = np.hstack([self.pose.translation, turn, self.angles_rad])
        if self.advance_m is None:
            return CubicSpline(self.time_s, states)
        states[:, :2] -= np.linspace(0.0, 1.0, len(states))[:, None] * self.advance_m
        return CubicSpline(self.time_s, np.concatenate([states[:-1], states[:1]]), bc_type="periodic")

    def states(self, time_s: Array, derivative: int = 0) -> Array:
        """The states (K, 6 + joints) of `Quadruped.tree` at times (K,), or their derivatives: of cubic splines through
        the samples, of which there are ten for each of the clip's frames."""
        found = self._spline(time_s, derivative)
        if self.advance_m is not None and derivative < 2:
            share = (time_s - self.time_s[0], np.ones(len(time_s)))[derivative] / (self.time_s[-1] - self.time_s[0])
            found[:, :2] += share[:, None] * self.advance_m
        return found

    @cached_property
    def rate_share(self) -> Array:
        """(joints,): the fastest rate between two samples, of the limit."""
        rates = np.diff(self.angles_rad, axis=0) / np.diff(self.time_s)[:, None]
        return np.abs(rates).max(axis=0) / self.robot.limits()[2]

    @cached_property
    def margin_rad(self) -> Array:
        """(joints,): the least distance from a limit, negative beyond it."""
        lower, upper, _ = self.robot.limits()
        return np.minimum(self.angles_rad - lower, upper - self.angles_rad).min(axis=0)

    def points(self, label: str) -> Array:
        """A leg's hip, joints and foot in the world (N, ., 3)."""
        along = self.robot.legs[label].chain.positions(self.leg_angles(label))
        return feet_in_world(self.pose, np.zeros(3), along)

    @cached_property
    def apart_m(self) -> float:
        """The least distance between the fore and the hind leg of a side, by points along their links."""
        share = np.linspace(0.0, 1.0, _ALONG)[:, None]

        def along(label: str) -> Array:
            points = self.points(label)[::_EVERY]
            links = points[:, :-1, None] * (1 - share) + points[:, 1:, None] * share
            return links.reshape(len(points), -1, 3)

        pairs = ((along(f"{side}F"), along(f"{side}H")) for side in "LR")
        return float(min(np.linalg.norm(a[:, :, None] - b[:, None], axis=-1).min() for a, b in pairs))

    @cached_property
    def slip_m(self) -> Array:
        """(4,): farthest that a foot gets from where it stood first, in any stance, by the joints' angles. Also looked
        at between the samples. 0 for a foot that never stands."""
        half = (self.time_s[1:] + self.time_s[:-1]) / 2
        tree, names = self.robot.tree, [marker.name for marker in self.robot.tree.markers]
        feet = [names.index(f"{label} foot") for label in LEGS]
        at, between = (tree.pose(self.states(time)).points_m[:, feet] for time in (self.time_s, half))
        slip = np.zeros(len(LEGS))
        for k in range(len(LEGS)):
            for first, last in stances(self.standing[:, k]):
                stood = np.concatenate([at[first : last + 1, k], between[first:last, k]])
                slip[k] = max(slip[k], float(np.linalg.norm(stood - at[first, k], axis=1).max()))
        return slip

    @cached_property
    def closing_percent(self) -> float:
        """For a stride that repeats: the largest difference of an angle between its ends, of the angle's range."""
        return 100 * float(np.max(np.abs(self.angles_rad[-1] - self.angles_rad[0]) / np.ptp(self.angles_rad, axis=0)))


@dataclass(frozen=True, eq=False)
class Retargeting:
    """A robot's motion after an animal's."""

    animal: Animal
    window: StrideWindow
    clip: RobotMotion
    """The whole of it."""
    stride: RobotMotion
    """One that repeats."""
    spread_m: float
    """How far outside of its neutral place each hind foot goes."""


def retarget(
    animal: Animal,
    robot: Quadruped,
    scale: float | None = None,
    slower: float | None = None,
    window: StrideWindow | None = None,
) -> Retargeting:
    """scale: of lengths, None: the largest that fits; slower: factor on times, None: as the rates ask for; window: of
    the stride, by default the one that is found."""
    window = window or stride_window(animal)
    moved, repeats, spread = on_robot(animal.reference, closed_stride(animal, window), robot, scale, slower)
    return Retargeting(animal, window, moved, repeats, spread)


def on_robot(
    clip: Reference, stride: Reference, robot: Quadruped, scale: float | None = None, slower: float | None = None
) -> tuple[RobotMotion, RobotMotion, float]:
    """A clip and a closed stride of it, as a robot's motions, and how far its hind feet go outside.
    scale, slower: as of `retarget`."""
    tried: list[tuple[float, RobotMotion, RobotMotion, float]] = []
    enough = LEGS_APART * robot.stand_m
    for share in SPREADS:
        spread = share * robot.stand_m
        chosen = largest_scale((clip, stride), robot, spread) if scale is None else scale
        both = (_robot_motion(clip, robot, chosen, spread), _robot_motion(stride, robot, chosen, spread))
        tried.append((min(motion.apart_m for motion in both), *both, spread))
        if tried[-1][0] >= enough:
            break
    _, *motions, spread = max(tried, key=lambda one: min(one[0], enough))
    if slower is None:
        slower = max(1.0, *(float(motion.rate_share.max()) for motion in motions))
    moved, repeats = (replace(motion, slower=slower, time_s=slower * motion.time_s) for motion in motions)
    return moved, repeats, spread


def largest_scale(references: tuple[Reference, ...], robot: Quadruped, spread_m: float = 0.0) -> float:
    """The largest at which every foot is in reach; where there is none down to `SMALLEST`, half of the largest."""
    most = robot.stand_m / references[0].leg_m

    def fits(scale: float, every: int) -> bool:
        for reference in references:
            pose, feet, _ = place(reference, robot, scale, spread_m)
            targets = leg_targets(pose, np.zeros(3), feet)[::every]
            if not all(np.isfinite(leg.angles(targets[:, k])).all() for k, leg in enumerate(robot.legs.values())):
                return False
        return True

    for n in range(int(np.log(SMALLEST) / np.log(STEP)) + 1):
        scale = most * STEP**n
        if fits(scale, _EVERY) and fits(scale, 1):
            return scale
    return most / 2


def place(
    reference: Reference, robot: Quadruped, scale: float, spread_m: float = 0.0
) -> tuple[RigidTransform, Array, Bools]:
    """T_world_body (N), the feet in the world (N, 4, 3) with their footholds, and which stand (N, 4)."""
    roll, pitch, yaw = reference.roll_pitch_yaw_rad.T
    lift = LIFT * robot.stand_m
    position = scale * reference.base_m
    position[:, 2] = _within(position[:, 2], lift) - robot.ground_m
    pose = body_pose(position, _within(roll, ROLL_RAD), _within(pitch, PITCH_RAD), yaw)
    level = body_pose(position * (1.0, 1.0, 0.0), 0.0, 0.0, yaw)
    neutral = np.array([leg.neutral_m * (1.0, 1.0, 0.0) for leg in robot.legs.values()])
    neutral[:, 1] += [spread_m * (label[1] == "H") * (1 if label[0] == "L" else -1) for label in LEGS]
    ways = scale * reference.feet_m
    room = np.maximum(CLEARANCE * robot.folding_m, TINY_M)
    ways[..., 2] = np.where(ways[..., 2] > 0, room * np.tanh(ways[..., 2] / room), ways[..., 2])
    standing = reference.standing
    advance = None if reference.advance_m is None else scale * reference.advance_m

    def on_ground(raw: Array) -> Array:
        paths = [planted(reference.time_s, raw[:, k], standing[:, k], advance) for k in range(len(LEGS))]
        return np.stack(paths, axis=1)

    # Footholds move the middle of a foot's way, by which the animal's was taken off: back under the hip with it.
    moved = leg_targets(level, neutral, on_ground(feet_in_world(level, neutral, ways)))[..., 0]
    middle = (moved.min(axis=0) + moved.max(axis=0)) / 2
    ways[..., 0] -= middle
    return pose, on_ground(feet_in_world(level, neutral, ways)), standing


def _robot_motion(reference: Reference, robot: Quadruped, scale: float, spread_m: float) -> RobotMotion:
    pose, feet, standing = place(reference, robot, scale, spread_m)
    motion = posed(robot, reference.time_s - reference.time_s[0], pose, feet, standing)
    return replace(motion, scale=scale, advance_m=None if reference.advance_m is None else scale * reference.advance_m)


def posed(robot: Quadruped, time_s: Array, pose: RigidTransform, feet_m: Array, standing: Bools) -> RobotMotion:
    """The motion of a robot from T_world_body (N), feet in the world (N, 4, 3) and which stand (N, 4); feet out of
    reach are drawn in."""
    targets = leg_targets(pose, np.zeros(3), feet_m)
    solved = [drawn_in(leg, targets[:, k]) for k, leg in enumerate(robot.legs.values())]
    angles = np.concatenate([angles for angles, _ in solved], axis=1)
    short = np.stack([short for _, short in solved], axis=1)
    return RobotMotion(robot, 1.0, 1.0, time_s, angles, pose, feet_m, standing, short)


def drawn_in(leg: RobotLeg, feet_m: Array) -> tuple[Array, Bools]:
    """Angles (T, n) of feet (T, 3) in body axes, and which of them (T,) are out of reach: these are drawn towards the
    neutral place as little as needed."""
    angles = leg.angles(feet_m)
    short = ~np.asarray(np.isfinite(angles).all(axis=1))
    if not short.any():
        return angles, short
    away = feet_m[short] - leg.neutral_m
    near, far = np.zeros(len(away)), np.ones(len(away))
    best = np.tile(leg.angles(leg.neutral_m[None]), (len(away), 1))
    for _ in range(_BISECTIONS):
        share = (near + far) / 2
        tried = leg.angles(leg.neutral_m + share[:, None] * away)
        good = np.isfinite(tried).all(axis=1)
        best[good] = tried[good]
        near, far = np.where(good, share, near), np.where(good, far, share)
    angles[short] = best
    return angles, short


def _within(values: Array, limit: float) -> Array:
    return limit * np.tanh(values / limit)


# -- footholds -------------------------------------------------------------------------------------------------------


def planted(time_s: Array, path_m: Array, standing: Bools, advance_m: Array | None = None) -> Array:
    """A path (N, 3), ground at z = 0, standing (N,) -> the same with footholds, nowhere below the ground.

    advance_m (2,): for a stride that repeats, by how far its last sample is ahead of its first.
    """
    if advance_m is None:
        return _planted_path(time_s, path_m, standing)
    n, period = len(time_s) - 1, time_s[-1] - time_s[0]
    time = np.concatenate([time_s[:-1] - period, time_s[:-1], time_s + period])
    ahead = np.append(advance_m, 0.0)
    path = np.concatenate([path_m[:-1] - ahead, path_m[:-1], path_m + ahead])
    stands = np.concatenate([standing[:-1], standing[:-1], standing])
    out = _planted_path(time, path, stands)[n : 2 * n + 1]
    out[-1] = out[0] + ahead
    return out


def stances(standing: Bools) -> list[tuple[int, int]]:
    """First and last sample of each."""
    return [(first, end - 1) for first, end in frame_ranges(np.flatnonzero(standing))]


def _planted_path(time_s: Array, path_m: Array, standing: Bools) -> Array:
    found = stances(standing)
    if not found:
        return np.column_stack([path_m[:, :2], np.maximum(path_m[:, 2], 0.0)])
    rate = np.gradient(path_m, time_s, axis=0)
    correction = np.zeros_like(path_m)
    knots: list[tuple[int, Array, Array]] = []
    for first, last in found:
        place = np.append(path_m[first : last + 1, :2].mean(axis=0), 0.0)
        correction[first : last + 1] = place - path_m[first : last + 1]
        knots += [(k, correction[k].copy(), -rate[k]) for k in (first, last)]
    rest = np.zeros(3)
    knots = [(0, knots[0][1], rest), *knots, (len(path_m) - 1, knots[-1][1], rest)]
    for (a, value_a, rate_a), (b, value_b, rate_b) in zip(knots[::2], knots[1::2], strict=True):
        inside = np.arange(a, b + 1)
        inside = inside[~standing[inside]]
        if len(inside):
            since, until = (time_s[inside] - time_s[a])[:, None], (time_s[b] - time_s[inside])[:, None]
            share = since / (since + until)
            moved = value_a + share**2 * (3 - 2 * share) * (value_b - value_a)
            ease = EASE * (time_s[b] - time_s[a])
            correction[inside] = moved + _bump(since, ease) * rate_a - _bump(until, ease) * rate_b
    out = path_m + correction
    out[:, 2] = np.maximum(out[:, 2], 0.0)
    return out


def _bump(time: Array, until: float) -> Array:
    """Starts at 0 with rate 1, and is 0 with rate 0 from then on."""
    return time * np.maximum(1 - time / until, 0.0) ** 2
