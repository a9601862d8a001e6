"""A four-joint arm in closed form: a lift, two planar joints, and a wrist that turns the hand in the plane.

q = (height, q1, q2, q3): metres (or whatever unit the links have) and rad; the hand is at

    x = l1 cos q1 + l2 cos(q1 + q2)    y = l1 sin q1 + l2 sin(q1 + q2)    angle = q1 + q2 + q3

so that the wrist takes what the two-link arm (`recon.robotics.ik.chain.two_link`) leaves of the angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array
from recon.robotics.ik.chain import two_link


def lift_arm(lengths_m: tuple[float, float], hand: ArrayLike, height_m: float) -> tuple[Array, str]:
    """Both branches (2, 4) for a hand at (x, y, angle), metres and rad, at a height: (height, q1, q2, q3) with q2 <= 0,
    then with q2 >= 0, NaN without a solution; and why there is none or only one, empty for two. Raises ValueError for
    lengths that are not two positive ones."""
    x, y, angle = np.asarray(hand, float)
    branches_rad, reason = two_link(lengths_m, (x, y))
    wrist = angle - branches_rad.sum(axis=1)
    wrist = np.pi - (np.pi - wrist) % (2 * np.pi)
    height = np.where(np.isfinite(wrist), height_m, np.nan)
    return np.column_stack([height, branches_rad, wrist]), reason


def lift_arm_hand(lengths_m: tuple[float, float], q: ArrayLike) -> tuple[Array, Array]:
    """Hands (..., 3), x, y and angle, and heights (...) of q (..., 4)."""
    height, q1, q2, q3 = np.moveaxis(np.asarray(q, float), -1, 0)
    l1, l2 = lengths_m
    x = l1 * np.cos(q1) + l2 * np.cos(q1 + q2)
    y = l1 * np.sin(q1) + l2 * np.sin(q1 + q2)
    return np.stack([x, y, q1 + q2 + q3], axis=-1), height
