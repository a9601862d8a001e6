"""Robotics: inverse kinematics of an animal's chains, legs and robots, retargeting, climbing.

A wing: it imports rooms only, and no room imports it.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.wings.robotics.climb import load_recipe
    from recon.wings.robotics.climb.run import run_climb
    from recon.wings.robotics.ik.animal import (
        body_chain,
        body_chain_angles,
        chain_angles,
        farthest_reach,
        find_stride,
        projected_chain,
        spine_front_leg,
    )
    from recon.wings.robotics.ik.chain import null_basis, planar_chain, summed_chain
    from recon.wings.robotics.ik.clip import limb_of, methods_of, run_ik
    from recon.wings.robotics.ik.drive import degree_of_closure, drive_to, follow, to_null_space_optimum
    from recon.wings.robotics.ik.methods import (
        ExtendedJacobian,
        GradientProjection,
        JacobianTranspose,
        LeastNorm,
        SelectivelyDamped,
        damped_least_squares,
        harmonic_map,
        joint_differences,
        pose_distance,
        rotational_energy,
        user_cost,
        weighted_least_norm,
        weighted_sum,
    )
    from recon.wings.robotics.robot.dh import all_solutions
    from recon.wings.robotics.robot.physics import described, simulated
    from recon.wings.robotics.robot.quadruped import LEGS, Quadruped, body_pose, feet_in_world
    from recon.wings.robotics.robot.reference import reference_of
    from recon.wings.robotics.robot.retarget import Retargeting, retarget
    from recon.wings.robotics.robot.retarget_clip import run_retarget
    from recon.wings.robotics.robot.robot_file import builtin_robots, load_robot, read_model
    from recon.wings.robotics.settings import ClimbSettings, IkSettings, RetargetSettings

__getattr__ = lazily(__name__, __file__)
