"""Study the behaviour of the extended Jacobian with each cost, on a closed path followed many times.

Appendices B and C of C. van der Leek, MSc(Eng), University of Cape Town, 2022, contain costs on the joint angles for
which the method becomes singular or its paths chaotic. A cost is "convergent" if each turn ends at the angles at which
it began, "singular" if the extended matrix was singular on the way, "chaotic" if two starts that are `NEAR_RAD` apart
end `CHAOTIC_GROWTH` times as far apart, and "drifting" otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.base.arrays import Array
from recon.ik.chain import SerialChain
from recon.ik.costs import Cost
from recon.ik.drive import follow
from recon.ik.methods import ExtendedJacobian
from recon.ik.null_space import to_null_space_optimum

NEAR_RAD = 1e-6
"""Difference of every joint angle between the two starts whose paths are compared, rad."""
CLOSED_RAD = 1e-3
"""Largest change of a joint angle over one turn at which the path counts as closed, rad."""
CHAOTIC_GROWTH = 1e3
"""Maximum factor by which the distance between two paths grows if the motion does not count as chaotic."""
TURNS = 10
"""Number of times that the closed path is followed."""


@dataclass(frozen=True)
class CostOutcome:
    """Behaviour of the extended Jacobian with one cost on a closed path."""

    outcome: str
    """Class of the motion: convergent, singular, chaotic or drifting."""
    stationary: str
    """Kind of the stationary point at the start, or the reason why none was reached."""
    drift_rad: float
    """Largest change of a joint angle from the start to the end of any turn, rad."""
    growth: float
    """Factor by which the distance between the paths from two close starts grows."""
    singular_steps: int
    worst_error_m: float
    """Largest distance of the end effector from the path, metres."""
    limits_hit: tuple[str, ...]
    """Names of the joints that reached a limit."""


def cost_outcome(
    chain: SerialChain, q0: Array, path_m: Array, cost: Cost, interval_s: float, turns: int = TURNS
) -> CostOutcome:
    """Follow a closed path (K, dim) by the extended Jacobian with a cost, and classify the motion.

    The run starts at the stationary point of the cost that is reached from q0 (n,), rad.
    """
    method = ExtendedJacobian(cost)
    start, stationary = to_null_space_optimum(chain, q0, cost)
    run = follow(chain, start, path_m, method, turns, interval_s)
    near = follow(chain, start + NEAR_RAD, path_m, method, turns, interval_s)
    drift_rad = float(np.nanmax(np.abs(run.q[:: len(path_m) - 1] - run.q[0])))
    growth = float(np.nanmax(np.abs(near.q[-1] - run.q[-1]))) / NEAR_RAD
    if drift_rad < CLOSED_RAD:
        outcome = "convergent"
    elif run.singular.any():
        outcome = "singular"
    else:
        outcome = "chaotic" if growth > CHAOTIC_GROWTH else "drifting"
    return CostOutcome(
        outcome=outcome,
        stationary=stationary,
        drift_rad=drift_rad,
        growth=growth,
        singular_steps=int(run.singular.sum()),
        worst_error_m=float(run.distance_m.max()),
        limits_hit=tuple(run.limits),
    )
