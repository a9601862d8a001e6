"""Robotics: inverse kinematics of an animal's chains, legs and robots, retargeting, climbing.

A wing: it imports rooms only, and no room imports it.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.robotics.climb.run import run_climb
    from recon.robotics.ik.clip import limb_of, methods_of, run_ik
    from recon.robotics.robot.retarget_clip import run_retarget
    from recon.robotics.robot.robot_file import load_robot
    from recon.robotics.settings import ClimbSettings, IkSettings, RetargetSettings

__getattr__ = lazily(__name__, __file__)
