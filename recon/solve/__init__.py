"""Objectives -> states: the only place that calls an optimiser.

frame: one frame of a chain after the other. trajectory: a whole animal over a whole clip.
"""

from recon.solve.frame import (
    CONVERGED,
    FrameOptions,
    FrameReport,
    Solution,
    base_length,
    evaluate,
    posterior_covariance,
    precision_shares,
    solve_frames,
    solve_joints,
)
from recon.solve.points import solve_points
from recon.solve.result import Ground, Spell, Start, TrajectorySolution
from recon.solve.setting import TrajectoryOptions
from recon.solve.trajectory import solve_trajectory

__all__ = [
    "CONVERGED",
    "FrameOptions",
    "FrameReport",
    "Ground",
    "Solution",
    "Spell",
    "Start",
    "TrajectoryOptions",
    "TrajectorySolution",
    "base_length",
    "evaluate",
    "posterior_covariance",
    "precision_shares",
    "solve_frames",
    "solve_joints",
    "solve_points",
    "solve_trajectory",
]
