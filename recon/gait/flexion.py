"""Measure anatomical joint angles in degrees, over time and over the stride.

The skeleton's file lists the three markers that define each joint (`[anatomy]`). The flexion is the angle between the
line from the first marker to the joint and the line from the joint to the third marker, in the sagittal plane of the
segment that carries the first marker. A straight joint has a flexion of 0, and a hyperextended joint a negative one.

Standard deviations combine the uncertainty of the fit's angles with `MODEL_RAD`, which allows for the skeleton's fixed
joint axes. The uncertainty of the angles is propagated linearly, as if they were independent. Curves over a stride are
means over the strides of the limb's own foot. The uncertainty of the fit and the standard deviation between strides are
reported separately.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from recon.animal.anatomy import FLEXES_CAUDALLY, GIRDLE, joint_and_side, sagittal_angle
from recon.animal.body import Body, Side
from recon.base.arrays import Array, Brief
from recon.base.numbers import NORMAL_90
from recon.fit.motion import Motion
from recon.gait.gait import Gait, Stride
from recon.geometry.kinematics import Marker, Tree

MODEL_RAD = np.radians(5.0)
"""Standard deviation of a joint angle due to motion that a skeleton of hinges cannot follow, rad.

`python benchmarks/gait.py --only flexion` prints the coverage of the intervals that result from this value.
"""
PERCENT = np.arange(101.0)
"""Phases of the stride at which mean flexion curves are computed, in percent from one touch-down to the next."""
MIN_KNOWN_FRACTION = 0.9
"""Minimum fraction of the stride's duration with a pose for a stride to contribute to the mean curve."""
_ROWS_AT_ONCE = 500
"""Number of frames whose derivatives are computed at once, to limit memory."""


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
    def name(self) -> str:
        """Return the joint with its side, such as left_elbow."""
        return self.joint if self.side is None else f"{self.side}_{self.joint}"


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


def flexion_rad(body: Body, states: Array, size: float = 1.0) -> Array:
    """Return the flexion of the A anatomical joints (`body.anatomy`) in states (T, D), shape (A, T), rad.

    Angles are between -90 and 270 degrees, because no joint extends 90 degrees beyond straight, while a folded joint
    may bend by more than 180 degrees.
    """
    points_m = body.tree.pose(states, size).points_m
    orientations = body.tree.orientations(states)
    segment_names = [segment.name for segment in body.tree.segments]
    carriers = {marker.name: segment_names.index(marker.segment) for marker in body.tree.markers}
    angles = []
    for name, markers in body.anatomy.items():
        first, middle, last = (points_m[:, body.markers.index(marker)] for marker in markers)
        left = orientations[:, carriers[markers[0]], :, 1]
        angle = sagittal_angle(middle - first, last - middle, left) * FLEXES_CAUDALLY[joint_and_side(name)[0]]
        angles.append(np.mod(angle + np.pi / 2, 2 * np.pi) - np.pi / 2)
    return np.array(angles).reshape(-1, len(states))


def _gradients(proximal: Array, distal: Array, left: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives of `sagittal_angle` with respect to its three arguments, each of shape (T, 3)."""
    sideways = np.sum(proximal * left, axis=1, keepdims=True), np.sum(distal * left, axis=1, keepdims=True)
    normal = np.cross(proximal, distal)
    sine = np.sum(normal * left, axis=1, keepdims=True)
    cosine = np.sum(proximal * distal, axis=1, keepdims=True) - sideways[0] * sideways[1]
    square = sine**2 + cosine**2
    sine, cosine = sine / square, cosine / square
    return (
        cosine * np.cross(distal, left) - sine * (distal - sideways[1] * left),
        cosine * np.cross(left, proximal) - sine * (proximal - sideways[0] * left),
        cosine * normal + sine * (sideways[1] * proximal + sideways[0] * distal),
    )


def joint_flexions(motion: Motion) -> tuple[JointFlexion, ...]:
    """Return the flexion of every anatomical joint of the skeleton over the clip."""
    body, posed = motion.body, np.flatnonzero(motion.solved)
    if not body.anatomy or not len(posed):
        return ()
    angle = np.full((len(body.anatomy), len(motion.frames)), np.nan)
    sigma = angle.copy()
    for rows in np.array_split(posed, -(-len(posed) // _ROWS_AT_ONCE)):
        states, angle_sigma = motion.states[rows], motion.solution.angle_sigma_rad[rows]
        angle[:, rows] = flexion_rad(body, states, motion.size)
        sigma[:, rows] = np.sqrt(flexion_variance(body, states, angle_sigma, motion.size) + MODEL_RAD**2)
    joints = map(joint_and_side, body.anatomy)
    return tuple(JointFlexion(joint, side or motion.side, angle[i], sigma[i]) for i, (joint, side) in enumerate(joints))


def flexion_variance(body: Body, states: Array, angle_sigma: Array, size: float = 1.0) -> Array:
    """Return the variance of the A flexions due to independent errors of the fit's angles, shape (A, T), rad^2.

    `angle_sigma` are the standard deviations of the fit's angles, shape (T, D - 3), rad. `MODEL_RAD` is not included.
    """
    segment_of, signs = {marker.name: marker.segment for marker in body.tree.markers}, (0, 1)
    # Two points on the left axis of a segment, 1 m apart, have the derivatives of the axis.
    carriers = dict.fromkeys(segment_of[markers[0]] for markers in body.anatomy.values())
    on_axes = [Marker(f"{segment} {side}", segment, (0.0, side - 0.5, 0.0)) for segment in carriers for side in signs]
    tree = Tree(body.tree.segments, (*body.tree.markers, *on_axes))
    row_of = {marker.name: row for row, marker in enumerate(tree.markers)}
    posed = tree.pose_with_jacobian(states, size)
    variance = np.empty((len(body.anatomy), len(states)))
    for i, markers in enumerate(body.anatomy.values()):
        rows = [row_of[name] for name in (*markers, *(f"{segment_of[markers[0]]} {side}" for side in signs))]
        first, middle, last, right, left = np.moveaxis(posed.points_m[:, rows], 1, 0)
        by_proximal, by_distal, by_left = _gradients(middle - first, last - middle, (left - right) / size)
        by_point = [-by_proximal, by_proximal - by_distal, by_distal, -by_left / size, by_left / size]
        change = np.einsum("tpk,tpkd->td", np.stack(by_point, axis=1), posed.jacobian[:, rows, :, 3:])
        variance[i] = np.sum((change * angle_sigma) ** 2, axis=1)
    return variance


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
