"""The published system: 21 unknowns of the 8U chain, solved one frame after the other.

C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng), University of Cape
Town, 2022. chain: the 8U chain and its unknowns; objectives: f1 to f5 and the priors; start: direction of travel and
first pose; solver: Levenberg-Marquardt; solution: its result; inspect and figures: what the optimiser did; report: the
sections of report.json and summary; clip: the commands `recon frame` and `recon solver`.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.thesis.clip import fit_clip, load_body
    from recon.thesis.inspect import SolverRecord, read_solver
    from recon.thesis.objectives import FrameOptions
    from recon.thesis.solution import FrameSolution
    from recon.thesis.solver import FrameProblem, FrameSolver, solve_frames

__getattr__ = lazily(__name__, __file__)
