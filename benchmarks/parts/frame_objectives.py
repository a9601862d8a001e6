"""Measure the effect of each objective of the frame method on real runs, with fits that use only some of them.

    python benchmarks/parts/frame_objectives.py [FOLDER] [--only CASE ...]

The fits use the named camera of every run of FOLDER, by default the cheetah-runs of $RECON_SHARED_DATA. An objective
that is left out has a weight of a millionth, so that there are never fewer residuals than unknowns. The columns are the
mean reprojection error of the best 90 % (median of the runs), the MPJPE (mean, smallest and largest of the runs), the
fraction of the squared residuals that comes from f2 to f5 (mean), and the jitter of the thetas from frame to frame,
degrees (median). The script takes a quarter of an hour.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from arguments import parser_of, runs_or_exit
from cheetah_runs import PUBLISHED, best_90_px
from markdown_table import print_header, print_row
from recordings import fit_settings, meta_of

from recon import Pose3D, evaluate, fit_clip, read_pose3d
from recon.gait.series import frame_jitter_m
from recon.thesis import solver as frame
from recon.thesis.objectives import FrameOptions, Objective, ResidualAndJacobian, frame_objectives
from recon.thesis.solution import FrameSolution

LIMITS = ("theta range", "phi range", "theta rate", "phi rate")
"""Names of the objectives f2, f3, f4 and f5, which limit angles and rates."""
PRIORS = ("theta prior", "phi prior", "roll prior", "heading tie", "travel prior")
SIZE = ("base length prior",)
EVERY = (*LIMITS, *SIZE, *PRIORS)
FREE = {"path": "free"}
CASES: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "f1 alone": ((), FREE),
    **{f"f1 and f{2 + k}": ((name,), FREE) for k, name in enumerate(LIMITS)},
    "f1 to f5": (LIMITS, FREE),
    "f1 to f5, as printed": (LIMITS, FREE | {"form": "printed", "reprojection": "printed"}),
    "f1 to f5, rotation fixed": (LIMITS, FREE | {"camera_rotation": "fixed"}),
    "f1, base length": (SIZE, FREE),
    "f1 to f5, base length": ((*LIMITS, *SIZE), FREE),
    "f1, base length, priors": ((*SIZE, *PRIORS), FREE),
    "all but the path tie": (EVERY, FREE),
    "the same, rotation fixed": (EVERY, FREE | {"camera_rotation": "fixed"}),
    "the same, f2 to f5 as printed": (EVERY, FREE | {"form": "printed"}),
    "the same, f1 as printed": (EVERY, FREE | {"reprojection": "printed"}),
    "the same, f1 to f5 as printed": (EVERY, FREE | {"form": "printed", "reprojection": "printed"}),
    "all, the default": (EVERY, {}),
}
"""Objectives that each case keeps, and its settings.

Only the last case ties frames by a path. In the other cases each frame is solved separately, as published. "As printed"
means f4 and f5 with the missing da/dt and the square of the limit corrected.
"""
FADED = 1e-6
TOLERANCE = 1e-5
"""Tolerance of every search, as loose as for second solutions because searches without priors converge slowly."""


class Faded:
    """Objective with a negligible weight."""

    def __init__(self, term: Objective) -> None:
        self.name, self.ties, self.term = term.name, term.ties, term

    def evaluate(self, *given) -> ResidualAndJacobian:
        residual, jacobian = self.term.evaluate(*given)
        return FADED * residual, FADED * jacobian


def measured(run: Path, kept: tuple[str, ...], options: dict[str, Any]) -> tuple[float, float, float, float]:
    """Fit the named view of a run with some of the objectives, and return the errors.

    Returns
    -------
    tuple
        Mean reprojection error of the best 90 %, px; MPJPE, mm; fraction of the squared residuals that comes from f2 to
        f5; and jitter of the thetas, degrees.
    """
    every = frame_objectives
    settings = fit_settings(run, [meta_of(run)["monocular_camera"]], method="frame", skeleton=PUBLISHED, **options)

    def some(*given) -> tuple[Any, ...]:
        first, *others = every(*given)
        return (first, *(term if term.name in kept else Faded(term) for term in others))

    def loose(frame_options: FrameOptions, least: float = TOLERANCE) -> FrameOptions:
        return replace(frame_options, tolerance=max(frame_options.tolerance, least))

    patches = {"frame_objectives": some, "with_tolerance": loose}
    with mock.patch.multiple(frame, **patches):
        motion = fit_clip(settings)
    solution = motion.solution
    assert isinstance(solution, FrameSolution)
    score = evaluate(Pose3D(motion.names, motion.joints_m, motion.frames), read_pose3d(run / "truth.csv"))
    shares = [sum(r.cost_shares.get(name, 0.0) for name in LIMITS) for r in solution.reports if r is not None]
    thetas = np.unwrap(solution.chain_states[motion.solved][:, solution.chain.theta_slice], axis=0)
    jitter = float(np.degrees(np.median(frame_jitter_m(thetas))))
    return best_90_px(motion), 1000 * score.mpjpe_m.mean, float(np.mean(shares)), jitter


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs", only=[*CASES])
    arguments = parser.parse_args()
    runs = runs_or_exit(parser, arguments.folder)
    print_header(["objectives", "pixels", "MPJPE, mm (by run)", "share", "jitter"])
    for name in arguments.only:
        kept, options = CASES[name]
        pixels, mpjpe, fraction, jitter = np.array([measured(run, kept, options) for run in runs]).T
        error = f"{mpjpe.mean():.0f} ({mpjpe.min():.0f} to {mpjpe.max():.0f})"
        is_limited = bool({*kept} & {*LIMITS})
        weighed = f"{100 * fraction.mean():.{0 if fraction.mean() > 0.01 else 1}f} %" if is_limited else ""
        print_row([name, f"{np.median(pixels):.1f}", error, weighed, f"{np.median(jitter):.1f}"])


if __name__ == "__main__":
    main()
