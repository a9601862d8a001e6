"""An animal's motion as a reference for a legged machine: where its trunk goes, and where its feet are from there.

The reference has the animal's own size and time. World: z up, the ground at 0, x along the travel. The base is the
middle of the trunk. Its height, pitch and roll are deviations from their means, since a machine stands as it stands;
roll is that of the lines between hips and between shoulders. They and the heading
are smoothed over `SMOOTH_S`, as a fit's errors last a few frames and a body is heavy.

Feet are in heading axes (x forwards, y left, level) from the base, less each foot's middle place: halfway between
foremost and rearmost, and the mean to the side. Their heights are above the ground, less the mean height while they
stand, for a marker lies above the sole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Index
from recon.base.errors import InputError, Problem
from recon.clip import frame_ranges
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.gait import Gait
from recon.wings.robotics.robot.quadruped import LEGS

SMOOTH_S = 0.02
MIN_SAMPLES = 40
"""Four frames."""
HARMONICS = 8
"""What a closed stride consists of: the seam where it was cut is smooth then."""


@dataclass(frozen=True, eq=False)
class Reference:
    """What a robot is to follow, at N times, evenly spaced."""

    time_s: Array
    """(N,)"""
    base_m: Array
    """(N, 3): x and y in the world, z the deviation of the height."""
    roll_pitch_yaw_rad: Array
    """(N, 3)"""
    feet_m: Array
    """(N, 4, 3), in the order of `LEGS`."""
    standing: Bools
    """(N, 4)"""
    leg_m: float
    """The animal's length of leg."""
    advance_m: Array | None = None
    """(2,): of a closed stride, the way from its first to its last sample, which are one and the same otherwise;
    None for a clip."""


@dataclass(frozen=True)
class StrideWindow:
    """A stride as samples of a reference, first and last."""

    first: int
    last: int
    how: str
    """One of "given", "stride", a complete one of a foot, or "return", where all feet come back nearest to where they
    began."""
    gap_percent: float
    """How far apart its ends are, of the paths' extent, the mean over the feet."""


@dataclass(frozen=True, eq=False)
class Animal:
    """An animal's motion, and the reference that was made of it."""

    reference: Reference
    analysis: ClipAnalysis
    gait: Gait
    rotation: Rotation
    """Takes the upright frame to the reference's world, with origin_m."""
    origin_m: Array
    rows: Index
    """(N,), samples of the analysis' fine grid that the reference is made from."""


# -- the clip --------------------------------------------------------------------------------------------------------


def reference_of(motion: Motion, stride_s: tuple[float, float] | None = None) -> Animal:
    """stride_s: as `analyse`. Raises InputError where the clip shows no feet, or too few frames of all of them."""
    analysis = analyse(motion, stride_s=stride_s)
    if (gait := analysis.gait) is None or not {*LEGS} <= {*motion.foot_names}:
        found = ", ".join(sorted(motion.foot_names)) or "none"
        expected = "all four feet: fit the whole animal, not the chain of one side"
        raise InputError(Problem(motion.file, "feet", found, expected))
    tracks, n = gait.tracks, len(gait.tracks.time_s)
    rear, front = (analysis.moved(name).series.value for name in motion.forward_names)
    known = np.column_stack([tracks.foot_m.reshape(n, -1), tracks.body_m, front - rear])
    ranges = frame_ranges(np.flatnonzero(np.isfinite(known).all(axis=1)))
    rows = np.arange(*max(ranges, key=lambda one: one[1] - one[0], default=(0, 0)))
    if len(rows) < MIN_SAMPLES:
        found = f"{len(rows) // 10} frames in a row with all feet and the trunk"
        raise InputError(Problem(motion.file, "frames", found, f"at least {MIN_SAMPLES // 10}"))
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
    standing, heights = np.zeros((len(time), len(LEGS)), bool), tracks.height_m[rows][:, order]
    for stance in gait.stances:
        within = (time >= stance.start_s - 1e-9) & (time <= stance.end_s + 1e-9)
        standing[within, LEGS.index(stance.foot)] = True
    feet[..., 0] -= (feet[..., 0].min(axis=0) + feet[..., 0].max(axis=0)) / 2
    feet[..., 1] -= feet[..., 1].mean(axis=0)
    for k, stands in enumerate(standing.T):
        feet[:, k, 2] = heights[:, k] - (heights[stands, k].mean() if stands.any() else heights[:, k].min())
    reference = Reference(
        time_s=time,
        base_m=np.column_stack([to_world.apply(body - origin)[:, :2], smoothed[:, 0]]),
        roll_pitch_yaw_rad=smoothed[:, 1:],
        feet_m=feet,
        standing=standing,
        leg_m=tracks.leg_m,
    )
    return Animal(reference, analysis, gait, to_world, origin, rows)


def _angles(analysis: ClipAnalysis, rows: Index, to_world: Rotation, trunk: Array) -> Array:
    """Roll, pitch and yaw (N, 3) of the trunk; the roll is that of the lines between where the legs hang on it: the
    first joints of the limbs to a left and a right foot that differ."""
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


# -- a stride --------------------------------------------------------------------------------------------------------


def stride_window(animal: Animal) -> StrideWindow:
    """The stride that was given, or a complete one, the first of the foot with the most, or else the nearest return of
    all feet.

    As no foot has landed twice then, a stride takes at least the time from the first touchdown to the end of the clip.
    """
    feet, time = animal.reference.feet_m, animal.reference.time_s
    within = [s for s in animal.gait.strides if time[0] - 1e-9 <= s.start_s and s.end_s <= time[-1] + 1e-9]
    of_feet = [s.foot for s in within]
    how, stride = "stride", min(within, key=lambda s: (-of_feet.count(s.foot), s.start_s), default=None)
    if (given := animal.analysis.given) is not None:
        how, stride = "given", given
    if stride is not None:
        first, last = (int(np.argmin(np.abs(time - t))) for t in (stride.start_s, stride.end_s))
        if time[last] - time[first] < 0.8 * (stride.end_s - stride.start_s):
            expected = f"within {time[0]:.3f}:{time[-1]:.3f}, where all feet are seen"
            raise InputError(Problem("--stride", "times", f"{stride.start_s:g}:{stride.end_s:g}", expected))
    else:
        how, first, last = "return", 0, len(time) - 1
        duration = float(time[-1] - time[0])
        landed = min((s.start_s for s in animal.gait.stances if s.begins), default=float(time[0]))
        least = min(duration, max(duration / 2, float(time[-1]) - landed))
        flat, best = feet.reshape(len(time), -1), np.inf
        for start in range(0, len(time), max(1, len(time) // 200)):
            ends = np.flatnonzero(time - time[start] >= least - 1e-9)
            apart = np.linalg.norm(flat[ends] - flat[start], axis=1)
            if apart.min(initial=np.inf) < best:
                best, first, last = float(apart.min()), start, int(ends[np.argmin(apart)])
    extent = np.linalg.norm(np.ptp(feet[first : last + 1], axis=0), axis=-1)
    gap = 100 * float(np.mean(np.linalg.norm(feet[last] - feet[first], axis=-1) / extent))
    return StrideWindow(first, last, how, gap)


def closed_stride(animal: Animal, window: StrideWindow) -> Reference:
    """The window as a stride that repeats: gaps are spread evenly over it, and `HARMONICS` kept. It goes straight on.

    A foot that does not stand in the window stands when it does so before or after, one stride away.
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
        at = np.flatnonzero(whole.standing[:, k]) - window.first
        standing[at % n, k] = True
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
