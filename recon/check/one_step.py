"""Estimate an additional unknown of a fit by a single Gauss-Newton step from the fit's solution.

Many faults of an input are described by a number that the fit assumes to be known, such as the stretch of the picture
or the drift of a camera's clock. A single step, with the poses and all other unknowns free, estimates this number and
its standard deviation.
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
    """Detections of J keypoints by one camera in N frames, from which the derivatives of an unknown are computed."""

    frames: Array
    """Indices of the frames in the clip, shape (N,)."""
    centre_px: Array
    """Principal point of the camera, shape (2,)."""
    projected_px: Array
    """Markers projected into the picture, shape (N, J, 2)."""
    by_frame_px: Array
    """Derivatives of the projected markers with respect to the time offset, pixels per frame, shape (N, J, 2)."""


ByUnknown = Callable[[Detections], Array]
"""Function that returns the derivatives of a camera's projected markers with respect to an unknown, (N, J, 2)."""


@dataclass(frozen=True)
class Step:
    """Estimate of an additional unknown, with its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True)
class _ExtendedReprojection(Reprojection):
    by_unknown: ByUnknown | None = None

    def _rows_of(self, span: Span, scene: Scene, errors: ReprojectionErrors) -> PointRows:
        """Return the least-squares rows of `Reprojection`, with derivatives with respect to the additional unknowns."""
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
    """Return the estimate of one additional unknown for each camera in `unknowns`, from a clip's longest segment.

    In each estimate, the additional unknowns of the other cameras are 0.

    Parameters
    ----------
    clip
        The problem of the whole clip, with the weight of the prior and the ground that the solution assumes.
    solution
        Solution of the problem, from which the step starts.
    unknowns
        Derivatives with respect to each unknown, with the index of the camera whose detections depend on it as the key.
    fixed
        Names of the fit's shared unknowns that are not free in the step.
    every
        Use only every n-th frame, which makes the estimate less exact. The functions in `unknowns` then get a clip with
        a frame rate that is lower by this factor.

    Returns
    -------
    dict[int, Step]
        The estimate for each camera index; empty if no segment has a pose in every frame.
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
