"""Second derivatives of a tree's markers, of one state, which inverse kinematics needs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from recon.base.arrays import Array
from recon.geometry.kinematics import CYCLE, ROOT, Tree


def derivatives(tree: Tree, state: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
    """For one state (D,): the markers' Jacobian (J, 3, D), the axes (D - 3, 3) of the angles, of joints that are
    not summed, and a function from weights (J, 3) to the weighted sum (D - 3, D - 3) of the second derivatives."""
    plan, J = tree.plan, len(tree.markers)
    _, axes, moved = tree.moved(state[None], np.ones(1))
    axes, moved = axes[..., 0], moved[..., 0]
    jacobian = np.zeros((J, 3, tree.n_state))
    jacobian.reshape(-1)[plan.entries] = moved if plan.merge is None else plan.merge @ moved
    jacobian[..., ROOT] = np.eye(3)
    sums = plan.sums[:-1]

    def curvature(weights: Array) -> Array:
        # weight . (outer axis x moved) = outer axis . (moved x weight)
        by = weights.take(plan.marker, axis=0).take(CYCLE, axis=1)
        along = moved.take(CYCLE, axis=1)
        swept = plan.gathered @ (along[:, 1:4] * by[:, 2:] - along[:, 2:] * by[:, 1:4])
        pairs = plan.outer * (axes @ swept.T)
        pairs = pairs + np.triu(pairs, 1).T
        return sums.T @ pairs @ sums

    return jacobian, axes, curvature
