"""Rotations, frames of reference, cameras with their lenses, and kinematic trees."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.geometry.camera import Camera, is_rotation
    from recon.geometry.frames import (
        euler_rotation,
        euler_rotation_with_jacobian,
        inverse,
        level_axes,
        level_from_camera,
        moved,
        rigid,
    )
    from recon.geometry.kinematics import (
        ANGLE_OF_AXIS,
        AXES,
        PITCH,
        ROLL,
        ROOT,
        YAW,
        Joint,
        Marker,
        Segment,
        Tree,
        TreePose,
    )
    from recon.geometry.lens import LENS_MODELS, Lens, lens_named
    from recon.geometry.rotations import euler_angles, part_of_turn, quaternion_rotations, quaternions

__getattr__ = lazily(__name__, __file__)
