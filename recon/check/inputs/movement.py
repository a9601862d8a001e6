"""What a motion cannot be, whatever made it so: an animal that stands still, runs backwards, or whose feet never stand.

A camera that pans or follows the animal leaves its limbs as they were, and changes how it goes over the ground. Feet
that stand in a real run then slide, all of them alike.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from recon.base.arrays import Array
from recon.check.codes import finding
from recon.fit import TrajectorySolution
from recon.fit.motion import Motion
from recon.fit.result import Finding
from recon.fit.terms import REFERENCE_HZ

LEAST_S = 0.25
"""Shorter motions say nothing."""
STILL, STILL_M_S, STILL_RAD_S = 0.95, 0.3, 0.6
"""An animal that stands still is not faster in so many frames, nor are its joints' angular speeds, by their median."""
BACKWARDS_M_S, BACKWARDS = 1.0, 0.9
"""No animal runs backwards as fast, for so much of a clip."""
SLOWEST = 0.1
"""The part of the feet, over all frames, that has the speeds of feet that stand, or less."""
SLIDE_M_S, GLIDE_M_S = -2.5, 8.0
"""Feet that stand are not as fast, backwards or forwards. 32 real views of running cheetahs: -0.7 to 4.1 m/s."""
PUSH_M_S2 = 12.0
"""No animal speeds up, brakes or turns as much for a whole clip: cheetahs reach 13 m/s^2 for moments (A. M. Wilson et
al., *Locomotion dynamics of hunting in wild cheetahs*, Nature 2013). A picture that zooms or pans seems to; so does a
clip without some of its frames. Up to 9.1 in 32 real views."""
JOLTS = {"root acceleration": 1.2, "heading": 0.55, "climb": 1.1}
"""Costs in 1/90 s, half squared sigmas, from which a body's path is no animal's; up to 0.5, 0.35 and 0.7 in real views,
and 0.8 of the first in the drawn film (benchmarks/wrong_inputs.py)."""


def movement(motion: Motion) -> Iterator[Finding]:
    """At most one: the clearest."""
    solution, posed = motion.solution, motion.solved
    assert isinstance(solution, TrajectorySolution)
    if posed.sum() < max(LEAST_S * motion.fps, 3):
        return
    forward, feet = _along(motion)
    turns = np.abs(np.diff(motion.states[:, 6:], axis=0)) * motion.fps
    speed = np.linalg.norm(np.gradient(solution.joints_m.mean(axis=1), axis=0), axis=1) * motion.fps
    if np.nanquantile(speed, STILL) < STILL_M_S and np.nanmedian(turns) < STILL_RAD_S:
        yield finding("animal_still", speed_m_s=float(np.nanmedian(speed)))
    elif np.mean(forward[np.isfinite(forward)] < -BACKWARDS_M_S) > BACKWARDS:
        yield finding("time_reversed", speed_m_s=-float(np.nanmedian(forward)))
    elif len(feet[0]) and not SLIDE_M_S < (slowest := float(np.nanquantile(feet, SLOWEST))) < GLIDE_M_S:
        yield finding("camera_moves", slide_m_s=slowest, speed_m_s=float(np.nanmedian(forward)))
    elif (push := _push_m_s2(motion)) > PUSH_M_S2:
        yield finding("path_pushed", push_m_s2=push)
    else:
        frames = REFERENCE_HZ * float(posed.sum()) / motion.fps
        costs = {name: float(solution.cost_by_term.get(name, 0.0)) / frames for name in JOLTS}
        worst = max(JOLTS, key=lambda name: costs[name] / JOLTS[name])
        if costs[worst] > JOLTS[worst]:
            yield finding("path_jolts", of=worst, cost=costs[worst])


def _push_m_s2(motion: Motion) -> float:
    """The body's mean acceleration over the ground, that of the parabola through its path."""
    time_s, path_m = motion.time_s[motion.solved], motion.solution.joints_m[motion.solved, :, :2].mean(axis=1)
    return 2.0 * float(np.linalg.norm(np.polyfit(time_s - time_s.mean(), path_m, 2)[0]))


def _along(motion: Motion) -> tuple[Array, Array]:
    """Speeds (T,) of the body and (T, F) of the feet along the trunk, over the ground; NaN without a pose."""
    rear, front = motion.forward
    joints_m = motion.solution.joints_m
    trunk = (joints_m[:, front] - joints_m[:, rear])[:, :2]
    trunk = trunk / np.maximum(np.linalg.norm(trunk, axis=1, keepdims=True), 1e-9)
    velocity = np.gradient(joints_m, axis=0)[..., :2] * motion.fps
    along = np.einsum("tja,ta->tj", velocity, trunk)
    return along.mean(axis=1), along[:, motion.feet]
