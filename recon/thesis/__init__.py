"""The reference method: the published problem of 21 unknowns, solved one frame after the other.

C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng), University of Cape
Town, 2022. The chain and its states as published stand in `recon.animal.chain`; objectives: the terms f1 to f5 and the
priors that they need besides, one small class each; starts: where the first frame starts; frame: the solver.
"""

from recon.thesis.frame import (
    FrameOptions,
    FrameReport,
    FrameSolution,
    base_length,
    frame_objectives,
    frame_rows,
    solve_frames,
    solve_joints,
)

__all__ = [
    "FrameOptions",
    "FrameReport",
    "FrameSolution",
    "base_length",
    "frame_objectives",
    "frame_rows",
    "solve_frames",
    "solve_joints",
]
