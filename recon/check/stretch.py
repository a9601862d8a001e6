"""Test whether the picture's pixels are square: a video stretched along x makes an animal of other proportions.

The stretch is one more unknown of the fit, a factor exp(s) on the camera's focal length along x. One Gauss-Newton step
from the solution, with the poses and all other unknowns free, estimates s and its standard deviation at the cost of one
step of the fit. An animal's upright and level lengths are known well enough to tell the usual stretches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from recon.base.arrays import Array
from recon.check.codes import finding
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate, SharedUnknown
from recon.fit.posterior import curvature
from recon.fit.result import Finding
from recon.fit.terms import SIZE, PointRows, Reprojection, Span, focal_scale

_STRETCH = "stretch"
_FREE = 10.0
"""Standard deviation of a logarithm that nothing is expected of."""


@dataclass(frozen=True)
class _StretchedReprojection(Reprojection):
    """Add the derivative of the detections by the stretch of the picture along x."""

    def point_rows(self, span: Span) -> PointRows:
        """Return the rows of `Reprojection` with those by the stretch."""
        rows, scene = super().point_rows(span), self._scene(span)
        *_, squares, seen, projected, _ = self._errors(scene, span, jacobian=True)
        confidence = np.where(scene.view.present, scene.view.confidence, 0.0)
        weight = np.sqrt(np.where(seen, confidence / (1.0 + squares), 0.0)) / scene.sigma_px
        by_stretch = np.zeros((*seen.shape, 2, 1))
        centre_x = scene.view.camera.matrix[0, 2]
        by_stretch[..., 0, 0] = np.where(seen, projected[..., 0] - centre_x, 0.0) * weight
        by_stretch = by_stretch.reshape(len(seen), -1, 1)
        return replace(rows, by_shared=rows.by_shared | {_STRETCH: by_stretch})


@dataclass(frozen=True)
class Stretch:
    """Hold the estimated logarithm of the picture's stretch along x, and its standard deviation."""

    log: float
    sigma: float

    @property
    def sigmas(self) -> float:
        """Return the deviation from the stretch of a right picture, in standard deviations; see `USUAL`."""
        return (self.log - USUAL) / math.hypot(SPREAD, SIGMA_SHARE * self.sigma)


USUAL, SPREAD, SIGMA_SHARE = 0.05, 0.04, 0.5
"""Mean estimate of right pictures, the least standard deviation of the estimates, and the share of the posterior's
standard deviation that right pictures show, because errors that last count carefully in it.
"""
LIMITS = -1.6, 3.3
"""Deviations, in standard deviations, beyond which a picture is compressed or stretched along x."""


def stretch_of(clip: ClipProblem, states: Array, noise_px: Array, size: float) -> Stretch:
    """Return the stretch of the picture of a clip that one camera sees.

    Parameters
    ----------
    clip
        A solved stretch of T frames.
    states
        (T, D), at nominal size about the origin, without gaps.
    noise_px
        (1, T, J): the noise of the detections.
    size
        The size of the solution.
    """
    points_m = clip.markers(states)
    *_, contact_terms = contacts(clip, points_m, size)
    problem = clip.problem(noise_px, 1.0, contact_terms, points_m, size)
    terms = [
        _StretchedReprojection(**{field.name: getattr(term, field.name) for field in fields(term)})
        if isinstance(term, Reprojection)
        else term
        for term in problem.terms
    ]
    nuisance = [unknown for unknown in problem.nuisance if unknown.name != focal_scale(0)]
    free = SharedUnknown(_STRETCH, np.zeros(1), np.full(1, _FREE))
    problem = replace(problem, terms=terms, shared=[*problem.shared, free], nuisance=nuisance)
    shared = problem.expected()
    if SIZE in shared:
        shared[SIZE] = np.array([size])
    at_solution = curvature(problem, Estimate(states, 0.0, 0, True, shared), clip.correlation_frames)
    covariance, column = np.linalg.inv(at_solution.shared_precision), problem.columns[_STRETCH].start
    variance = float(covariance[column, column]) * clip.correlation_frames
    return Stretch(-float(covariance[column] @ at_solution.pull), math.sqrt(variance))


def stretch_finding(clip: ClipProblem, states: Array, noise_px: Array, size: float) -> Finding | None:
    """Return a finding if the picture is stretched along x or y: see `stretch_of`."""
    stretch = stretch_of(clip, states, noise_px, size)
    if LIMITS[0] < stretch.sigmas < LIMITS[1]:
        return None
    return finding("picture_stretched", factor=math.exp(stretch.log - USUAL), sigmas=abs(stretch.sigmas))
