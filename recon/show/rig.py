"""A fit as bones that turn against each other (`recon.io.bones`), for programs that know bones rather than points.

There is a bone for each segment of the skeleton, under its name, or with `_bone` behind it where a joint is called so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.animal.body import Body
from recon.animal.capsules import capsules, inertias_m2, middles_m
from recon.base import Array, Index, InputError, Problem
from recon.fit.motion import Motion
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES, ROOT
from recon.io import Armature, Bone, BoneAngle, Pose3D, frames_text, require_span, y_up_from_z_up

RANGE_SIGMAS = 3.0
SAME_M = 1e-4
"""Lengths by which joints are further off than this are others."""


def rig_of(motion: Motion, fps: float | None = None, body_mass_kg: float = 1.0) -> Armature:
    """From the first to the last frame with a pose; those without one in between are interpolated, which a note says.

    fps: in place of the motion's; body_mass_kg: which the skeleton's masses add up to. Raises InputError without any
    pose, and where lengths change from frame to frame.
    """
    frames, states, joints_m = motion.frames, motion.states, motion.upright.xyz_m
    off_m = np.abs(motion.body.tree.pose(states, motion.size).points_m - joints_m).max(axis=(1, 2))
    known = np.isfinite(off_m)
    if not known.any():
        raise InputError(Problem(motion.file, "frames", "none with a pose", "at least one"))
    if off_m[known].max() > SAME_M:
        expected = "bones of one length: fit with --set method=trajectory"
        raise InputError(Problem(motion.file, "size", "lengths that change from frame to frame", expected))
    of_animal, fps = (motion.body, motion.size, motion.names), motion.fps if fps is None else fps
    rig = make_rig(*of_animal, frames[known], states[known], fps, body_mass_kg)
    filled = np.setdiff1d(rig.pose.frames, frames[known])
    note = f"Without a pose, and interpolated: frames {', '.join(frames_text(filled))}."
    return replace(rig, notes=(note,) if len(filled) else ())


def make_rig(
    body: Body, size: float, names: tuple[str, ...], frames: Index, states: Array, fps: float, body_mass_kg: float = 1.0
) -> Armature:
    """The rig of states (N, D) in these frames (N,), and between them. names: of the J joints."""
    tree = body.tree.scaled(size)
    frames, states = _without_gaps(frames, states)
    at = {segment.name: i for i, segment in enumerate(tree.segments)}
    shape = capsules(tree, names)
    share = np.array([body.mass.get(segment.name, (0.0, 0.0))[0] for segment in tree.segments])
    mass_kg = body_mass_kg * share / max(float(share.sum()), 1e-9)
    inertia = y_up_from_z_up(np.swapaxes(y_up_from_z_up(inertias_m2(tree, shape)), 1, 2))
    middles = y_up_from_z_up(middles_m(tree, shape))
    bones = tuple(
        Bone(
            f"{segment.name}_bone" if segment.name in names else segment.name,
            None if segment.parent is None else at[segment.parent],
            y_up_from_z_up(np.array(segment.offset_m)),
            turns,
            float(mass_kg[i]),
            middles[i],
            mass_kg[i] * inertia[i],
        )
        for i, (segment, turns) in enumerate(zip(tree.segments, _turns(body, states), strict=True))
    )
    return Armature(
        name=body.name,
        title=body.title,
        bones=bones,
        joints=names,
        joint_bones=tuple(at[marker.segment] for marker in tree.markers),
        joint_offsets_m=y_up_from_z_up(np.array([marker.offset_m for marker in tree.markers])),
        capsules=shape,
        root_m=y_up_from_z_up(states[:, ROOT]),
        pose=Pose3D(names, tree.pose(states).points_m, frames, fps=fps),
        fps=fps,
        notes=(),
    )


def _without_gaps(frames: Index, states: Array) -> tuple[Index, Array]:
    """All frame numbers from the first to the last, and the states in between (T, D)."""
    require_span(int(frames[-1] - frames[0]) + 1, states.shape[1], "bones")
    all_frames = np.arange(frames[0], frames[-1] + 1)
    states = np.column_stack([states[:, ROOT], np.unwrap(states[:, 3:], axis=0)])
    return all_frames, np.column_stack([np.interp(all_frames, frames, column) for column in states.T])


def _turns(body: Body, states: Array) -> list[tuple[BoneAngle, ...]]:
    """The rotations of each segment, for states (T, D). A summed joint turns relative to the root: against its parent
    it turns as its angles say, but in the order pitch, yaw, and a roll that is left over."""
    tree, turns = body.tree, []
    column = 3
    expected = [(0.0, np.pi / RANGE_SIGMAS), *zip(body.mean_rad.tolist(), body.sigma_rad.tolist(), strict=True)]
    orientations = tree.orientations(states)
    at = {segment.name: i for i, segment in enumerate(tree.segments)}
    for segment in tree.segments:
        kinds = [ANGLE_OF_AXIS[axis] for axis in AXES[segment.joint]]
        columns = range(column, column + len(kinds))
        column += len(kinds)
        angles, means = [states[:, c] for c in columns], [expected[c - 3] for c in columns]
        if segment.joint == "summed" and segment.parent is not None:
            above = orientations[:, at[segment.parent]]
            angles = _pitch_yaw_roll(above.swapaxes(1, 2) @ orientations[:, at[segment.name]])
            kinds, means = ["pitch", "yaw", "roll"], [means[1], means[0], (0.0, np.pi / RANGE_SIGMAS)]
        of = [
            BoneAngle(f"{segment.name}_{kind}", kind, a, mean, (mean - RANGE_SIGMAS * sd, mean + RANGE_SIGMAS * sd))
            for kind, a, (mean, sd) in zip(kinds, angles, means, strict=True)
        ]
        turns.append(tuple(of))
    return turns


def _pitch_yaw_roll(R: Array) -> list[Array]:
    """Angles (T,) of rotations (T, 3, 3) = Ry(pitch) Rz(yaw) Rx(roll), without jumps."""
    pitch, yaw = np.arctan2(-R[:, 2, 0], R[:, 0, 0]), np.arcsin(np.clip(R[:, 1, 0], -1.0, 1.0))
    return [np.unwrap(pitch), yaw, np.unwrap(np.arctan2(-R[:, 1, 2], R[:, 1, 1]))]
