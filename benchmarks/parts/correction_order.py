"""Correct detections of real runs in the order of to_correct.csv, and compare this with other orders.

    python benchmarks/parts/correction_order.py [FOLDER] [--quick]

Each view is the named camera of a run, or that camera and another one. Detections are replaced by the projections of
the multi-camera reconstruction, the first 10, 20 or 40 of the order, and the clip is fitted again from the earlier fit.
The error is the mean distance of the joints from the reconstruction, both poses centred. A fall is the reduction of
this error.

The orders are:

- `recon`: the order of to_correct.csv
- `random`: the mean of several random orders
- `likelihood`: the least likely detection first (all likelihoods of these runs are 1, so this is the file's order)
- `greedy`: at each step, the detection whose replacement brings the joints closest to the reconstruction, according to
  the linearised fit. This order needs the reconstruction

The last table shows how much of greedy's fall can be reached without the reconstruction. The true errors are replaced
by errors drawn from the fit's own posterior, for which the expected falls are exact, and all falls are computed by the
linearised fit. `expected` is the order of the expected falls of all detections. FOLDER is by default the cheetah-runs
of $RECON_SHARED_DATA, or of ../shared/data.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_or_exit
from markdown_table import print_header, print_row, print_table
from recordings import fit_settings, meta_of, truth_at

from recon import FitSettings, Motion, fit_clip
from recon.api.clip import refit_clip
from recon.api.clip_inputs import prepare
from recon.base.arrays import Array
from recon.check.to_correct import to_correct
from recon.clip import views_of
from recon.fit.banded import eliminated
from recon.fit.clip_problem import ClipProblem
from recon.fit.correction_gain import problems_at
from recon.fit.result import TrajectorySolution
from recon.io.corrections import Correction, write_corrections

COUNTS = (10, 20, 40)
RANDOM_ORDERS, DRAWS = 3, 3
AT_ONCE = 256
"""Number of candidate detections whose effects are computed together, to limit the memory."""
LEAST_PRECISION = 1e-6

Cell = tuple[int, int, int]
"""Indices of the view, the frame and the joint of a detection."""


@dataclass(frozen=True, eq=False)
class Clip:
    """Fit of one view, with the truth."""

    settings: FitSettings
    motion: Motion
    truth_m: Array
    """Multi-camera reconstruction, shape (T, J, 3), metres; NaN in frames that it does not have."""

    @cached_property
    def true_px(self) -> Array:
        """Return the projections of the truth, (V, T, J, 2), pixels; NaN outside the picture."""
        projections = []
        for view in views_of(self.motion.sources):
            xy_px, is_valid = view.project(self.truth_m)
            is_inside = is_valid & view.camera.in_image(xy_px)
            projections.append(np.where(is_inside[..., None], xy_px, np.nan))
        return np.array(projections)

    @cached_property
    def cells(self) -> list[Cell]:
        """List the detections that can be replaced by the true position."""
        is_known = np.isfinite(self.true_px[..., 0]) & self.motion.solved[:, None]
        return [(v, t, j) for v, t, j in np.argwhere(is_known).tolist()]

    def error_mm(self, motion: Motion) -> float:
        off_m = centred(motion.joints_m) - centred(self.truth_m)
        return 1e3 * float(np.nanmean(np.linalg.norm(off_m, axis=-1)))

    def falls_mm(self, order: Sequence[Cell]) -> list[float]:
        """Return by how much the error falls, mm, after the first 10, 20 and 40 corrections of an order (`COUNTS`)."""
        return [self.error_mm(self.motion) - self.error_mm(self.corrected(order[:count])) for count in COUNTS]

    def corrected(self, cells: Sequence[Cell]) -> Motion:
        """Fit the clip again, with some detections replaced by the true positions."""
        motion = self.motion
        rows = [
            Correction(
                int(motion.frames[t]) - motion.sources[v].later_frames,
                motion.sources[v].camera.name,
                motion.names[j],
                None,
                (float(self.true_px[v, t, j, 0]), float(self.true_px[v, t, j, 1])),
            )
            for v, t, j in cells
        ]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "corrections.csv"
            write_corrections(rows, path)
            return refit_clip(replace(self.settings, corrections=path), motion)

    def listed(self) -> list[Cell]:
        """Return the detections in the order of to_correct.csv."""
        motion, known = self.motion, {*self.cells}
        numbers = {picture.name: v for v, picture in enumerate(motion.pictures)}
        cells = []
        for row in to_correct(motion):
            v = numbers[row.camera]
            t = int(np.searchsorted(motion.frames, row.frame + motion.sources[v].later_frames))
            cells.append((v, t, motion.names.index(row.keypoint)))
        return [cell for cell in cells if cell in known]


def centred(points_m: Array) -> Array:
    return points_m - points_m.mean(axis=1, keepdims=True)


class Linearised:
    """Linearised fit of a view with N detections that can be replaced.

    A replaced detection has the weight of a detection without error. Its effect on the joints is computed as if no
    other detection were replaced.
    """

    def __init__(self, clip: Clip) -> None:
        solution, inputs = clip.motion.solution, prepare(clip.settings)
        options = clip.settings.trajectory_options()
        assert isinstance(solution, TrajectorySolution)
        problem_clip = ClipProblem.from_views(solution.views, solution.body, inputs.prior, inputs.fps, options)
        ((rows, part, problem, estimate),) = problems_at(problem_clip, solution)
        assert rows == slice(0, len(clip.motion.frames))
        (self.window,) = eliminated(replace(problem, shared=(), nuisance=()).normals(estimate.states)(), bounded=True)
        self.variance_factor = part.correlation_frames
        self.cells = np.array(clip.cells)
        self.projection, predicted_px = self.projections(part, solution.size, estimate.states)
        pose = part.body.tree.pose_with_jacobian(estimate.states)
        self.joints = solution.size * (pose.jacobian - pose.jacobian.mean(axis=1, keepdims=True))
        at = tuple(self.cells.T)
        detected_px = np.array([view.xy_px for view in part.views])[at]
        self.innovation_px = clip.true_px[at] - predicted_px
        self.residual_px = np.nan_to_num(detected_px - predicted_px)
        is_present = np.array([view.present * view.confidence for view in part.views])
        self.weight = (np.nan_to_num(solution.weight) * is_present)[at]
        self.noise_px = solution.noise_px[at]
        self.is_known = np.isfinite(clip.truth_m).all(axis=(1, 2))
        self.error_m = (centred(clip.motion.joints_m) - centred(clip.truth_m))[self.is_known]
        self.covariance_px2, self.joints_by_px = self.covariances()

    def projections(self, part: ClipProblem, size: float, states: Array) -> tuple[Array, Array]:
        """Return the projected keypoints' Jacobians (N, 2, D) with respect to the states, and their pixels (N, 2)."""
        detected = part.body.detected.pose_with_jacobian(states)
        world_m = part.in_world(detected.points_m, size)
        derivatives, projected_px = [], []
        for view in part.views:
            xy_px, by_point, _ = view.project_with_jacobian(view.shift_to_exposure(world_m))
            derivatives.append(size * by_point @ detected.jacobian)
            projected_px.append(xy_px)
        at = tuple(self.cells.T)
        return np.array(derivatives)[at], np.array(projected_px)[at]

    def covariances(self) -> tuple[Array, Array]:
        """Return covariances (N, 2, 2) of the projections, and their covariances with all known joints.

        The covariances with the joints have the shape (N, 2, frames J 3). Both come from the inverse of the normal
        equations, without the variance factor.
        """
        (T, J), N, D = self.joints.shape[:2], len(self.cells), self.projection.shape[-1]
        joints_by_px = np.empty((N, 2, int(self.is_known.sum()) * J * 3))
        covariance_px2 = np.empty((N, 2, 2))
        for t in range(T):
            chosen = np.flatnonzero(self.cells[:, 1] == t)
            right = np.zeros((T, D, 2 * len(chosen)))
            right[t] = self.projection[chosen].reshape(-1, D).T
            moved = self.window.unwhiten(self.window.factor.whiten(right)).reshape(T, D, len(chosen), 2)
            covariance_px2[chosen] = np.einsum("nad,dnb->nab", self.projection[chosen], moved[t])
            by_px = np.einsum("tjxd,tdnb->nbtjx", self.joints[self.is_known], moved[self.is_known], optimize=True)
            joints_by_px[chosen] = by_px.reshape(len(chosen), 2, -1)
        return covariance_px2, joints_by_px

    def shifts_m(self, innovation_px: Array) -> Array:
        """Return the shifts of the known joints, (N, frames J 3), metres, if each detection is replaced alone."""
        variance_px2 = self.noise_px**2
        added = np.maximum(1.0 - self.weight, LEAST_PRECISION) / variance_px2
        pull = (innovation_px - self.weight[:, None] * self.residual_px) / variance_px2[:, None]
        inverse = np.linalg.inv(np.eye(2) + added[:, None, None] * self.covariance_px2)
        return np.einsum("nab,nb,nam->nm", inverse, pull, self.joints_by_px, optimize=True)

    def expected_order(self) -> list[int]:
        """Return the detections in the order of the expected square of their effect, the largest first.

        The residual is known, and the expected square of the innovation is the variance of the projection.
        """
        variance_px2 = self.noise_px**2
        added = np.maximum(1.0 - self.weight, LEAST_PRECISION) / variance_px2
        inverse = np.linalg.inv(np.eye(2) + added[:, None, None] * self.covariance_px2)
        squared = inverse.swapaxes(1, 2) @ (self.joints_by_px @ self.joints_by_px.swapaxes(1, 2)) @ inverse
        innovation_px2 = self.variance_factor * self.covariance_px2
        residual_px = self.weight[:, None] * self.residual_px
        spread_px2 = innovation_px2 + residual_px[:, :, None] * residual_px[:, None]
        effect_m2 = np.einsum("nab,nba->n", squared, spread_px2) / variance_px2**2
        return np.argsort(-effect_m2, kind="stable").tolist()

    def greedy(self, error_m: Array, shifts_m: Array) -> list[int]:
        """Return the order of corrections in which every step brings the joints closest to the truth."""
        left_m, order = error_m.ravel().copy(), list[int]()
        is_left = np.ones(len(shifts_m), dtype=bool)
        for _ in range(max(COUNTS)):
            parts = [shifts_m[first : first + AT_ONCE] for first in range(0, len(shifts_m), AT_ONCE)]
            errors_m = np.concatenate([mean_length(left_m + part) for part in parts])
            best = int(np.argmin(np.where(is_left, errors_m, np.inf)))
            is_left[best] = False
            left_m += shifts_m[best]
            order.append(best)
        return order

    def draw_errors(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw a truth from the posterior, and return the errors of the known joints and the innovations."""
        T, D = self.joints.shape[0], self.projection.shape[-1]
        states = np.sqrt(self.variance_factor) * self.window.unwhiten(rng.normal(size=(T, D)))
        joints_m = np.einsum("tjxd,td->tjx", self.joints, states)[self.is_known]
        return -joints_m, np.einsum("nad,nd->na", self.projection, states[self.cells[:, 1]])


def mean_length(flat_m: Array) -> Array:
    """Return the mean length (n,) of the M vectors in each row of an array (n, 3 M)."""
    return np.linalg.norm(flat_m.reshape(len(flat_m), -1, 3), axis=-1).mean(axis=1)


def linear_falls_mm(error_m: Array, shifts_m: Array, order: Sequence[int]) -> list[float]:
    """Return by how much the error falls, mm, after the first `COUNTS` corrections, according to the linearised fit."""
    before_m = error_m.reshape(1, -1)
    return [
        1e3 * float((mean_length(before_m) - mean_length(before_m + shifts_m[[*order[:count]]].sum(axis=0)))[0])
        for count in COUNTS
    ]


def clips(runs: Sequence[Path]) -> Iterator[tuple[str, Clip]]:
    """Yield the name and the fit of each view."""
    for run in runs:
        meta = meta_of(run)
        first = meta["monocular_camera"]
        second = next(camera for camera in meta["cameras"] if camera != first)
        for cameras in ((first,), (first, second)):
            settings = fit_settings(run, cameras)
            motion = fit_clip(settings)
            truth_m = truth_at(run, motion.frames, motion.names)
            yield f"{run.name}, {' + '.join(map(str, cameras))}", Clip(settings, motion, truth_m)


def measured_falls(clip: Clip, fit: Linearised) -> dict[str, list[float]]:
    """Correct and fit a clip in each order, and return how much the error falls, mm, after `COUNTS` corrections."""
    greedy = fit.greedy(fit.error_m, fit.shifts_m(fit.innovation_px))
    shuffled = [np.random.default_rng(seed).permutation(len(clip.cells)) for seed in range(RANDOM_ORDERS)]
    by_frame = sorted(clip.cells, key=lambda cell: (cell[1], cell[0], cell[2]))
    falls = {
        "greedy": clip.falls_mm([clip.cells[i] for i in greedy]),
        "recon": clip.falls_mm(clip.listed()),
        "likelihood": clip.falls_mm(by_frame),
    }
    random_falls = [clip.falls_mm([clip.cells[i] for i in order]) for order in shuffled]
    return falls | {"random": np.mean(random_falls, axis=0).tolist()}


def drawn_falls(clip: Clip, fit: Linearised, seed: int) -> dict[str, list[float]]:
    """Draw a truth from the posterior, and return how much each order reduces the error, mm, after `COUNTS` steps."""
    rng = np.random.default_rng(seed)
    error_m, innovation_px = fit.draw_errors(rng)
    shifts_m, index = fit.shifts_m(innovation_px), {cell: i for i, cell in enumerate(clip.cells)}
    orders = {
        "greedy": fit.greedy(error_m, shifts_m),
        "recon": [index[cell] for cell in clip.listed()],
        "expected": fit.expected_order(),
        "random": rng.permutation(len(clip.cells)).tolist(),
    }
    return {name: linear_falls_mm(error_m, shifts_m, order) for name, order in orders.items()}


def in_words(falls_mm: Sequence[float]) -> str:
    return ", ".join(f"{fall:.1f}" for fall in falls_mm)


def main() -> None:
    parser = parser_of(__doc__, "--quick", kind="cheetah-runs")
    options = parser.parse_args()
    runs = runs_or_exit(parser, options.folder)[: 1 if options.quick else None]
    names = ("greedy", "recon", "random", "likelihood")
    print_header(
        ["view", "error, mm", *(f"{name}: fall after 10, 20, 40, mm" for name in names), "recon / greedy at 20"]
    )
    views, drawn = [], []
    for seed, (title, clip) in enumerate(clips(runs)):
        fit = Linearised(clip)
        falls = measured_falls(clip, fit)
        views.append(falls)
        fraction = falls["recon"][1] / falls["greedy"][1]
        print_row([title, f"{clip.error_mm(clip.motion):.1f}", *(in_words(falls[n]) for n in names), f"{fraction:.2f}"])
        drawn += [drawn_falls(clip, fit, DRAWS * seed + draw) for draw in range(DRAWS)]
    print(flush=True)
    rows = []
    for name in ("recon", "random", "likelihood"):
        shares = np.mean([np.divide(falls[name], falls["greedy"]) for falls in views], axis=0)
        wins = [sum(falls["recon"][i] > falls[name][i] for falls in views) for i in range(len(COUNTS))]
        rows.append([name, *(f"{x:.2f}" for x in shares), ", ".join(map(str, wins)) if name != "recon" else ""])
    header = [*(f"fraction of greedy's fall after {count}" for count in COUNTS), f"recon better, of {len(views)} views"]
    print_table(["order", *header], rows)
    rows = [
        [name, *(f"{x:.2f}" for x in np.mean([np.divide(f[name], f["greedy"]) for f in drawn], axis=0))]
        for name in ("expected", "recon", "random")
    ]
    print_table(["order, errors from the posterior", *header[:-1]], rows)


if __name__ == "__main__":
    main()
