"""Names of version 0.2 and of its files: they are in `chain`, `objectives`, `solver`, `solution` and `start` now."""

from recon.thesis.chain import mean_pose
from recon.thesis.objectives import (
    AngleRange,
    DirectionPrior,
    FrameOptions,
    GaussianPrior,
    JointReprojection,
    Objective,
    RateLimit,
    ResidualAndJacobian,
    base_length,
    frame_objectives,
)
from recon.thesis.solution import FrameSolution, in_world
from recon.thesis.solver import (
    CONVERGED,
    FrameProblem,
    FrameSearch,
    FrameSolver,
    posterior_covariance,
    precision_shares,
    solve_frames,
)
from recon.thesis.start import Travel, estimate_travel, geometric_start

__all__ = [
    "CONVERGED",
    "AngleRange",
    "DirectionPrior",
    "FrameOptions",
    "FrameProblem",
    "FrameSearch",
    "FrameSolution",
    "FrameSolver",
    "GaussianPrior",
    "JointReprojection",
    "Objective",
    "RateLimit",
    "ResidualAndJacobian",
    "Travel",
    "base_length",
    "estimate_travel",
    "frame_objectives",
    "geometric_start",
    "in_world",
    "mean_pose",
    "posterior_covariance",
    "precision_shares",
    "solve_frames",
]
