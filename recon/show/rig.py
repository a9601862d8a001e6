"""Convert a fit to bones that rotate relative to each other (`recon.io.bones`), for export to other programs.

Each segment of the skeleton is a bone with the segment's name, or with `_bone` added if a joint has that name.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.animal.body import Body
from recon.animal.capsules import capsules, inertias_m2, middles_m
from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem
from recon.fit.motion import Motion
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES, ROOT
from recon.io.bones import Armature, Bone, BoneAngle
from recon.io.common import Pose3D, require_span
from recon.io.writing import frames_text, y_up_from_z_up

RANGE_SIGMAS = 3.0
SAME_M = 1e-4
"""Largest difference between joint positions in metres at which lengths count as constant."""


def rig_of(motion: Motion, fps: float | None = None, body_mass_kg: float = 1.0) -> Armature:
    """Return the rig of a motion, from the first to the last frame with a pose.

    Frames without a pose in between are interpolated, and a note lists them.

    Parameters
    ----------
    motion : Motion
        The fit.
    fps : float, optional
        Frame rate in Hz. The default is the motion's frame rate.
    body_mass_kg : float
        Mass of the animal in kg, which is divided among the segments in the skeleton's proportions.

    Raises
    ------
    InputError
        If no frame has a pose, or if lengths change from frame to frame.
    """
    frames, states, joints_m = motion.frames, motion.states, motion.upright.xyz_m
    difference_m = np.abs(motion.body.tree.pose(states, motion.size).points_m - joints_m).max(axis=(1, 2))
    is_known = np.isfinite(difference_m)
    if not is_known.any():
        raise InputError(Problem(motion.file, "frames", "no frame with a pose", "at least one frame with a pose"))
    if difference_m[is_known].max() > SAME_M:
        expected = "bones of constant length: fit with --set method=trajectory"
        raise InputError(Problem(motion.file, "size", "lengths that change from frame to frame", expected))
    animal, fps = (motion.body, motion.size, motion.names), motion.fps if fps is None else fps
    rig = make_rig(*animal, frames[is_known], states[is_known], fps, body_mass_kg)
    filled = np.setdiff1d(rig.pose.frames, frames[is_known])
    note = f"Without a pose, and interpolated: frames {', '.join(frames_text(filled))}."
    return replace(rig, notes=(note,) if len(filled) else ())


def make_rig(
    body: Body, size: float, names: tuple[str, ...], frames: Index, states: Array, fps: float, body_mass_kg: float = 1.0
) -> Armature:
    """Return the rig of states (N, D) in frames (N,), with interpolated states in the frames between these.

    `names` (J,) are the names of the joints.
    """
    tree = body.tree.scaled(size)
    frames, states = _without_gaps(frames, states)
    index = {segment.name: i for i, segment in enumerate(tree.segments)}
    shape = capsules(tree, names)
    fraction = np.array([body.mass.get(segment.name, (0.0, 0.0))[0] for segment in tree.segments])
    mass_kg = body_mass_kg * fraction / max(float(fraction.sum()), 1e-9)
    inertia = y_up_from_z_up(np.swapaxes(y_up_from_z_up(inertias_m2(tree, shape)), 1, 2))
    middles = y_up_from_z_up(middles_m(tree, shape))
    bones = tuple(
        Bone(
            f"{segment.name}_bone" if segment.name in names else segment.name,
            None if segment.parent is None else index[segment.parent],
            y_up_from_z_up(np.array(segment.offset_m)),
            turns_of_segment,
            float(mass_kg[i]),
            middles[i],
            mass_kg[i] * inertia[i],
        )
        for i, (segment, turns_of_segment) in enumerate(zip(tree.segments, _turns(body, states), strict=True))
    )
    return Armature(
        name=body.name,
        title=body.title,
        bones=bones,
        joints=names,
        joint_bones=tuple(index[marker.segment] for marker in tree.markers),
        joint_offsets_m=y_up_from_z_up(np.array([marker.offset_m for marker in tree.markers])),
        capsules=shape,
        root_m=y_up_from_z_up(states[:, ROOT]),
        pose=Pose3D(names, tree.pose(states).points_m, frames, fps=fps),
        fps=fps,
        notes=(),
    )


def _without_gaps(frames: Index, states: Array) -> tuple[Index, Array]:
    """Return all frame numbers from the first to the last, and states (T, D) for all of them."""
    require_span(int(frames[-1] - frames[0]) + 1, states.shape[1], "bones")
    all_frames = np.arange(frames[0], frames[-1] + 1)
    states = np.column_stack([states[:, ROOT], np.unwrap(states[:, 3:], axis=0)])
    return all_frames, np.column_stack([np.interp(all_frames, frames, column) for column in states.T])


def _turns(body: Body, states: Array) -> list[tuple[BoneAngle, ...]]:
    """Return the rotation of each segment relative to its parent for states (T, D).

    The angles of a summed joint are relative to the root. The rotation relative to its parent is then decomposed into
    pitch, yaw and roll, in this order.
    """
    tree, turns = body.tree, []
    column = 3
    expected = [(0.0, np.pi / RANGE_SIGMAS), *zip(body.mean_rad.tolist(), body.sigma_rad.tolist(), strict=True)]
    orientations = tree.orientations(states)
    index = {segment.name: i for i, segment in enumerate(tree.segments)}
    for segment in tree.segments:
        kinds = [ANGLE_OF_AXIS[axis] for axis in AXES[segment.joint]]
        columns = range(column, column + len(kinds))
        column += len(kinds)
        angles, means = [states[:, c] for c in columns], [expected[c - 3] for c in columns]
        if segment.joint == "summed" and segment.parent is not None:
            parent_orientation = orientations[:, index[segment.parent]]
            angles = _pitch_yaw_roll(parent_orientation.swapaxes(1, 2) @ orientations[:, index[segment.name]])
            kinds, means = ["pitch", "yaw", "roll"], [means[1], means[0], (0.0, np.pi / RANGE_SIGMAS)]
        bone_angles = [
            BoneAngle(
                f"{segment.name}_{kind}", kind, angle_rad, mean, (mean - RANGE_SIGMAS * sd, mean + RANGE_SIGMAS * sd)
            )
            for kind, angle_rad, (mean, sd) in zip(kinds, angles, means, strict=True)
        ]
        turns.append(tuple(bone_angles))
    return turns


def _pitch_yaw_roll(R: Array) -> list[Array]:
    """Return the angles (T,) of rotations (T, 3, 3) = Ry(pitch) Rz(yaw) Rx(roll), without jumps."""
    pitch, yaw = np.arctan2(-R[:, 2, 0], R[:, 0, 0]), np.arcsin(np.clip(R[:, 1, 0], -1.0, 1.0))
    return [np.unwrap(pitch), yaw, np.unwrap(np.arctan2(-R[:, 1, 2], R[:, 1, 1]))]
