"""Views of a clip -> an animal's motion over the whole clip.

The only place that solves for an animal's motion, besides the wings' own methods.
"""

from recon.fit import constants
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.points import solve_points
from recon.fit.result import Ground, MotionSegment, Solution, Start, TrajectorySolution
from recon.fit.trajectory import solve_trajectory

__all__ = [
    "Ground",
    "MotionSegment",
    "Solution",
    "Start",
    "TrajectoryOptions",
    "TrajectorySolution",
    "constants",
    "solve_points",
    "solve_trajectory",
]
