"""What an animal's motion says: kinematics, stances, strides, phase portraits, and comparison with a truth."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.gait.clip import ClipAnalysis, limb_chains
    from recon.gait.dynamics import FORCE_COLUMNS, G_M_S2, OVER_STRIDE, Dynamics, over_stride
    from recon.gait.evaluation import LEVELS
    from recon.gait.gait import INTERVAL, Gait, Stance, pose_gait
    from recon.gait.kinematics import Errors, angle_kinematics, joint_kinematics, point_kinematics
    from recon.gait.phase import Closure, LinkField, Portrait, field_means, phase_portrait, vector_field

__getattr__ = lazily(__name__, __file__)
