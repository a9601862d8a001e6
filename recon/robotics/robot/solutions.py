"""All configurations of a chain that put its end effector in one place, found from many starts.

For chains without a closed form. The equations are solved by MINPACK's Levenberg-Marquardt with their exact Jacobian,
from fixed random starts; every start that ends on the target counts, and equal ends count once. More starts can find
more: that there is no other solution is not proven.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import root

from recon.base.arrays import Array, Bools
from recon.robotics.ik.chain import SerialChain

STARTS = 100
SAME = 1e-4
"""rad or m: configurations that differ by less are one."""
REACHED = 1e-7
"""Error of a solution, of the chain's length."""


def all_solutions(
    chain: SerialChain, place_m: ArrayLike, rotation: ArrayLike | None = None, starts: int = STARTS
) -> tuple[Array, bool]:
    """Configurations (m, n) with the end effector at place_m (3,), turned by rotation (3, 3), None: turned anyhow;
    turning joints in [-pi, pi), whatever the limits. And whether they are isolated: False where the joints can move on
    without moving the end effector, and one of endlessly many is given."""
    target = np.asarray(place_m, float)
    size = max(float(chain.lengths_m.sum()), float(np.linalg.norm(target)), 1e-9)
    turns = ~np.asarray(chain.sliding, bool)

    def equations(q: Array) -> tuple[Array, Array]:
        """(12 + n,), the last n are 0, so that there are never fewer than joints, and their derivatives."""
        R, p = chain.pose(q)
        J = chain.geometric_jacobian(q)
        error, slope = np.zeros(12 + chain.n), np.zeros((12 + chain.n, chain.n))
        error[:3], slope[:3] = (p - target) / size, J[:3] / size
        if rotation is not None:
            error[3:12] = (R - np.asarray(rotation, float)).T.ravel()
            slope[3:12] = np.concatenate([np.cross(J[3:].T, axis).T for axis in R.T])
        return error, slope

    low = np.where(turns, -np.pi, np.maximum(chain.lower_rad, -size))
    high = np.where(turns, np.pi, np.minimum(chain.upper_rad, size))
    places = [(low + high) / 2, *np.random.default_rng(0).uniform(low, high, (starts, chain.n))]
    ends = (root(equations, q, jac=True, method="lm", options={"xtol": 1e-12, "ftol": 1e-14}).x for q in places)
    found = [
        np.where(turns, (q + np.pi) % (2 * np.pi) - np.pi, q) for q in ends if np.abs(equations(q)[0]).max() < REACHED
    ]
    isolated = all(np.linalg.matrix_rank(equations(q)[1], 1e-6) == chain.n for q in found)
    kept = distinct_angles(found if isolated else found[:1], turns)
    return kept[np.lexsort(kept.round(6).T[::-1])], isolated


def distinct_angles(every: Iterable[Array], turns: Bools) -> Array:
    """(m, n): those (n,) that differ from all before them; turns (n,): whole turns are no difference."""
    kept: list[Array] = []
    for q in every:
        apart = [q - other for other in kept]
        if all(np.abs(np.where(turns, np.angle(np.exp(1j * d)), d)).max() > SAME for d in apart):
            kept.append(q)
    return np.array(kept).reshape(len(kept), len(turns))
