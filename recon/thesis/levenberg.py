"""Minimise a sum of squares by Levenberg-Marquardt with a given initial damping and a fixed factor of change.

MINPACK, which the frame method uses by default, has a trust region and finds its own damping. The publication's solver
starts from a given damping. The solver divides the damping by a factor after each step that lowers the cost, and
multiplies it by this factor after every other step. A step solves (J'J + lambda S) step = -J'r. S contains the largest
squared norms that the columns of J have had, so the damping has no unit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from recon.base.arrays import Array

_MAX_DAMPING = 1e12
"""Damping above which a search is stopped, because its steps no longer change the solution."""


class Minimum(NamedTuple):
    """Result of a search, with the field names of scipy's `OptimizeResult`."""

    x: Array
    cost: float
    """Half the sum of squared residuals."""
    status: int
    """Status as in scipy: 0 evaluations used up, 1 gradient small, 2 cost settled, 3 step small."""
    nfev: int
    njev: int


def minimise(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    start: Array,
    tolerance: float,
    max_evaluations: int,
    initial_damping: float,
    factor: float,
) -> Minimum:
    """Minimise half the sum of squared residuals by Levenberg-Marquardt from a starting point (n,).

    The Jacobian is computed at accepted points only. The search ends when the relative change of the cost, the relative
    length of the step, or every component of the gradient relative to the norms of its column and of the residuals is
    at most `tolerance`.
    """
    x, r, damping, scale = start.copy(), residual(start), initial_damping, np.zeros(len(start))
    nfev, njev, status = 1, 0, 0
    while nfev < max_evaluations and status == 0:
        J = jacobian(x)
        njev += 1
        scale = np.maximum(scale, np.sum(J**2, axis=0))
        weight = np.where(scale > 0, scale, 1.0)
        gradient, hessian = J.T @ r, J.T @ J
        size = np.linalg.norm(r) * np.linalg.norm(J, axis=0)
        if not (np.abs(gradient) > tolerance * size).any():
            status = 1
            break
        while nfev < max_evaluations:
            step = np.linalg.solve(hessian + damping * np.diag(weight), -gradient)
            new_r = residual(x + step)
            nfev += 1
            squares, new_squares = float(r @ r), float(new_r @ new_r)
            is_small = np.linalg.norm(np.sqrt(weight) * step) <= tolerance * np.linalg.norm(np.sqrt(weight) * x)
            if new_squares < squares:
                x, r, damping = x + step, new_r, damping / factor
                if squares - new_squares <= tolerance * squares:
                    status = 2
                elif is_small:
                    status = 3
                break
            damping *= factor
            if is_small or damping > _MAX_DAMPING:
                status = 3
                break
    return Minimum(x, 0.5 * float(r @ r), status, nfev, njev)
