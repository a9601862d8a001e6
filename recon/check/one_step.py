"""Estimate one more unknown of a fit by one Gauss-Newton step from its solution.

A hypothesis about an input is often a number that the fit assumed to be known, such as the stretch of the picture or
the drift of a camera's clock. One step, with the poses and all other unknowns free, estimates this number and its
standard deviation, at the cost of one step of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from recon.base.arrays import Array
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate, SharedUnknown
from recon.fit.posterior import curvature
from recon.fit.result import TrajectorySolution
from recon.fit.terms import SIZE, PointRows, Reprojection, ReprojectionErrors, Scene, Span, offset_values

_EXTRA = "one more unknown"
_FREE = 10.0
"""Prior standard deviation of the added unknown, so large that the unknown is practically free."""


@dataclass(frozen=True)
class Detections:
    """Detections of one camera in N frames, with the values that a derivative needs."""

    frames: Array
    """(N,): rows of the frames in the clip."""
    centre_px: Array
    """(2,): the principal point."""
    projected_px: Array
    """(N, J, 2): the projected markers."""
    by_frame_px: Array
    """(N, J, 2): derivatives with respect to the time offset, in pixels per frame."""


ByUnknown = Callable[[Detections], Array]
"""Function that returns the derivatives (N, J, 2) of a camera's projected markers with respect to an unknown."""


@dataclass(frozen=True)
class Step:
    """Estimate of an unknown and its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True)
class _ExtendedReprojection(Reprojection):
    by_unknown: ByUnknown | None = None

    def _rows_of(self, span: Span, scene: Scene, errors: ReprojectionErrors) -> PointRows:
        """Return the rows of `Reprojection` with the derivatives with respect to the unknown."""
        rows = super()._rows_of(span, scene, errors)
        if self.by_unknown is None:
            return rows
        weight = self.weights_of(scene, errors)
        drift_m = np.zeros_like(scene.points_m) if self.drift_m is None else self.drift_m[scene.frames]
        detections = Detections(
            np.arange(scene.frames.start, scene.frames.stop),
            scene.view.camera.matrix[:2, 2],
            errors.unbiased_px,
            (errors.by_point * scene.size @ drift_m[..., None])[..., 0],
        )
        by_unknown = np.where(errors.seen[..., None], self.by_unknown(detections), 0.0) * weight[..., None]
        return replace(
            rows, by_shared=rows.by_shared | {_name(self.number): by_unknown.reshape(len(errors.seen), -1, 1)}
        )


def one_steps(
    clip: ClipProblem,
    solution: TrajectorySolution,
    unknowns: Mapping[int, ByUnknown],
    fixed: Sequence[str] = (),
    every: int = 1,
) -> dict[int, Step]:
    """Estimate unknowns of single cameras in the longest segment of a clip, each with the other unknowns at 0.

    Parameters
    ----------
    clip
        The problem of the whole clip, which states the prior's weight and whether the ground is near z = 0.
    solution
        Solution of the problem, from which the step starts.
    unknowns
        The derivatives with respect to each unknown, by the number of the camera whose detections depend on it.
    fixed
        Names of shared unknowns that are assumed to be known.
    every
        Distance between the frames that are used. Above 1, the estimate is less exact, and the functions in
        `unknowns` get a clip at a frame rate that is lower by this factor.

    Returns
    -------
    dict[int, Step]
        The estimate for each camera; empty if no segment has a pose in every frame.
    """
    segment = solution.longest_segment
    if segment is None:
        return {}
    correlation_frames, rows = clip.correlation_frames, slice(segment.rows.start, segment.rows.stop, every)
    clip = clip.part(segment.rows).before_offsets(solution.time_offset_frames).thinned(every)
    clip = replace(clip, prior_weight=segment.prior_weight)
    states = clip.nominal(solution.states[rows], solution.size)
    points_m = clip.markers(states)
    contact_terms = contacts(clip, points_m, solution.size)[-1] if clip.finds_ground else ()
    problem = clip.problem(solution.noise_px[:, rows], 1.0, contact_terms, points_m, solution.size)
    terms = [
        _extended(term, unknowns) if isinstance(term, Reprojection) and term.number in unknowns else term
        for term in problem.terms
    ]
    extra = [SharedUnknown(_name(camera), np.zeros(1), np.full(1, _FREE)) for camera in unknowns]
    free, nuisance = ([u for u in group if u.name not in fixed] for group in (problem.shared, problem.nuisance))
    problem = replace(problem, terms=terms, shared=[*free, *extra], nuisance=nuisance)
    values = problem.expected() | offset_values(solution.time_offset_frames / every)
    if SIZE in values:
        values[SIZE] = np.array([solution.size])
    at_solution = curvature(problem, Estimate(states, 0.0, 0, True, values), correlation_frames)
    columns = np.array([problem.columns[_name(camera)].start for camera in unknowns])
    steps = {}
    for camera, column in zip(unknowns, columns, strict=True):
        kept = np.setdiff1d(np.arange(len(at_solution.shared_gradient)), columns[columns != column])
        covariance = np.linalg.inv(at_solution.shared_precision[np.ix_(kept, kept)])
        row = covariance[np.searchsorted(kept, column)]
        variance = float(row[np.searchsorted(kept, column)]) * correlation_frames
        steps[camera] = Step(-float(row @ at_solution.shared_gradient[kept]), math.sqrt(variance))
    return steps


def _extended(term: Reprojection, unknowns: Mapping[int, ByUnknown]) -> Reprojection:
    values = {field.name: getattr(term, field.name) for field in fields(term)}
    return _ExtendedReprojection(**values, by_unknown=unknowns[term.number])


def _name(camera: int) -> str:
    return f"{_EXTRA} {camera}"
