"""Estimate how smoothly an animal moves, from the detections of several cameras.

Without recorded motions, little is known about an animal's accelerations: the same defaults have to serve a galloping
cheetah and a walking mouse. Several cameras show the motion well enough to estimate the standard deviation of every
state's acceleration (`likely_scale`), as the value with the largest evidence.

**Method.** The cost of a solution, without its acceleration terms, is replaced by its quadratic expansion. The evidence
for the standard deviation s of an acceleration is largest where s^2 = sum(a^2) / g. Here a is the acceleration at the
minimum for this s, and g the number of frames minus the sum of their posterior variances relative to s^2, which is the
number of accelerations that the detections determine. The equation is solved by iteration.

References
----------
D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4, 1992.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from recon.base.arrays import Array
from recon.fit.banded import factored
from recon.fit.least_squares import LeastSquares
from recon.fit.terms import ACCELERATION_TERMS
from recon.geometry.kinematics import ROOT

SCALES = 0.01, 3.0
"""Minimum and maximum factor on an expected standard deviation of accelerations."""
_DIFFERENCE = (1.0, -2.0, 1.0)
"""Coefficients of three consecutive frames in their second difference."""
_ROUNDS = 20
"""Maximum number of rounds in which the factors are estimated."""
_MAX_CHANGE = 0.03
"""Relative change of the factors in a round that is small enough to end the rounds."""
_MIN_FRAMES = 10
"""Minimum number of frames required to estimate the standard deviations."""
_MIN_DETERMINED = 1.0
"""Minimum number of accelerations that the detections must determine to estimate a standard deviation."""


def likely_scale(problem: LeastSquares, states: Array, shared: Mapping[str, Array], scale: Array) -> Array:
    """Return the likeliest factors (D,) on the expected standard deviations of the states' accelerations.

    Parameters
    ----------
    problem
        The problem of a solution, whose acceleration terms are independent for every state.
    states
        The solution, (T, D).
    shared
        Values of the solution's shared unknowns, as a dictionary whose keys are their names.
    scale
        Factors that the problem uses, (D,).

    Returns
    -------
    Array
        Factors, (D,), equal for both horizontal directions.
    """
    if len(states) < _MIN_FRAMES:
        return scale
    accelerations = [term for term in problem.linear if term.name in ACCELERATION_TERMS]
    inverse_sigma = np.sum([np.abs(term.slots[0]).sum(axis=0) for term in accelerations], axis=0)
    expected_weight = inverse_sigma * scale
    rest = [term for term in problem.linear if term.name not in ACCELERATION_TERMS]
    rows, normal = replace(problem, linear=rest, shared=(), nuisance=()).middle_piece(states, shared)
    states = states[rows]
    T = len(states)
    for _ in range(_ROUNDS):
        weight = expected_weight / scale
        blocks, gradient = normal.blocks.copy(), normal.gradient + _penalty_gradient(states, weight)
        _add_penalty(blocks, weight)
        factor = factored(blocks, 0.0, bounded=True)
        solved = states - factor.unwhiten(factor.whiten(gradient[..., None]))[..., 0]
        squares = np.sum((_second_difference(solved) * weight) ** 2, axis=0)
        variances = np.sum(_second_difference_variance(factor.marginal_blocks()), axis=0) * weight**2
        determined = T - 2 - variances
        for values in (squares, determined):  # no horizontal direction is special
            values[ROOT][:2] = values[ROOT][:2].mean()
        ratio = np.sqrt(squares / np.maximum(determined, _MIN_DETERMINED))
        change = np.where(determined > _MIN_DETERMINED, ratio, 1.0)
        next_scale = np.clip(scale * np.clip(change, 0.1, 10.0), *SCALES)
        is_close = np.abs(np.log(next_scale / scale)).max() < _MAX_CHANGE
        scale = next_scale
        if is_close:
            break
    return scale


def _second_difference(states: Array) -> Array:
    """Return the second differences x(t - 1) - 2 x(t) + x(t + 1), shape (T - 2, D), of states (T, D)."""
    return states[:-2] - 2 * states[1:-1] + states[2:]


def _second_difference_variance(marginal: Array) -> Array:
    """Return the variances (T - 2, D) of second differences from the blocks of the covariance (T, 3, D, D)."""
    variance, next_frame, second_frame = np.moveaxis(np.diagonal(marginal, axis1=2, axis2=3), 1, 0)
    single = variance[:-2] + 4 * variance[1:-1] + variance[2:]
    return single - 4 * next_frame[:-2] - 4 * next_frame[1:-1] + 2 * second_frame[:-2]


def _penalty_gradient(states: Array, weight: Array) -> Array:
    """Return the gradient (T, D) of half the squared second differences times weights (D,)."""
    pull, gradient = _second_difference(states) * weight**2, np.zeros_like(states)
    for first, coefficient in enumerate(_DIFFERENCE):
        gradient[first : first + len(pull)] += coefficient * pull
    return gradient


def _add_penalty(blocks: Array, weight: Array) -> None:
    """Add the curvature of half the squared second differences to blocks (T, W+1, D, D), in place."""
    T, D = len(blocks), len(weight)
    coordinates = np.arange(D)
    for column, by_column in enumerate(_DIFFERENCE):
        for row, by_row in enumerate(_DIFFERENCE[column:]):
            blocks[column : column + T - 2, row, coordinates, coordinates] += by_column * by_row * weight**2
