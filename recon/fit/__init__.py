"""Views of a clip -> an animal's motion over the whole clip.

This room is the only place that solves for an animal's motion, besides the frame method of `recon.thesis`.
`recon.fit.constants` has the numbers that no user sets.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
    from recon.fit.extrinsics import solve_extrinsics
    from recon.fit.least_squares import Estimate, LeastSquares, SharedUnknown
    from recon.fit.motion import MEASURED_SHARE, Motion, Picture
    from recon.fit.motion_forms import MOTION
    from recon.fit.points import solve_points
    from recon.fit.posterior import DEGREES_OF_FREEDOM, prior_misfit_of, radius, sigmas
    from recon.fit.result import ExpectedError, Finding, Ground, MotionSegment, Solution, TrajectorySolution, Verdict
    from recon.fit.sampling import draws
    from recon.fit.shape import Shape, ShapeFit, fit_shape
    from recon.fit.starts import APPROACH_HZ, constant_velocity, interpolate_states, position_on_rays
    from recon.fit.terms import REFERENCE_HZ, StanceVelocity
    from recon.fit.trajectory import ALTERNATIVE_M, solve_trajectory

__getattr__ = lazily(__name__, __file__)
