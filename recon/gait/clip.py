"""Analyse a fitted clip: kinematics, joint angles, gait, phase portraits and dynamics.

The joints of a fit without uncertainty (the frame method) jitter from frame to frame, and the derivatives of exact
splines through them are mostly noise. The paths and angles of such a fit are therefore smoothed according to the
jitter, and all further results are computed from the smoothed paths and angles.

The errors of a fit with uncertainty have three components with different correlation times. The error of the animal's
size is constant, and changes the distance from a single camera by the same factor in every frame. The errors of the
whole animal's position and of its pose change as fast as the errors of the detections and the animal's motion. Their
correlation time is the geometric mean of these two times (`error_time_s`), multiplied by a factor. The factor was
chosen so that the stated standard deviations of velocities agree on average with the errors in real runs (`python
benchmarks/gait.py --only rates`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from recon.base.arrays import Array, Bools, Brief
from recon.base.errors import InputError, Problem
from recon.clip import frame_ranges
from recon.fit import constants
from recon.fit.belt import belt_path_m, relative_to_belt
from recon.fit.motion import MEASURED_FRACTION, Motion
from recon.fit.result import TrajectorySolution
from recon.gait import kinematics, phase
from recon.gait.dynamics import Dynamics, dynamics, over_stride
from recon.gait.end_effector import EndEffector, end_effector
from recon.gait.flexion import JointFlexion, StrideCurve, joint_flexions, stride_curves
from recon.gait.gait import Gait, Stride, gait
from recon.gait.kinematics import AngleKinematics, JointKinematics, at_frames
from recon.gait.nearest_return import longest_stretch, nearest_return
from recon.gait.quantities import AnalysedClip, GaitQuantity, gait_quantities
from recon.gait.series import Errors, jitter_errors, lasting_errors
from recon.gait.spline import MIN_POINTS
from recon.gait.stances import BODY, interval_of, interval_text, pose_tracks
from recon.geometry.kinematics import PITCH
from recon.io.common import Pose3D

if TYPE_CHECKING:
    import pandas as pd

POSITION_ERROR_TIME = 2.0
"""Correlation time of the errors of the animal's position, in units of `error_time_s`.

The value was measured on running cheetahs (`python benchmarks/gait.py --only rates`).
"""
POSE_ERROR_TIME = 0.6
"""Correlation time of the errors of the joints relative to their mean, in units of `error_time_s`.

The value was measured on running cheetahs, as was `POSITION_ERROR_TIME`.
"""
RUNNING_S = 0.1
"""Value of `error_time_s` for a running animal, s.

The stances of all animals are found with this value, because the value for a walk would make stances too short.
"""
SPEED_KNOWN = 0.2
"""Largest standard deviation of a peak speed, as a fraction of that speed, with which speeds are reported."""
UNSEEN_S = 0.2
"""Longest time in seconds without a detection of a foot for which the foot's position is used to find stances.

In longer times without a detection, the position comes from the prior only.
"""
BELT_GIVEN = (
    "Only the analysis used the belt's speed, not the fit. Fit again with --set belt-speed-m-s for the best result."
)
_ROWS_AT_ONCE = 200
"""Number of frames whose derivatives are computed at once, to limit memory."""
STIFF_RAD = 1e-6
"""Smallest range of the back's angle over a clip that counts as flexion, rad.

The range is smaller only if all joints of the back are on one segment.
"""


@dataclass(frozen=True, eq=False, repr=False)
class ClipAnalysis(Brief):
    """Analysis of a fitted motion of T frames and J joints, each part of which is computed on first use.

    The fine grid has N times, ten per frame. The motion needs at least `MIN_POINTS` frames with a pose (`analyse`
    raises an error otherwise).
    """

    motion: Motion
    given: Stride | None = None
    """Stride given by the user; None to use a stride found in the clip."""
    body_mass_kg: float | None = None
    """Mass of the animal; None if unknown."""

    @property
    def reference(self) -> str:
        """Return the name of the joint that represents the animal's position."""
        return self.motion.reference

    @cached_property
    def errors(self) -> Sequence[Errors]:
        """Return the position errors of the joints due to the animal's size, position and pose, each (T, J, 3), metres.

        If the fit states no uncertainty over time, the errors are estimated from the jitter of the joints.
        """
        xyz_m = self.tracked.xyz_m
        return _errors(self.motion, xyz_m, error_time_s(xyz_m, self.motion.fps))

    @cached_property
    def tracked(self) -> Pose3D:
        """Return the upright pose, moved onto the path of the reference joint if the solution has such a path.

        Poses that were solved frame by frame jitter along the line of sight, but the path does not.
        """
        pose, path = self.motion.upright, self.motion.solution.reference_path
        if path is None:
            return pose
        off_m = path.position_m - pose.xyz_m[:, pose.names.index(self.reference)]
        return replace(pose, xyz_m=pose.xyz_m + off_m[:, None])

    @cached_property
    def pose(self) -> Pose3D:
        """Return the upright pose for angles, gait and vector fields, smoothed if the motion jitters."""
        pose = self.tracked
        if not self.motion.jitters:
            return pose
        errors, options = jitter_errors(pose.xyz_m), {"smooth": True, "propagate": (), "oversampling": 1}
        paths = [kinematics.joint_kinematics(pose, name, self.motion.fps, errors, **options) for name in pose.names]
        xyz_m = np.stack([path.series.value for path in paths], axis=1)
        if self.motion.solution.reference_path is not None:
            xyz_m[:, pose.names.index(self.reference)] = at_frames(self.reference_motion).series.value
        return replace(pose, xyz_m=xyz_m)

    @cached_property
    def reference_motion(self) -> JointKinematics:
        """Return the motion of the reference joint on the fine grid."""
        return self.moved(self.reference)

    @cached_property
    def joints(self) -> dict[str, JointKinematics]:
        """Return a dictionary of the motion of every joint, with the joints' names as keys.

        To save memory, only the reference joint has values between the frames.
        """
        at_rate = {name: at_frames(self.moved(name)) for name in self.motion.upright.names if name != self.reference}
        return {name: at_rate.get(name, self.reference_motion) for name in self.motion.upright.names}

    def moved(self, name: str, with_size: bool = True) -> JointKinematics:
        """Return the motion of a joint on the fine grid.

        If `with_size` is true, the standard deviations include the uncertainty of the animal's size.
        """
        motion, path = self.motion, self.motion.solution.reference_path
        if path is not None and name == self.reference:
            return kinematics.path_kinematics(motion.time_s, path, motion.solved, with_size)
        errors = [error for error in self.errors if with_size or error.correlation_s < np.inf]
        return kinematics.joint_kinematics(self.tracked, name, motion.fps, errors, smooth=motion.jitters)

    @cached_property
    def angles(self) -> dict[str, AngleKinematics]:
        """Return a dictionary of the angles at the inner joints of each limb, and of the flexion of the spine.

        The keys are the joints' names, and "spine_flexion" if the skeleton has a flexible back.
        """
        # A displacement of all joints together does not change the angles.
        errors = () if self.motion.jitters else self.errors[-1:]
        result, fps = {}, self.motion.fps
        for along in limb_chains(self.motion).values():
            for i in range(1, len(along) - 1):
                if along[i] not in result:
                    joints = along[i - 1], along[i], along[i + 1]
                    result[along[i]] = kinematics.joint_angle(self.pose, joints, fps, errors)
        if (joints := self._spine) and np.ptp(kinematics.joint_angle(self.pose, joints, fps).range_rad) > STIFF_RAD:
            result["spine_flexion"] = kinematics.spine_flexion(self.pose, fps, errors, joints)
        return result

    @property
    def _spine(self) -> tuple[str, str, str] | None:
        """Return the rear, the middle and the front marker of the back, or None if the skeleton has no such markers.

        The middle marker is the marker of the spine in the skeleton's anatomy or, if the motion does not have this
        marker, the middle one of the limb along the back.
        """
        named = self.motion.body.anatomy.get("spine")
        if named and {*named} <= {*self.motion.names}:
            return named
        rear, front = self.motion.forward_names
        for along in limb_chains(self.motion).values():
            if {rear, front} <= {*along}:
                first, last = sorted((along.index(rear), along.index(front)))
                if between_ends := along[first + 1 : last]:
                    return rear, between_ends[len(between_ends) // 2], front
        return None

    @cached_property
    def skeleton_angles(self) -> dict[str, AngleKinematics]:
        """Return a dictionary of the angles that the fit solved for, such as the pitch of the trunk."""
        motion = self.motion
        sigma = np.maximum(np.nan_to_num(motion.posture_sigma_rad), 1e-6)
        stated = [[Errors(column, self.errors[-1].correlation_s)] for column in sigma.T]
        errors = map(jitter_errors, motion.posture_rad.T) if motion.jitters else stated
        rows = zip(motion.posture_names, motion.posture_rad.T, errors, strict=True)
        return {
            name: kinematics.angle_kinematics(motion.time_s, angle, errors, smooth=motion.jitters)
            for name, angle, errors in rows
        }

    @cached_property
    def gait(self) -> Gait | None:
        """Return the gait, or None for an animal without feet."""
        motion = self.motion
        if not motion.foot_names:
            return None
        body = BODY if set(BODY) <= {*self.pose.names} else motion.forward_names
        segments, seen_pose = [segment.rows for segment in motion.segments], _seen(motion, self.pose)
        errors = _errors(motion, self.tracked.xyz_m, RUNNING_S)
        tracks = pose_tracks(seen_pose, motion.fps, errors, motion.foot_names, body, segments, restless=motion.jitters)
        return gait(tracks)

    @cached_property
    def quantities(self) -> dict[str, GaitQuantity]:
        """Return a dictionary of speed, strides, steps, limb phases and asymmetries, with their uncertainty."""
        unsized = self.moved(self.reference, with_size=False)
        parts = AnalysedClip(self.motion, self.gait, self.errors, self.reference_motion, unsized, self.why_no_speed)
        return gait_quantities(parts)

    @cached_property
    def standing(self) -> Bools:
        """Return a mask of the frames in which each of the F feet is in stance, shape (T, F)."""
        motion = self.motion
        stands = np.zeros((len(motion.frames), len(motion.feet)), dtype=bool)
        if len(stands) >= MIN_POINTS and self.gait is not None:
            for stance in self.gait.stances:
                rows = slice(math.ceil(stance.start_row), math.floor(stance.end_row) + 1)
                stands[rows, motion.foot_labels.index(stance.foot)] = True
        return stands & motion.solved[:, None]

    @cached_property
    def fields(self) -> dict[str, tuple[phase.LinkField, ...]]:
        """Return a dictionary of the vector fields of each limb's links, with the limbs' names as keys."""
        motion, chains, forward = self.motion, limb_chains(self.motion), self.motion.forward_names
        fields = {
            limb: phase.pose_vector_field(self.pose, chain, motion.fps, forward) for limb, chain in chains.items()
        }
        return _with_sigma(fields, motion, chains, [*self.skeleton_angles.values()])

    @cached_property
    def flexions(self) -> tuple[JointFlexion, ...]:
        """Return the flexion of the skeleton's anatomical joints; empty for a skeleton without `[anatomy]`."""
        return joint_flexions(self.motion)

    @cached_property
    def flexion_curves(self) -> tuple[StrideCurve, ...]:
        """Return the mean flexion of each joint over the stride; empty without complete strides."""
        return stride_curves(self.flexions, self.gait, self.motion.time_s)

    @cached_property
    def stride(self) -> Stride | None:
        """Return the stride that phase portraits show, or None if the clip has no stride.

        A stride given by the user has precedence. Otherwise the first complete stride of the foot with the most strides
        is used or, for a chain, the first stride of the end effector. For a chain without a complete stride, the
        nearest return of the end effector takes the place of the stride. `recon ik` uses the same stride of a chain.
        """
        if self.given is not None:
            return self.given
        if (stride := self._effector_stride) is not None:
            return stride
        strides = () if self.gait is None else self.gait.strides
        feet = [stride.foot for stride in strides]
        first = min(strides, key=lambda s: (-feet.count(s.foot), s.start_s), default=None)
        if first is None:
            return self._effector_return
        return first if self.motion.chain is None else _from_pose(self.motion, first)

    @cached_property
    def end_effector(self) -> EndEffector | None:
        """Return the path of a chain's fore foot relative to the reference joint.

        Return None for a whole animal, and for a clip that is too short to be smoothed, for example with four frames.
        """
        return self._effector_of(self.pose)

    def _effector_of(self, pose: Pose3D) -> EndEffector | None:
        motion = self.motion
        label = next((label for label in motion.foot_names if label.endswith("F")), None)
        if motion.chain is None or label is None:
            return None
        points_m, names = pose.xyz_m, pose.names
        rear, front = (points_m[:, names.index(name)] for name in motion.forward_names)
        if not np.isfinite(front - rear).any():
            return None
        foot_m, body_m = (points_m[:, names.index(name)] for name in (motion.foot_names[label], self.reference))
        return end_effector(label, motion.time_s, foot_m, body_m, np.nanmean(front - rear, axis=0))

    @cached_property
    def _effector_stride(self) -> Stride | None:
        motion, effector = self.motion, self.end_effector
        span_s = None if effector is None else effector.stride_s(motion.time_s[longest_stretch(motion.solved)])
        if effector is None or span_s is None:
            return None
        return self._stride_over(effector.foot, span_s, "end effector")

    @property
    def _effector_return(self) -> Stride | None:
        """Return the nearest return of a chain's end effector relative to the body, or None.

        The search is in the plane of travel, because a single camera hardly shows the motion across it. The poses are
        not smoothed, because inverse kinematics follows the fitted poses.
        """
        if (effector := self._effector_of(self.tracked)) is None:
            return None
        path_m = np.column_stack([effector.forward_m, effector.up_m])[:: effector.oversampling]
        frames = nearest_return(np.where(self.motion.solved[:, None], path_m, np.nan))
        if frames is None:
            return None
        first_s, fps = float(self.motion.time_s[0]), self.motion.fps
        return self._stride_over(effector.foot, (first_s + frames[0] / fps, first_s + frames[1] / fps), "return")

    def _stride_over(self, foot: str, span_s: tuple[float, float], at: Literal["end effector", "return"]) -> Stride:
        """Return a stride of a foot between two times (s), as long as the body's horizontal displacement."""
        series = self.reference_motion.series
        begin, end = (
            np.array([np.interp(at_s, series.time_s, series.value[:, axis]) for axis in (0, 1)]) for at_s in span_s
        )
        return Stride(foot, *span_s, float(np.linalg.norm(end - begin)), np.nan, np.nan, at)

    @cached_property
    def dynamics(self) -> Dynamics | None:
        """Return the centre of mass, the energies and the vertical forces of the feet.

        Return None if the segments' masses are unknown or only one side of the animal was fitted.
        """
        return dynamics(self.motion, self.gait, self.errors)

    @cached_property
    def over_strides(self) -> list[dict[str, tuple[float, float, float]]]:
        """Return the work, power, acceleration and exchange of energy (`over_stride`) of each complete stride.

        The list is empty without `dynamics`.
        """
        if self.gait is None or self.dynamics is None:
            return []
        return [over_stride(self.dynamics, stride.start_s, stride.end_s) for stride in self.gait.strides]

    @property
    def net_acceleration_m_s2(self) -> tuple[float, float]:
        """Return the net acceleration of the reference joint over the clip and its standard deviation, m/s^2."""
        points_m, index = self.tracked.xyz_m, self.motion.names.index(self.reference)
        errors = [error[:, index] for error in self.errors]
        return kinematics.net_acceleration(self.motion.time_s, points_m[:, index], errors)

    @property
    def speed(self) -> pd.DataFrame:
        """Return a table of the reference joint's speed along its path, with ten rows per frame.

        The columns are speed_m_s, sigma_m_s, low_m_s and high_m_s (the 90 % interval), indexed by time_s.

        Raises
        ------
        InputError
            If the speed is unknown (`why_no_speed`).
        """
        import pandas as pd

        if self.why_no_speed is not None:
            actual = f"no known speed, because {self.why_no_speed}"
            raise InputError(Problem(self.motion.file, "speed", actual, "a path with a known speed"))
        reference_motion = self.reference_motion
        speed, low, high = interval_of(reference_motion.speed_m_s, reference_motion.speed_sigma_m_s)
        values = {"speed_m_s": speed, "sigma_m_s": reference_motion.speed_sigma_m_s, "low_m_s": np.maximum(low, 0.0)}
        values["high_m_s"] = high
        return pd.DataFrame(values, index=pd.Index(reference_motion.series.time_s, name="time_s"))

    @cached_property
    def not_measured(self) -> tuple[str, ...]:
        """Return the names of the fit's angles whose precision comes mostly from the prior, not from the detections.

        The detections provide less than the fraction `MEASURED_FRACTION` of the precision of these angles.
        """
        return tuple(name for name, fraction in self.motion.data_shares.items() if fraction < MEASURED_FRACTION)

    @cached_property
    def why_no_speed(self) -> str | None:
        """Return the reason why speeds are unknown, or None if speeds are known or the fit states their uncertainty.

        The speeds of all joints are unknown if the distance of the animal from the camera is too uncertain.
        """
        if not self.motion.jitters:
            return None
        if self.motion.solution.position_error_time_s is None:
            return "each frame was solved separately, and a single frame hardly shows the distance from the camera"
        peak, sigma = self.reference_motion.peak_speed_m_s, self.reference_motion.peak_speed_sigma_m_s
        return f"its peak is {interval_text(peak, sigma, 'm/s')}" if sigma > SPEED_KNOWN * peak else None

    @property
    def during_stride(self) -> Bools:
        """Return a mask (T,) of the frames within `stride`, or of all frames without a stride."""
        time_s, half = self.motion.time_s, 0.5 / self.motion.fps
        if self.stride is None:
            return np.ones(len(time_s), dtype=bool)
        return (time_s >= self.stride.start_s - half) & (time_s <= self.stride.end_s + half)

    @cached_property
    def portraits(self) -> dict[str, phase.Portrait]:
        """Return phase portraits of the angles that the fit solved for, over `stride` or, without one, the clip."""
        ends = () if self.stride is None else (self.stride.start_s, self.stride.end_s)
        return {name: phase.phase_portrait(angle, *ends) for name, angle in self.skeleton_angles.items()}

    @cached_property
    def closures(self) -> dict[str, phase.Closure]:
        """Return the degree of closure of each phase portrait that has no gap in `stride`; empty without a stride."""
        if self.stride is None:
            return {}
        complete = {
            k: path for k, path in self.portraits.items() if len(path.time_s) > 1 and np.isfinite(path.rate_rad_s).all()
        }
        return {name: phase.closure(portrait) for name, portrait in complete.items()}


def analyse(
    motion: Motion, stride_s: tuple[float, float] | None = None, belt_speed_m_s: float | None = None
) -> ClipAnalysis:
    """Return the analysis of a fitted motion, whose parts are computed on first use.

    Parameters
    ----------
    motion : Motion
        A fitted clip.
    stride_s : tuple of float, optional
        Start and end of the stride that phase portraits show, s; by default the first complete stride or, for a chain
        without a complete stride, the nearest return of its foot.
    belt_speed_m_s : float, optional
        Speed of a treadmill's belt, m/s, so that the motion is analysed relative to the belt. None for a motion over
        ground, and for a fit that already had the belt's speed.

    Raises
    ------
    InputError
        If fewer than four frames have a pose, the stride is outside the clip, or the fit already had a belt speed.
    """
    motion = motion if belt_speed_m_s is None else over_belt(motion, belt_speed_m_s)
    stride = None if stride_s is None else stride_given(motion, stride_s)
    is_known = np.isfinite(motion.upright.xyz_m).all(axis=(1, 2))
    if is_known.sum() < MIN_POINTS:
        pose_count = f"{is_known.sum()} frames with a pose"
        raise InputError(Problem(motion.file, "frames", pose_count, f"at least {MIN_POINTS} frames"))
    return ClipAnalysis(motion, stride)


def over_belt(motion: Motion, speed_m_s: float) -> Motion:
    """Return a motion on a treadmill relative to the belt, which moves at `speed_m_s`.

    The finding that feet in stance slide is removed from the motion's verdict.

    Raises
    ------
    InputError
        If the fit already had a belt speed.
    """
    if (fitted_m_s := motion.settings.get("belt_speed_m_s")) is not None:
        expected = f"no --belt-speed, because the fit already used {fitted_m_s:g} m/s"
        raise InputError(Problem("--belt-speed", "speed", f"{speed_m_s:g} m/s", expected))
    path_m = belt_path_m(motion.solution, motion.time_s, speed_m_s)
    findings = tuple(finding for finding in motion.findings if finding.code != "treadmill")
    verdict = motion.verdict
    if verdict is not None and verdict.level == "do not use" and len(findings) < len(motion.findings):
        verdict = replace(verdict, level="check", reason=BELT_GIVEN)
    return replace(motion, solution=relative_to_belt(motion.solution, path_m), findings=findings, verdict=verdict)


def stride_given(motion: Motion, stride_s: tuple[float, float]) -> Stride:
    """Return the stride given by `--stride`, which does not belong to a foot.

    The stride has the given duration and begins at the frame nearest to the given start that has a pose, because
    inverse kinematics starts from a pose.

    Raises
    ------
    InputError
        If the times are outside the clip or less than two frames apart.
    """
    start_s, end_s = stride_s
    first_s, last_s = motion.time_s[[0, -1]]
    slack = 0.5 / motion.fps
    if not first_s - slack <= start_s < end_s <= last_s + slack or end_s - start_s < 2 / motion.fps:
        expected = f"START:END between {first_s:.3f} and {last_s:.3f} s, with two frames or more"
        raise InputError(Problem("--stride", "times", f"{start_s:g}:{end_s:g} s", expected))
    return _from_pose(motion, Stride("", start_s, end_s, np.nan, np.nan, np.nan, "given"))


def _from_pose(motion: Motion, stride: Stride) -> Stride:
    """Return the stride, moved so that it begins in a frame with a pose and ends before the last frame with a pose."""
    known_s = motion.time_s[longest_stretch(motion.solved)]
    if not len(known_s):
        return stride
    # A later start would put the end of the stride after the last frame.
    begins_s = known_s[(known_s + stride.duration_s <= known_s[-1] + 1e-6) | (known_s == known_s[0])]
    start_s = float(begins_s[np.argmin(np.abs(begins_s - stride.start_s))])
    return replace(stride, start_s=start_s, end_s=min(start_s + stride.duration_s, float(known_s[-1])))


def limb_chains(motion: Motion) -> dict[str, tuple[str, ...]]:
    """Return a dictionary of the joints along the trunk and along each limb attached to the trunk.

    The keys are the limbs' names. Chains have at least three joints. The chain of a limb begins with the preceding
    joint of the trunk, so that the limb's first link has a parent.
    """
    limbs = {limb: tuple(motion.names[j] for j in along) for limb, along in motion.limbs.items()}
    trunk = next((along for along in limbs.values() if set(motion.forward_names) <= {*along}), motion.forward_names)
    chains = {}
    for limb, along in limbs.items():
        if along[0] in trunk and along != trunk:
            index = trunk.index(along[0])
            along = (trunk[index - 1] if index else trunk[1], *along)
        elif along != trunk:
            continue
        if len(along) > 2:
            chains[limb] = along
    return chains


def _errors(motion: Motion, xyz_m: Array, error_s: float) -> Sequence[Errors]:
    """Return the independent errors of the joints' positions (T, J, 3), metres.

    `error_s` is the correlation time that `error_time_s` returns for the positions, s.
    """
    solution, floor = motion.solution, 1e-4
    if motion.jitters:
        independent_and_lasting, path = lasting_errors(xyz_m, motion.fps), solution.reference_path
        position_time_s = solution.position_error_time_s
        if path is None or position_time_s is None:
            return independent_and_lasting
        path_sigma = np.sqrt(np.diagonal(path.covariance[:, :3, :3], axis1=1, axis2=2))[:, None]
        rest = np.broadcast_to(np.maximum(path_sigma, floor), xyz_m.shape)
        return *independent_and_lasting, Errors(_by_size(motion), np.inf), Errors(rest, position_time_s)
    # These errors are common to all joints. The relative error of a joint can exceed its absolute error.
    position = np.sqrt(np.maximum(motion.upright_sigma_m**2 - motion.upright_relative_sigma_m**2, floor**2))
    of_pose = Errors(np.maximum(motion.upright_relative_sigma_m, floor), POSE_ERROR_TIME * error_s)
    if not isinstance(solution, TrajectorySolution) or len(solution.views) != 1:
        return Errors(position, POSITION_ERROR_TIME * error_s), of_pose
    by_size = _by_size(motion)
    rest = np.sqrt(np.maximum(position**2 - by_size**2, floor**2))
    return Errors(by_size, np.inf), Errors(rest, POSITION_ERROR_TIME * error_s), of_pose


def _by_size(motion: Motion) -> Array:
    """Return the signed standard deviations of the joints' positions due to the animal's size, (T, J, 3), metres.

    The size scales the distance from the camera, so its error moves all joints along their lines of sight.
    """
    solution = motion.solution
    size_sigma = getattr(solution, "size_sigma", None) or 0.0
    return np.asarray(size_sigma / solution.size * (solution.joints_m - solution.views[0].centre_m[:, None]))


def error_time_s(xyz_m: Array, fps: float) -> float:
    """Return the geometric mean of the correlation times of the detections' errors and of the pose, s.

    The correlation time of the pose is computed from the joints (T, J, 3) relative to their mean, as the root mean
    square distance from their average position divided by the root mean square speed. This time is at most the
    correlation time of the detections' errors.
    """
    from_mean_m = xyz_m - xyz_m.mean(axis=1, keepdims=True)
    speed_m_s = fps * np.diff(from_mean_m, axis=0)
    if not np.isfinite(speed_m_s).any():
        return constants.ERROR_TIME_S
    deviation_m = from_mean_m - np.nanmean(from_mean_m, axis=0)
    changes_s = np.sqrt(np.nanmean(deviation_m**2) / max(np.nanmean(speed_m_s**2), 1e-12))
    return float(np.sqrt(constants.ERROR_TIME_S * min(changes_s, constants.ERROR_TIME_S)))


def _with_sigma(
    fields: dict[str, tuple[phase.LinkField, ...]],
    motion: Motion,
    chains: Mapping[str, tuple[str, ...]],
    angles: Sequence[AngleKinematics],
) -> dict[str, tuple[phase.LinkField, ...]]:
    """Return the vector fields with standard deviations propagated from independent errors of the angles' rates."""
    rate_sigma = np.stack([angle.series.rate_sigma[:: angle.series.oversampling, 0] for angle in angles], axis=1)
    names, moved = motion.names, {limb: list[Array]() for limb in chains}
    rear, front = (names.index(joint) for joint in motion.forward_names)
    for first in range(0, len(rate_sigma), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        pose = motion.body.tree.pose_with_jacobian(motion.states[rows], motion.size)
        points_m, moved_m_s = pose.points_m, pose.jacobian[..., PITCH:] * rate_sigma[rows, None, None]
        forward_m, forward_moved_m_s = points_m[:, front] - points_m[:, rear], moved_m_s[:, front] - moved_m_s[:, rear]
        for limb, chain in chains.items():
            along = [names.index(joint) for joint in chain]
            of_joints = points_m[:, along], forward_m, moved_m_s[:, along], forward_moved_m_s
            moved[limb].append(phase.tip_changes(*of_joints))
    return {
        limb: tuple(
            phase.field_with_sigma(field, np.concatenate([part[:, i] for part in moved[limb]]))
            for i, field in enumerate(of_limb)
        )
        for limb, of_limb in fields.items()
    }


def _seen(motion: Motion, pose: Pose3D) -> Pose3D:
    """Return the pose without the feet that are not seen for more than `UNSEEN_S`.

    A foot is NaN in these frames. A foot counts as seen if it or the joint above it was detected.
    """
    xyz_m = pose.xyz_m.copy()
    for joint in motion.foot_names.values():
        foot = motion.names.index(joint)
        limb = next(limb for limb in motion.limbs.values() if foot in limb)
        end = [*limb[max(limb.index(foot) - 1, 0) : limb.index(foot) + 1]]
        is_seen = np.any([picture.present[:, end].any(axis=1) for picture in motion.pictures], axis=0)
        for first, stop in frame_ranges(np.flatnonzero(~is_seen)):
            if stop - first > UNSEEN_S * motion.fps:
                xyz_m[first:stop, pose.names.index(joint)] = np.nan
    return replace(pose, xyz_m=xyz_m)
