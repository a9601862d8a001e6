"""Inverse kinematics of serial chains at the rate level: chains, methods, driving and following, fits (docs/ik.md)."""

from recon.robotics.ik.animal import body_chain, body_chain_angles, chain_angles, projected_chain, spine_front_leg
from recon.robotics.ik.chain import SerialChain, joint_chain, planar_chain, summed_chain
from recon.robotics.ik.costs import (
    harmonic_map,
    joint_differences,
    pose_distance,
    rotational_energy,
    user_cost,
    weighted_sum,
)
from recon.robotics.ik.drive import Drive, Follow, drive_to, follow
from recon.robotics.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Scaled,
    SelectivelyDamped,
    damped_least_squares,
    weighted_least_norm,
)
from recon.robotics.ik.null_space import to_null_space_optimum
from recon.robotics.ik.stride import StridePath, farthest_reach, find_stride
from recon.robotics.ik.two_link import two_link

__all__ = [
    "Drive",
    "ExtendedJacobian",
    "Follow",
    "GradientProjection",
    "JacobianTranspose",
    "LeastNorm",
    "Scaled",
    "SelectivelyDamped",
    "SerialChain",
    "StridePath",
    "body_chain",
    "body_chain_angles",
    "chain_angles",
    "damped_least_squares",
    "drive_to",
    "farthest_reach",
    "find_stride",
    "follow",
    "harmonic_map",
    "joint_chain",
    "joint_differences",
    "planar_chain",
    "pose_distance",
    "projected_chain",
    "rotational_energy",
    "spine_front_leg",
    "summed_chain",
    "to_null_space_optimum",
    "two_link",
    "user_cost",
    "weighted_least_norm",
    "weighted_sum",
]
