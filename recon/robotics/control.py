"""Joints' motions as a controller takes them: angle, rate and acceleration at every sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recon.base.arrays import Array


def control_rates(q: Array, interval_s: float, before: Array | None, after: Array | None) -> tuple[Array, Array]:
    """Rates and accelerations (N, n), per second and per second^2, at samples q (N, n), an interval apart.

    They are those of the parabola through a sample and its neighbours. before, after (n,): what precedes the first
    sample and follows the last; None: unknown, and the first or last sample lies on its neighbour's parabola, which
    takes three samples.
    """
    first = 3 * q[0] - 3 * q[1] + q[2] if before is None else before
    last = 3 * q[-1] - 3 * q[-2] + q[-3] if after is None else after
    known = np.vstack([first, q, last])
    return (known[2:] - known[:-2]) / (2 * interval_s), (known[2:] - 2 * q + known[:-2]) / interval_s**2


def control_columns(names: Sequence[str]) -> list[str]:
    """The columns of the rates and accelerations of joints."""
    return [f"{name}_{what}" for what in ("rate_rad_s", "acceleration_rad_s2") for name in names]
