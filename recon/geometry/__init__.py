"""Rotations, frames of reference, cameras with their lenses, and kinematic trees."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.geometry.camera import Camera
    from recon.geometry.frames import (
        euler_rotation,
        euler_rotation_with_jacobian,
        inverse,
        level_from_camera,
        moved,
        rigid,
    )
    from recon.geometry.kinematics import PITCH, ROLL, ROOT, YAW, Joint, Marker, Segment, Tree, TreePose
    from recon.geometry.lens import LENS_MODELS

__getattr__ = lazily(__name__, __file__)
