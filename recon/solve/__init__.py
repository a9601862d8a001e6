"""Views of a clip -> an animal's motion over the whole clip.

The only place that solves for an animal's motion, besides the reference method (`recon.published`).
"""

from recon.solve.points import solve_points
from recon.solve.result import Ground, Solution, Spell, Start, TrajectorySolution
from recon.solve.setting import TrajectoryOptions
from recon.solve.trajectory import solve_trajectory

__all__ = [
    "Ground",
    "Solution",
    "Spell",
    "Start",
    "TrajectoryOptions",
    "TrajectorySolution",
    "solve_points",
    "solve_trajectory",
]
