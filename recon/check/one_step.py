"""Estimate an additional unknown of a fit by a single Gauss-Newton step from the fit's solution.

Many faults of an input are described by a number that the fit assumes to be known, such as the stretch of the picture
or the drift of a camera's clock. A single step, with the poses and all other unknowns free, estimates this number and
its standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np

from recon.base.arrays import Array
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate, SharedUnknown
from recon.fit.posterior import curvature
from recon.fit.result import TrajectorySolution
from recon.fit.terms import SIZE, PointRows, Reprojection, ReprojectionErrors, Scene, Span, offset_values

_EXTRA = "one more unknown"
_Key = TypeVar("_Key")
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
class Unknown:
    """Additional unknown, on which the detections of one camera depend."""

    camera: int
    """Index of the camera."""
    by_unknown: ByUnknown
    fixed: tuple[str, ...] = ()
    """Names of the fit's shared unknowns that are not free in the step."""


@dataclass(frozen=True)
class Step:
    """Estimate of an additional unknown, with its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True)
class _ExtendedReprojection(Reprojection):
    by_unknown: Mapping[str, ByUnknown] = field(default_factory=dict)
    """Derivatives with respect to each additional unknown, keyed by its name."""

    def _rows_of(self, span: Span, scene: Scene, errors: ReprojectionErrors) -> PointRows:
        """Return the least-squares rows of `Reprojection`, with derivatives with respect to the additional unknowns."""
        rows = super()._rows_of(span, scene, errors)
        weight = self.weights_of(scene, errors)
        drift_m = np.zeros_like(scene.points_m) if self.drift_m is None else self.drift_m[scene.frames]
        detections = Detections(
            np.arange(scene.frames.start, scene.frames.stop),
            scene.view.camera.matrix[:2, 2],
            errors.unbiased_px,
            (errors.by_point * scene.size @ drift_m[..., None])[..., 0],
        )
        by_shared = dict(rows.by_shared)
        for name, by_unknown in self.by_unknown.items():
            of_seen = np.where(errors.seen[..., None], by_unknown(detections), 0.0) * weight[..., None]
            by_shared[name] = of_seen.reshape(len(errors.seen), -1, 1)
        return replace(rows, by_shared=by_shared)


def one_steps(
    clip: ClipProblem, solution: TrajectorySolution, unknowns: Mapping[_Key, Unknown], every: int = 1
) -> dict[_Key, Step]:
    """Return the estimate of each additional unknown, from a clip's longest segment.

    In each estimate, the other additional unknowns are 0.

    Parameters
    ----------
    clip
        The problem of the whole clip, with the weight of the prior and the ground that the solution assumes.
    solution
        Solution of the problem, from which the step starts.
    unknowns
        The additional unknowns.
    every
        Use only every n-th frame, which makes the estimate less exact. The functions in `unknowns` then get a clip with
        a frame rate that is lower by this factor.

    Returns
    -------
    dict
        The estimates, with the keys of `unknowns`; empty if no segment has a pose in every frame.
    """
    segment = solution.longest_segment
    if segment is None:
        return {}
    correlation_frames, rows = clip.correlation_frames, slice(segment.rows.start, segment.rows.stop, every)
    clip = clip.part(segment.rows).before_offsets(solution.time_offset_frames).thinned(every)
    clip = replace(clip, prior_weight=segment.prior_weight)
    states = clip.nominal(solution.states[rows], solution.size)
    points_m = clip.markers(states)
    *_, contact_terms = contacts(clip, points_m, solution.size)
    problem = clip.problem(solution.noise_px[:, rows], 1.0, contact_terms, points_m, solution.size)
    names = {key: f"{_EXTRA} {i}" for i, key in enumerate(unknowns)}
    terms = []
    for term in problem.terms:
        camera = term.number if isinstance(term, Reprojection) else None
        by_unknown = {names[key]: unknown.by_unknown for key, unknown in unknowns.items() if unknown.camera == camera}
        terms.append(_extended(term, by_unknown) if isinstance(term, Reprojection) and by_unknown else term)
    extra = [SharedUnknown(name, np.zeros(1), np.full(1, _FREE)) for name in names.values()]
    problem = replace(problem, terms=terms, shared=[*problem.shared, *extra, *problem.nuisance], nuisance=())
    values = problem.expected() | offset_values(solution.time_offset_frames / every)
    if SIZE in values:
        values[SIZE] = np.array([solution.size])
    at_solution = curvature(problem, Estimate(states, 0.0, 0, True, values), correlation_frames)
    steps, P = {}, len(at_solution.shared_gradient)
    for key, unknown in unknowns.items():
        left_out = {*names.values(), *unknown.fixed} - {names[key]}
        free = [np.arange(*at.indices(P)) for name, at in problem.columns.items() if name not in left_out]
        kept, column = np.concatenate(free), problem.columns[names[key]].start
        covariance = np.linalg.inv(at_solution.shared_precision[np.ix_(kept, kept)])
        row = covariance[np.searchsorted(kept, column)]
        variance = float(row[np.searchsorted(kept, column)]) * correlation_frames
        steps[key] = Step(-float(row @ at_solution.shared_gradient[kept]), math.sqrt(variance))
    return steps


def _extended(term: Reprojection, by_unknown: Mapping[str, ByUnknown]) -> Reprojection:
    values = {of_term.name: getattr(term, of_term.name) for of_term in fields(term)}
    return _ExtendedReprojection(**values, by_unknown=by_unknown)
