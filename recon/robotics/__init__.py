"""Robots: their legs, retargeting of an animal's motion, physics, climbing (docs/robot.md, docs/climb.md)."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.robotics.climb import load_recipe
    from recon.robotics.physics import simulated
    from recon.robotics.quadruped import LEGS, Quadruped, builtin_robots, load_robot
    from recon.robotics.retarget import Retargeting, reference_of, retarget
    from recon.robotics.retarget_clip import RetargetSettings, run_retarget

__getattr__ = lazily(__name__, __file__)
