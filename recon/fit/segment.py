"""Define a solved segment of a clip, and the round in which a segment is solved again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from recon.base.arrays import Array
from recon.clip import View
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import PriorMisfit
from recon.fit.result import Ground
from recon.fit.terms import LENGTHS, extrinsic_correction, focal_scale, size_of, time_offset


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """A segment of n frames of a clip, with its fitted unknowns and noise."""

    rows: slice
    """Slice of the clip's frames that the segment covers."""
    estimate: Estimate
    problem: LeastSquares
    noise: Array
    """Variances of the detections of each joint in each view, relative to the expected variances, shape (V, J)."""
    noise_px: Array
    """Standard deviation of each detection, px, shape (V, n, J)."""
    contact: Array
    """Contact of the feet with the ground, 0 to 1, shape (n, F)."""
    ground: Ground | None
    """Ground plane under the body of nominal size, relative to `ClipProblem.origin_m`; None if no foot stood."""
    prior_misfit: PriorMisfit | None = None
    """Misfit of the motion under the prior, from the first round."""
    prior_weight: float = 1.0
    """Factor on the weight of the prior, 0 to 1."""
    windows: list[tuple[slice, list[Estimate]]] = field(default_factory=list)
    """Frames of each window, and the solutions that the approach reached from its starts, the best first."""
    iterations: int = 0

    @classmethod
    def unsolved(cls, clip: ClipProblem, rows: slice, estimate: Estimate) -> SegmentFit:
        """Return a segment with the expected noise, to be solved in a first round."""
        noise, contact = np.ones((len(clip.views), len(clip.body.markers))), np.zeros((len(clip), len(clip.feet)))
        return cls(rows, estimate, LeastSquares(clip.body.detected, [], []), noise, np.zeros(0), contact, None)

    @property
    def size(self) -> float:
        """Return the animal's estimated size, a factor on the body's lengths."""
        return size_of(self.estimate.shared)

    def shared_values(self, name: str, count: int = 1) -> Array:
        """Return the estimated values (count,) of the named shared unknowns, or 0 if they were not estimated."""
        return self.estimate.shared.get(name, np.zeros(count))


def with_solved_shape(clip: ClipProblem, segment: SegmentFit) -> ClipProblem:
    """Return the problem with the body's lengths and keypoint offsets as estimated in a segment."""
    if clip.shape is None or LENGTHS not in segment.estimate.shared:
        return clip
    return replace(clip, body=clip.shape.applied(segment.estimate.shared))


def with_solved_cameras(clip: ClipProblem, segment: SegmentFit) -> ClipProblem:
    """Return the problem with the views' time offsets and cameras as estimated in a segment."""
    V = range(len(clip.views))
    offsets = [float(segment.shared_values(time_offset(i))[0]) for i in V]
    corrections = [segment.shared_values(extrinsic_correction(i), 6) for i in V]
    focal_scales = [float(segment.shared_values(focal_scale(i))[0]) for i in V]
    return replace(clip, views=solved_views(clip.views, offsets, corrections, focal_scales))


def solved_views(
    views: Sequence[View], offsets: Iterable[float], corrections: Iterable[Array], focal_scales: Iterable[float]
) -> tuple[View, ...]:
    """Return views after adding time offsets (in frames) and correcting the cameras' poses and focal lengths.

    Each argument has one item for each view. `corrections` are as in `View.corrected`, and `focal_scales` are the
    logarithms of factors on the focal lengths.
    """
    return tuple(
        replace(view, offset_frames=view.offset_frames + frames).corrected(correction).with_focal_scale(factor)
        for view, frames, correction, factor in zip(views, offsets, corrections, focal_scales, strict=True)
    )


def refined(clip: ClipProblem, segment: SegmentFit) -> SegmentFit:
    """Solve a segment once more from its fit, for a problem that may have changed slightly."""
    return solve_round(replace(clip.part(segment.rows), prior_weight=segment.prior_weight), segment)


def solve_round(clip: ClipProblem, segment: SegmentFit, roughly: bool = False) -> SegmentFit:
    """Estimate noise, contacts and ground from a segment's fit, and solve the segment again from this fit.

    `roughly` ends the search early, because another round follows.
    """
    options, estimate, size = clip.options, segment.estimate, segment.size
    points = with_solved_shape(clip, segment).markers(estimate.states)
    noise = _noise_factors(with_solved_cameras(clip, segment), points, size, segment.noise)
    contact, ground, contact_terms = contacts(clip, points, size)
    noise_px = clip.noise_px(points, noise, size)
    problem = clip.problem(noise_px, 1.0, contact_terms, points, size)
    tolerance = constants.ROUGH_TOLERANCE if roughly else (10 if options.fast else 1) * constants.TOLERANCE
    shared = problem.expected() | dict(estimate.shared)
    estimate = problem.minimise(estimate.states, tolerance, constants.MAX_ITERATIONS, shared)
    segment = replace(segment, noise=noise, noise_px=noise_px, contact=contact, ground=ground)
    return replace(segment, estimate=estimate, problem=problem, iterations=segment.iterations + estimate.iterations)


def _noise_factors(clip: ClipProblem, points_m: Array, size: float, factors: Array) -> Array:
    """Return the variance (V, J) of each joint's detections in each view, relative to the expected variance.

    The variance is the weighted mean of squared residuals under the robust loss, in which the expected variance counts
    as eight detections. The result is limited to 1/4 to 6 times the expected variance, so that no joint is followed
    exactly or ignored. If several cameras estimate the body's shape and the detector was not measured, the residuals
    show the noise better than the expectation, so the expected variance counts as `NOISE_COUNT` detections and the
    lower limit is `MIN_NOISE`.
    """
    world = clip.in_world(points_m, size)
    is_expected = clip.shape is None or clip.detector_is_measured or len(clip.views) == 1
    least, count = (0.25, 8.0) if is_expected else (constants.MIN_NOISE, constants.NOISE_COUNT)
    factors_of_views = []
    expected = clip.noise_px(points_m, np.ones_like(factors), size)
    for view, factor, expected_px in zip(clip.views, factors, expected, strict=True):
        projected, valid = view.project(view.shift_to_exposure(world))
        seen = view.present & valid
        q = np.where(seen, np.sum((projected - view.xy_px) ** 2, axis=-1) / expected_px**2, 0.0)
        for _ in range(10):
            weight = seen / (1.0 + q / factor / constants.ROBUST_C**2)
            factor = (np.sum(weight * q, axis=0) / 2 + count) / (seen.sum(axis=0) + count)
        factors_of_views.append(np.clip(factor, least, 6.0))
    return np.array(factors_of_views)
