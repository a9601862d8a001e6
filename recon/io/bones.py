"""An animal as bones that turn against each other, for programs that know bones rather than points: plain data.

Axes are x forwards, y up, z right, as OpenSim, glTF and BVH have them. With all angles 0 every bone's axes are those of
the world. Angles keep their names and signs: yaw turns about y, pitch about -z and roll about x.
`recon.show.export.rig` makes an armature of a fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal.capsules import Capsule
from recon.base.arrays import Array
from recon.io.pose import Pose3D

AXIS: dict[str, tuple[int, int, int]] = {"yaw": (0, 1, 0), "pitch": (0, 0, -1), "roll": (1, 0, 0)}
"""What each kind of angle turns about."""


@dataclass(frozen=True, eq=False)
class BoneAngle:
    """One angle of a bone against its parent, (T,), about an axis that the bone's angles before it have turned."""

    name: str
    kind: str
    """Which angle it is: yaw, pitch or roll."""
    angle_rad: Array
    mean_rad: float
    range_rad: tuple[float, float]
    """What the skeleton expects: three standard deviations about the mean, or, where it says nothing, any angle."""


@dataclass(frozen=True, eq=False)
class Bone:
    """A segment. parent: None of the root, which follows a path."""

    name: str
    parent: int | None
    offset_m: Array
    """(3,): its origin in its parent's frame."""
    turns: tuple[BoneAngle, ...]
    mass_kg: float
    """0 where the skeleton has no masses."""
    centre_m: Array
    """(3,): of its mass, in its frame."""
    inertia_kg_m2: Array
    """(3, 3): about that centre."""


@dataclass(frozen=True, eq=False)
class Armature:
    """Bones, each after its parent, and J joints fixed on them, in T frames that follow one another without a gap."""

    name: str
    title: str
    bones: tuple[Bone, ...]
    joints: tuple[str, ...]
    """As their keypoints are called."""
    joint_bones: tuple[int, ...]
    joint_offsets_m: Array
    """(J, 3): in their bones' frames."""
    capsules: tuple[Capsule, ...]
    """The capsules of the bones, in the segments' frames, where z is up."""
    root_m: Array
    """(T, 3): the origin of the first bone."""
    pose: Pose3D
    """The joints in these frames, z up."""
    fps: float
    notes: tuple[str, ...]


def turned(turns: tuple[BoneAngle, ...], count: int) -> Array:
    """(count, 3, 3): rotations from a bone's frame to its parent's, in each frame."""
    R = Rotation.identity(count)
    for turn in turns:
        R = R * Rotation.from_rotvec(np.outer(turn.angle_rad, AXIS[turn.kind]))
    return R.as_matrix()
