"""Inverse kinematics of serial chains at the rate level: chains, methods, driving and following, fits (docs/ik.md)."""

from recon.robotics.ik.animal import body_chain, body_chain_angles, chain_angles, planar_chain, spine_front_leg
from recon.robotics.ik.chain import PlanarChain, SerialChain, SummedChain
from recon.robotics.ik.costs import (
    HarmonicMap,
    UserCost,
    WeightedSum,
    joint_differences,
    pose_distance,
    rotational_energy,
)
from recon.robotics.ik.drive import Drive, Follow, drive_to, follow
from recon.robotics.ik.joint_chain import JointChain
from recon.robotics.ik.methods import (
    DampedLeastSquares,
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Scaled,
    SelectivelyDamped,
    WeightedLeastNorm,
)
from recon.robotics.ik.null_space import to_null_space_optimum
from recon.robotics.ik.stride import Stride, farthest_reach, find_stride
from recon.robotics.ik.two_link import two_link

__all__ = [
    "DampedLeastSquares",
    "Drive",
    "ExtendedJacobian",
    "Follow",
    "GradientProjection",
    "HarmonicMap",
    "JacobianTranspose",
    "JointChain",
    "LeastNorm",
    "PlanarChain",
    "Scaled",
    "SelectivelyDamped",
    "SerialChain",
    "Stride",
    "SummedChain",
    "UserCost",
    "WeightedLeastNorm",
    "WeightedSum",
    "body_chain",
    "body_chain_angles",
    "chain_angles",
    "drive_to",
    "farthest_reach",
    "find_stride",
    "follow",
    "joint_differences",
    "planar_chain",
    "pose_distance",
    "rotational_energy",
    "spine_front_leg",
    "to_null_space_optimum",
    "two_link",
]
