"""Measure anatomical joint angles in degrees, over time and over the stride.

The angles are flexions, which `recon.animal.flexion` defines.

Standard deviations combine the uncertainty of the fit's angles with `MODEL_RAD`, which allows for the skeleton's fixed
joint axes. The uncertainty of the angles is propagated linearly, with their covariances, or as if they were independent
if the fit does not state the uncertainty of flexions. Curves over a stride are means over the strides of the limb's own
foot. The uncertainty of the fit and the standard deviation between strides are reported separately.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from recon.animal.anatomy import GIRDLE, joint_and_side
from recon.animal.body import Side
from recon.animal.flexion import flexion_by_angles, flexion_rad
from recon.base.arrays import Array, Brief
from recon.base.numbers import NORMAL_90
from recon.fit.motion import Motion
from recon.gait.gait import Gait, Stride
from recon.gait.stances import INTERVAL

MODEL_RAD = np.radians(5.0)
"""Standard deviation of a joint angle due to motion that a skeleton of hinges cannot follow, rad.

`python benchmarks/gait.py --only flexion` prints the coverage of the intervals that result from this value.
"""
PERCENT = np.arange(101.0)
"""Phases of the stride at which mean flexion curves are computed, in percent from one touch-down to the next."""
MIN_KNOWN_FRACTION = 0.9
"""Minimum fraction of the stride's duration with a pose for a stride to contribute to the mean curve."""
MIN_STRIDES = 3
"""Minimum number of strides that show how much strides differ; a band from two strides would be 15 SDs wide."""
_ROWS_AT_ONCE = 500
"""Number of frames whose angles are computed at once, to limit memory."""


@dataclass(frozen=True, eq=False, repr=False)
class JointFlexion(Brief):
    """Flexion of one joint over the T frames of a clip; NaN in frames without a pose."""

    joint: str
    """Anatomical name of the joint, such as elbow."""
    side: Side | None
    """Side of the body; None for the spine and the neck."""
    angle_rad: Array
    """Flexion of the joint, 0 if straight, shape (T,)."""
    sigma_rad: Array
    """Standard deviation of the flexion, shape (T,); NaN if unknown."""

    @property
    def name(self) -> str:
        """Return the joint with its side, such as left_elbow."""
        return self.joint if self.side is None else f"{self.side}_{self.joint}"


@dataclass(frozen=True, eq=False, repr=False)
class StrideCurve(Brief):
    """Mean flexion of one joint over several strides, at the 101 phases `PERCENT`."""

    joint: str
    side: Side | None
    foot: str
    """Foot whose touch-downs begin the strides."""
    mean_rad: Array
    """Mean flexion over the strides, shape (101,)."""
    posterior_sigma_rad: Array
    """Standard deviation of the flexion in one stride due to the fit's uncertainty, shape (101,)."""
    between_sigma_rad: Array
    """Standard deviation between strides, shape (101,); NaN for a single stride."""
    strides: int
    duty_factor: float
    """Fraction of the stride, from 0 %, for which the foot is in stance."""

    @property
    def between_reach_rad(self) -> Array:
        """Return the distance from the mean within which 90 % of further strides lie, shape (101,).

        The distance follows from Student's t, because the standard deviation of a few strides is uncertain itself. It
        is NaN for fewer than `MIN_STRIDES` strides.
        """
        if self.strides < MIN_STRIDES:
            return np.full(len(PERCENT), np.nan)
        quantile = stdtrit(self.strides - 1, 0.5 + INTERVAL / 2)
        return np.asarray(quantile * np.sqrt(1 + 1 / self.strides) * self.between_sigma_rad)


@dataclass(frozen=True)
class Extreme:
    """Greatest or least flexion in a mean curve over the stride, and the phase at which it occurs."""

    value_rad: float
    sigma_rad: float
    """Standard deviation of the flexion from the fit's uncertainty and the scatter of the strides."""
    percent: float
    percent_low: float
    """Lower end of the 90 % interval of the phase, percent of the stride.

    The value is below 0 if the interval begins before touch-down, and NaN if the phase is not known.
    """
    percent_high: float


def joint_flexions(motion: Motion) -> tuple[JointFlexion, ...]:
    """Return the flexion of every anatomical joint of the skeleton over the clip."""
    body, posed = motion.body, np.flatnonzero(motion.solved)
    if not body.anatomy or not len(posed):
        return ()
    angle = np.full((len(body.anatomy), len(motion.frames)), np.nan)
    sigma = angle.copy()
    for rows in np.array_split(posed, -(-len(posed) // _ROWS_AT_ONCE)):
        states, stated = motion.states[rows], motion.solution.flexion_sigma_rad
        angle[:, rows] = flexion_rad(body, states, motion.size)
        if stated is not None:
            variance = stated[rows] ** 2
        else:  # the covariances of the angles are unknown
            by_angles = flexion_by_angles(body, states, motion.size)
            variance = np.sum((by_angles * motion.solution.angle_sigma_rad[rows, None]) ** 2, axis=2)
        sigma[:, rows] = np.sqrt(variance + MODEL_RAD**2).T
    joints = map(joint_and_side, body.anatomy)
    return tuple(JointFlexion(joint, side or motion.side, angle[i], sigma[i]) for i, (joint, side) in enumerate(joints))


def stride_curves(flexions: Sequence[JointFlexion], gait: Gait | None, time_s: Array) -> tuple[StrideCurve, ...]:
    """Return the mean flexion of each joint over the complete strides of the foot of its limb.

    For the spine and the neck, the strides of the foot with the most strides are used. Joints without complete strides
    are left out. `time_s` are the times of the frames, shape (T,).
    """
    if gait is None or not gait.strides:
        return ()
    strides: dict[str, list[Stride]] = {}
    for stride in gait.strides:
        strides.setdefault(stride.foot, []).append(stride)
    reference = max(strides, key=lambda foot: (len(strides[foot]), foot))
    curves = (
        _curve_over(flexion, foot, strides[foot], time_s)
        for flexion in flexions
        if (foot := _foot_of(flexion, strides, reference)) is not None
    )
    return tuple(curve for curve in curves if curve is not None)


def _foot_of(flexion: JointFlexion, strides: Mapping[str, Sequence[Stride]], reference: str) -> str | None:
    """Return the foot whose strides define the phase of a joint, or None if this foot has no complete stride.

    The foot belongs to the joint's limb. The foot `reference` is used for the spine and the neck, and for a fore limb
    if no fore foot has strides.
    """
    girdle = GIRDLE[flexion.joint]
    if flexion.side is None or girdle is None:
        return reference
    label = {"left": "L", "right": "R"}[flexion.side] + girdle
    if label in strides:
        return label
    return reference if girdle == "F" and not any(foot.endswith("F") for foot in strides) else None


def _curve_over(flexion: JointFlexion, foot: str, strides: Sequence[Stride], time_s: Array) -> StrideCurve | None:
    angles, variances, duties = [], [], []
    for stride in strides:
        is_inside = (time_s >= stride.start_s) & (time_s <= stride.end_s)
        is_known = np.isfinite(flexion.angle_rad)
        if not is_inside.any() or is_known[is_inside].mean() < MIN_KNOWN_FRACTION:
            continue
        # A stride between lift-offs ends with its stance, so its touch-down is one stance before its end.
        touch_down_s = stride.end_s - stride.duty_factor * stride.duration_s if stride.at == "lift-off" else None
        at_s = stride.start_s + PERCENT / 100 * stride.duration_s
        if touch_down_s is not None:
            at_s = stride.start_s + np.mod(touch_down_s - stride.start_s + at_s - stride.start_s, stride.duration_s)
        angles.append(np.interp(at_s, time_s[is_known], flexion.angle_rad[is_known]))
        variances.append(np.interp(at_s, time_s[is_known], flexion.sigma_rad[is_known] ** 2))
        duties.append(stride.duty_factor)
    if not angles:
        return None
    values = np.array(angles)
    return StrideCurve(
        joint=flexion.joint,
        side=flexion.side,
        foot=foot,
        mean_rad=values.mean(axis=0),
        posterior_sigma_rad=np.sqrt(np.mean(variances, axis=0)),
        between_sigma_rad=values.std(axis=0, ddof=1) if len(values) > 1 else np.full(len(PERCENT), np.nan),
        strides=len(values),
        duty_factor=float(np.median(duties)),
    )


def extreme(curve: StrideCurve, sign: int = 1) -> Extreme:
    """Return the greatest (`sign` 1) or the least (`sign` -1) flexion of a mean curve, with its phase.

    The interval of the phase contains all phases at which the mean differs from the extreme by less than 1.645 standard
    deviations of the difference between two independent values. Errors of neighbouring frames are correlated, so the
    interval contains the true phase in at least 90 % of cases.
    """
    values = sign * curve.mean_rad
    scatter = np.nan_to_num(curve.between_sigma_rad) / curve.strides**0.5
    sigmas = np.hypot(curve.posterior_sigma_rad, scatter)
    peak, size = int(np.argmax(values)), len(values) - 1
    is_near = values >= values[peak] - NORMAL_90 * np.hypot(sigmas, sigmas[peak])
    ends = []
    for step in (-1, 1):
        offsets = np.arange(size) * step
        is_far = ~is_near[np.mod(peak + offsets, size)]
        is_far[0] = False
        ends.append(float(peak + offsets[int(np.argmax(is_far))] - step) if is_far.any() else np.nan)
    low, high = ends
    return Extreme(float(curve.mean_rad[peak]), float(sigmas[peak]), float(PERCENT[peak]), low, high)
