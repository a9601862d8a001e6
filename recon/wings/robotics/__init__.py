"""Robotics: inverse kinematics of an animal's chains, legs and robots, retargeting, climbing.

A wing: it imports rooms only, and no room imports it. Here is what runs the commands; chains, methods and legs are in
`ik` and `robot` (docs/ik.md, docs/robot.md).
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.wings.robotics.climb import load_recipe
    from recon.wings.robotics.ik.clip import IkSettings, limb_of, methods_of, run_ik
    from recon.wings.robotics.robot.physics import simulated
    from recon.wings.robotics.robot.quadruped import LEGS, Quadruped, builtin_robots, load_robot
    from recon.wings.robotics.robot.retarget import Retargeting, reference_of, retarget
    from recon.wings.robotics.robot.retarget_clip import RetargetSettings, run_retarget

__getattr__ = lazily(__name__, __file__)
