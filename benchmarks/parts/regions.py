"""Measure the tails of errors relative to the stated covariances, and the coverage that correct regions would have.

    python benchmarks/parts/regions.py [FOLDER]

All views of the runs in `cameras.py` are fitted, each alone, with known lengths and the keypoint bias measured in the
other runs. The degrees of freedom of Student's t are fitted by maximum likelihood, in which the mean over the joints of
a view counts as one error of the pose and one error of the position. Each run is tested with the degrees of freedom of
the other runs. Then errors are drawn from the stated covariances, for whole clips with all correlations between their
frames, and with one scale per clip. The drawn errors show the coverage of the worst view and the size of the errors
that correct covariances would give. Finally, positions are corrected for the expected bias of the joint minimum
(`simulated_coverage.py`).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cameras import PRIOR, Run, as_seen, cameras_of, runs_given, solved
from markdown_table import print_table
from scipy.linalg.lapack import dtbtrs
from scipy.special import gammaln
from simulated_coverage import mode_shift
from trajectory import body_of, prior_of

from recon.fit.banded import factored
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.regions import DEGREES_OF_FREEDOM, radius, sigmas
from recon.fit.segment import SegmentFit
from recon.fit.trajectory import solve_segments

NUMBERS = (2.5, 3, 3.5, 4, 4.5, 5, 5.5, 6, 6.5, 7, 7.5, 8, 9, 10, 12, 15, 20, 30, 50, 100, 1e6)
"""Degrees of freedom of Student's t to try; the last value is practically a Gaussian."""
KINDS, LEVELS = ("pose", "position"), (0.9, 0.5)
DRAWS = 400
WORST = 0.6
"""Coverage of the 90 % regions below which a view counts as badly covered."""


@dataclass(frozen=True)
class Fit:
    """Errors of a fit, over the joints whose true positions are known."""

    run: Run
    cameras: str
    off: dict[str, np.ndarray]
    """Errors of pose and position (`KINDS`) in stated standard deviations."""
    mm: dict[str, float]
    """Mean errors of pose and position (`KINDS`), mm."""
    named: bool
    """Whether the fit has only the camera that the run's meta.json names."""


def fits(runs: Sequence[Run]) -> list[Fit]:
    found = []
    for run in runs:
        body = as_seen(body_of(run.subject), run, runs, posed=True)
        sets = [("one", [c]) for c in run.views] + [(k, c) for k, c in cameras_of(run).items() if k != "one"]
        for label, cameras in sets:
            solution = solved(run, cameras, body)
            position = solution.joints_m - run.truth_m
            pose = position - position.mean(axis=1, keepdims=True)
            off = {
                "pose": sigmas(pose, solution.relative_covariance_m2),
                "position": sigmas(position, solution.covariance_m2),
            }
            known = {what: of[np.isfinite(of)] for what, of in off.items()}
            mm = {what: float(np.nanmean(_mm(e))) for what, e in (("pose", pose), ("position", position))}
            found.append(Fit(run, label, known, mm, cameras == [run.named]))
    return found


def _mm(error_m: np.ndarray) -> np.ndarray:
    """Return the lengths (...) of errors (..., 3), mm."""
    return 1000 * np.linalg.norm(error_m, axis=-1)


def likelihood(off: np.ndarray) -> np.ndarray:
    """Return the mean log density of 3D errors relative to a Gaussian, for each of `NUMBERS`."""
    nu, k = np.array(NUMBERS)[:, None], 3
    scale = gammaln((nu + k) / 2) - gammaln(nu / 2) - k / 2 * np.log(nu - 2)
    found = (scale - (nu + k) / 2 * np.log1p(off**2 / (nu - 2))).mean(axis=1)
    return found - found[-1]


def inside(some: Sequence[Fit], what: str, nu: float) -> str:
    """Format the fractions of errors inside the regions of each of `LEVELS`, for `nu` degrees of freedom.

    `what` is one of `KINDS`, the pose or the position.
    """
    return " ".join(f"{np.mean([np.mean(fit.off[what] < radius(p, 3, nu)) for fit in some]):.3f}" for p in LEVELS)


def print_tail_coverage(found: Sequence[Fit]) -> None:
    """Fit the degrees of freedom with each run left out, and print the coverage that they give on that run."""
    one = [fit for fit in found if fit.cameras == "one"]
    by_fit = {id(fit): {what: likelihood(off) for what, off in fit.off.items()} for fit in one}

    def most(some: Sequence[Fit], *kinds: str) -> int:
        return int(np.argmax(sum(by_fit[id(fit)][what] for fit in some for what in kinds)))

    rows = []
    for name in sorted({fit.run.folder.name for fit in one}):
        own, others = ([fit for fit in one if (fit.run.folder.name == name) is its] for its in (True, False))
        best = most(others, *KINDS)
        gained = sum(float(by_fit[id(fit)][what][best]) for fit in own for what in fit.off)
        shares = [inside(own, what, nu) for what in KINDS for nu in (1e6, NUMBERS[best])]
        rows.append([name, f"{NUMBERS[best]:g}", f"{gained:+.2f}", *shares])
    head = ["run left out", "degrees of freedom from the remaining runs", "log likelihood relative to a Gaussian"]
    print_table([*head, *(f"{what}, {of}" for what in KINDS for of in ("Gaussian", "t"))], rows)
    of_all = {what: f"{NUMBERS[most(one, what)]:g}" for what in KINDS}
    best = NUMBERS[most(one, *KINDS)]
    print(f"\nDegrees of freedom from all runs: {best:g}; pose {of_all['pose']}, position {of_all['position']}.\n")
    rows = []
    for label in ("one", "two", "all"):
        some = [fit for fit in found if fit.cameras == label]
        rows.append([label, *(inside(some, w, nu) for w in KINDS for nu in (1e6, DEGREES_OF_FREEDOM))])
    print("Fractions of errors inside the 90 % and 50 % regions of a Gaussian and a t distribution\n")
    print_table(["cameras", *(f"{what}, {of}" for what in KINDS for of in ("Gaussian", "t"))], rows)


def draw_errors(
    setting: ClipProblem, solved: SegmentFit, rng: np.random.Generator
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Draw the joints' errors from the stated covariances.

    For pose and position, the result has the errors (DRAWS, n) in standard deviations, and the mean errors (DRAWS,),
    mm.
    """
    problem, states = solved.problem, solved.estimate.states
    problem = replace(problem, shared=[*problem.shared, *problem.nuisance], nuisance=())
    normal, (T, D) = problem.normal(states, problem.expected() | dict(solved.estimate.shared)), states.shape
    own = factored(normal.blocks)
    Y = own.unwhiten(own.whiten(normal.border))
    S = normal.corner - np.tensordot(normal.border, Y, ((0, 1), (0, 1)))
    shared = np.linalg.solve(np.linalg.cholesky(S).T, rng.normal(size=(len(S), DRAWS)))
    moved, _ = dtbtrs(own.band, rng.normal(size=(T * D, DRAWS)), uplo="L", trans="T")
    moved = np.sqrt(setting.correlation_frames) * (moved.reshape(T, D, DRAWS) - Y @ shared)
    pose = setting.body.tree.pose_with_jacobian(states)
    position = np.einsum("tjid,tdn->ntji", pose.jacobian, moved)
    position += setting.size_sigma * rng.normal(size=(DRAWS, 1, 1, 1)) * pose.points_m
    off = {}
    for what, error in (("pose", position - position.mean(axis=2, keepdims=True)), ("position", position)):
        covariance = np.einsum("ntji,ntjk->tjik", error, error) / DRAWS
        scale = np.sqrt((DEGREES_OF_FREEDOM - 2) / rng.chisquare(DEGREES_OF_FREEDOM, (DRAWS, 1, 1)))
        in_sigmas = scale * sigmas(error, np.broadcast_to(covariance, (*error.shape, 3)))
        off[what] = in_sigmas.reshape(DRAWS, -1), (scale * _mm(error)).mean(axis=(1, 2))
    return off


def worst_views(runs: Sequence[Run], found: Sequence[Fit]) -> None:
    """Print the coverage of the worst views if errors are drawn from the stated covariances."""
    rng, off_m, far = np.random.default_rng(0), [], []
    shares, mm = ({what: [] for what in KINDS} for _ in range(2))
    for run in runs:
        body = as_seen(body_of(run.subject), run, runs, posed=True)
        for view in run.views.values():
            setting = ClipProblem.from_views([view], body, prior_of(PRIOR), run.fps, TrajectoryOptions())
            segment = max(solve_segments(setting), key=lambda one: one.rows.stop - one.rows.start)
            part, truth_m = setting.part(segment.rows), run.truth_m[segment.rows] - setting.origin_m
            for what, (off, off_mm) in draw_errors(part, segment, rng).items():
                shares[what].append(np.mean(off < radius(0.9, 3), axis=1))
                mm[what].append(off_mm)
            found_m, pull = body.tree.pose(segment.estimate.states).points_m, mode_shift(part, segment)
            both = [found_m, np.exp(-pull) * found_m]
            off_m.append([np.nanmean(np.linalg.norm(points_m - truth_m, axis=-1)) for points_m in both])
            middles = [np.linalg.norm(points_m.mean(axis=1), axis=-1) for points_m in (*both, truth_m)]
            far.append([np.nanmean(np.log(distance / middles[2])) for distance in middles[:2]])
    rows = []
    for what in KINDS:
        held = np.array(shares[what])
        worst, low = held.min(axis=0), np.sum(held < WORST, axis=0)
        real = np.array([np.mean(fit.off[what] < radius(0.9, 3)) for fit in found if fit.cameras == "one"])
        between = " to ".join(f"{q:.2f}" for q in np.quantile(worst, (0.05, 0.95)))
        cells = [f"{held.mean():.2f}", f"{np.median(worst):.2f} ({between})", f"{np.mean(low == 0):.0%}"]
        rows.append([what, *cells, f"{low.mean():.1f}", f"{real.min():.2f}", str(int(np.sum(real < WORST)))])
    print(f"\n90 % regions of each view, drawn as stated {DRAWS} times, and the real ones\n")
    head = ["", "all views", "worst view, median (90 %)", f"none below {WORST}", f"views below {WORST}"]
    print_table([*head, "real worst view", f"real views below {WORST}"], rows)
    sizes({what: np.array(of) for what, of in mm.items()}, [fit for fit in found if fit.cameras == "one"])
    rows = []
    for label, off_mm, log_ratios in zip(
        ("as found", "corrected"), 1000 * np.array(off_m).T, np.array(far).T, strict=True
    ):
        cells = [
            f"{log_ratios.mean():+.1%}",
            f"{np.sqrt(np.mean(log_ratios**2)):.1%}",
            str(int((log_ratios > 0).sum())),
        ]
        rows.append([label, *cells, f"{off_mm.mean():.0f}", f"{np.median(off_mm):.0f}"])
    print("\nPositions corrected for the bias of the joint minimum\n")
    print_table(["positions", "too far", "rms", "views too far", "mpe_mm mean", "median"], rows)


def sizes(drawn_mm: dict[str, np.ndarray], views: Sequence[Fit]) -> None:
    """Print errors (V, DRAWS), mm, that were drawn from stated covariances, and the real errors of the V views."""
    named = [view.named for view in views]
    rows = []
    for what in KINDS:
        of_views = (drawn_mm[what], np.array([[view.mm[what]] for view in views]))
        for label, mm in zip(("as stated", "real"), of_views, strict=True):
            each = (np.median(mm, axis=0), mm.mean(axis=0), mm.max(axis=0), mm[named].mean(axis=0))
            between = [f" ({low:.0f} to {high:.0f})" for low, high in (np.quantile(of, (0.05, 0.95)) for of in each)]
            cells = [f"{of.mean():.0f}{b if len(of) > 1 else ''}" for of, b in zip(each, between, strict=True)]
            rows.append([f"{what}, {label}", *cells])
    print("\nErrors drawn as stated, mm, mean (90 % of the draws), and the real errors\n")
    print_table(["", "median view", "mean of the views", "worst view", "named views"], rows)


def main() -> None:
    runs = runs_given(__doc__)
    found = fits(runs)
    print_tail_coverage(found)
    worst_views(runs, found)


if __name__ == "__main__":
    main()
