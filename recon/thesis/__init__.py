"""The reference method: the published problem of 21 unknowns, solved one frame after the other.

C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng), University of Cape
Town, 2022. The chain and its states as published stand in `recon.animal.chain`; frame: the terms f1 to f5 and the
priors that they need besides, one small class each, the solver, and where it starts; clip: what `recon frame` runs and
what is said of its result; solver: what the optimiser did, which `recon solver` shows.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.thesis.clip import fit_clip, load_body
    from recon.thesis.frame import FrameOptions, FrameProblem, FrameSolution, FrameSolver, solve_frames
    from recon.thesis.solver import SolverRecord, read_solver

__getattr__ = lazily(__name__, __file__)
