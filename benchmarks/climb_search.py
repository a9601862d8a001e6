"""Footfalls, stance and fields for a step of a given height, so that the least margin of the climb is the largest.

All margins of all frames of a coarse climb, each in units of its kind (`margins.RULES`), are taken as functions of the
design; the climb is raised by a sequence of linear programs, each maximising the least margin of the linearised climb
within a trust region (scipy, HiGHS). The derivatives are differences: one batch of climbs, each with one number moved,
whose equilibria are solved together from those of the climb in the middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from climb_design import Design, Numbers, sampled
from numpy.typing import NDArray
from scipy.optimize import linprog

from recon.robotics.climb.check import check
from recon.robotics.climb.equilibrium import Torso, TorsoDynamics, between, moved, solve
from recon.robotics.climb.fields import Stand, evaluate
from recon.robotics.climb.margins import NONE, RULES, margins
from recon.robotics.climb.paths import Step, along, corners
from recon.robotics.climb.plan import plan
from recon.robotics.climb.plan import start as begin
from recon.robotics.climb.recipe import Recipe, raised
from recon.robotics.climb.walker import Walker

Array = NDArray[np.float64]

SAMPLES = (7, 9, 7)
"""Of the three phases of a foot's path."""
SHIFTS = (0.25, 0.5, 0.75)
"""Of the way of the torso from one footfall to the next."""
LONGEST_M, PACE_M = 0.015, 0.006
"""How far the torso may move from sample to sample while a foot is up, turns included, and the unit of that margin."""
SOFT, STIFF = 0.05, 0.1
"""The least stiffness, over that of a leg at its natural length, and the unit of that margin: where an equilibrium is
about to vanish the torso would jump."""
DIFFERENCE = 0.003
"""Of a design number, in units of its scale."""
SMALLEST_TRUST, LARGEST_TRUST, SMALLEST_GAIN = 0.01, 4.0, 1e-4
FAR = 4.0
"""Margins this much larger than the least, in units of their kinds, are left out of a linear program."""


class Coarse(NamedTuple):
    """The climbs of N designs: margins (N, K) in units of their kinds; settled: whether all equilibria were found."""

    margins: Array
    kinds: NDArray[np.str_]
    settled: bool

    @property
    def least(self) -> float:
        """Of the first design."""
        return float(self.margins[0].min())

    @property
    def worst(self) -> str:
        """The kind of its least margin."""
        return str(self.kinds[int(self.margins[0].argmin())])


def tracked(walker: Walker, design: Design, vector: Array) -> Torso:
    """Equilibria (S,) of one design (n,), from sample to sample as `plan` finds them from frame to frame."""
    r, n = design.recipe_of(vector), design.read(vector[None])
    feet, lifted, primitive = _flights(r, n)
    torso, rows = begin(walker, r)[0], []
    for k in range(len(lifted)):
        stand = _stand(walker, feet[0, k][None], lifted[k][None])
        one = Stand(stand.hips_m, stand.side, stand.feet_m[0], stand.target_m[0])
        torso = solve(r.primitives[primitive[k]].fields, one, torso, r.motion).torso
        rows.append(torso)
    return Torso(*(np.array(column) for column in zip(*rows, strict=True)))


def coarse(walker: Walker, design: Design, vectors: Array, start: Torso) -> Coarse:
    """The climbs of the designs (N, n), in a few samples a footfall. start (S,): the equilibria of one near by."""
    n, r = design.read(vectors), design.recipe
    falls, per = r.footfalls, sum(SAMPLES)
    feet, lifted, primitive = _flights(r, n)
    stand = _stand(walker, feet, lifted)
    fields = sampled(r, n, primitive)
    held = solve(fields, stand, start, r.motion)

    # From footfall to footfall the torso goes straight from one equilibrium to the next, all feet planted.
    ends = np.arange(len(falls) + 1) * per
    begins = ends + 1
    a = Torso(held.torso.position_m[:, ends], held.torso.rotation[:, ends])
    b = Torso(held.torso.position_m[:, begins], held.torso.rotation[:, begins])
    way = between(a, b)
    shifts = [moved(a, share * way) for share in SHIFTS]
    torso = Torso(*(np.concatenate(parts, axis=1) for parts in zip(held.torso, *shifts, strict=True)))
    every_feet = np.concatenate([feet, *([feet[:, ends]] * len(SHIFTS))], axis=1)
    every_lifted = np.concatenate([lifted, np.full(len(SHIFTS) * len(ends), NONE)])
    step = Step(n.edge_m[:, None, None], r.step.height_m)  # pyright: ignore[reportArgumentType]
    found = margins(walker, step, torso, every_feet, every_lifted)
    scaled = {name: found[name].reshape(len(vectors), -1) / rule.scale for name, rule in RULES.items()}
    ahead = between(
        Torso(held.torso.position_m[:, :-1], held.torso.rotation[:, :-1]),
        Torso(held.torso.position_m[:, 1:], held.torso.rotation[:, 1:]),
    )
    ahead[..., 3:] *= r.motion.arm_m
    in_flight = lifted[1:] == lifted[:-1]
    scaled["pace"] = (LONGEST_M - np.linalg.norm(ahead[:, in_flight], axis=-1)) / PACE_M
    scaled["stiffness"] = (_softest(evaluate(fields, stand, *held.torso).jacobian, r.motion) - SOFT) / STIFF
    kinds = np.concatenate([np.full(x.shape[1], name) for name, x in scaled.items()])
    return Coarse(np.concatenate([*scaled.values()], axis=1), kinds, bool(held.settled.all()))


def _softest(jacobian: Array, motion: TorsoDynamics) -> Array:
    """(...): the least eigenvalue of the stiffness."""
    dofs = list(motion.dofs)
    scale = np.array([1.0] * 3 + [1 / motion.arm_m] * 3)[dofs]
    stiffness = -jacobian[(..., *np.ix_(dofs, dofs))] * scale[:, None] * scale
    return np.linalg.eigvalsh((stiffness + np.swapaxes(stiffness, -1, -2)) / 2)[..., 0].astype(np.float64)


def _flights(recipe: Recipe, n: Numbers) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Feet (N, S, 4, 3), lifted leg (S,) and primitive (S,): the first stance, the feet's paths and the last stance."""
    s = recipe.swing
    feet = np.concatenate([n.stance_m, np.zeros((*n.stance_m.shape[:2], 1))], axis=-1)
    blocks, lifted, primitive, k = [feet[:, None]], [NONE], [0], 0
    for which, p in enumerate(recipe.primitives):
        for f in p.footfalls:
            end = feet[:, f.leg].copy()
            end += np.array([f.sideways_m, 0.0, f.up_m])
            end[:, 1] += n.forward_m[:, k]
            path = corners(feet[:, f.leg], end, s.clearance_m, n.rise_rad[:, which], n.lower_rad[:, which])
            points = [along(path, j, np.arange(c) / (c - (j == 2))) for j, c in enumerate(SAMPLES)]  # the end once
            block = np.repeat(feet[:, None], sum(SAMPLES), axis=1)
            block[:, :, f.leg] = np.concatenate(points, axis=1)
            blocks.append(block)
            lifted += [f.leg] * sum(SAMPLES)
            primitive += [which] * sum(SAMPLES)
            feet = feet.copy()
            feet[:, f.leg] = end
            k += 1
    blocks.append(feet[:, None])
    return np.concatenate(blocks, axis=1), np.array([*lifted, NONE]), np.array([*primitive, primitive[-1]])


def _stand(walker: Walker, feet: Array, lifted: NDArray[np.int64]) -> Stand:
    planted = (lifted[:, None] != np.arange(4)).astype(float)
    target = (feet[..., :2] * planted[..., None]).sum(axis=-2) / planted.sum(axis=-1)[:, None]
    return Stand(walker.hips_m, walker.side, feet, target)


@dataclass(frozen=True, eq=False)
class Found:
    """recipe; least: the least margin of its coarse climb, in units of its kind; kind: which; rounds, climbs: how many
    linear programs were solved, and climbs computed."""

    recipe: Recipe
    least: float
    kind: str
    rounds: int
    climbs: int


def improve(
    walker: Walker,
    recipe: Recipe,
    footfalls: bool = True,
    rounds: int = 40,
    enough: float = np.inf,
    tell: Callable[[str], None] | None = None,
) -> Found:
    """The recipe with numbers that make its least margin larger. footfalls: whether they may change too; enough: the
    margin at which to stop."""
    design = Design.of(recipe, footfalls)
    x = np.clip(design.vector(), *design.bounds())
    torso = tracked(walker, design, x)
    now = coarse(walker, design, x[None], torso)
    climbs, trust, k = 1, 1.0, 0
    while k < rounds and trust > SMALLEST_TRUST and now.least < enough:
        k += 1
        near = np.flatnonzero(now.margins[0] < now.least + FAR + 2 * trust)
        beside = coarse(walker, design, x + np.eye(len(x)) * DIFFERENCE, torso)
        climbs += len(x)
        slope = (beside.margins[:, near] - now.margins[0, near]).T / DIFFERENCE
        while trust > SMALLEST_TRUST:
            step = _program(slope, now.margins[0, near], x, design, trust)
            there = tracked(walker, design, x + step)
            then = coarse(walker, design, (x + step)[None], there)
            climbs += 1
            gain, promised = then.least - now.least, float((now.margins[0, near] + slope @ step).min()) - now.least
            if then.settled and gain > SMALLEST_GAIN:
                trust = (
                    min(LARGEST_TRUST, 1.7 * trust)
                    if gain > promised / 2
                    else trust / (2 if gain < promised / 5 else 1)
                )
                x, now, torso = x + step, then, there
                break
            trust /= 2
        if tell:
            tell(f"round {k}: least margin {now.least:.3f} ({now.worst}), trust {trust:.3f}")
    return Found(design.recipe_of(x), now.least, now.worst, k, climbs)


def _program(slope: Array, value: Array, x: Array, design: Design, trust: float) -> Array:
    """The step (n,) that makes the least of the linearised margins largest."""
    n, order, (low, high) = len(x), design.order(), design.bounds()
    found = linprog(
        np.r_[np.zeros(n), -1.0],
        A_ub=np.block([[-slope, np.ones((len(value), 1))], [-order, np.zeros((len(order), 1))]]),
        b_ub=np.r_[value, np.maximum(order @ x, 0.0)],
        bounds=[*zip(np.maximum(low - x, -trust), np.minimum(high - x, trust), strict=True), (None, None)],
        method="highs",
    )
    return np.zeros(n) if found.x is None else found.x[:n]


def highest(
    walker: Walker,
    recipe: Recipe,
    by_m: float = 0.004,
    least_m: float = 0.001,
    rounds: int = 10,
    tell: Callable[[str], None] | None = None,
) -> Found:
    """A recipe for the highest step that is found: that of the recipe, raised again and again by by_m, with so many
    rounds for each height, and by half as much where no valid climb is found (planned frame by frame), down to
    least_m."""
    best = improve(walker, recipe, rounds=rounds)
    count, climbs = best.rounds, best.climbs
    while by_m >= least_m:
        there = improve(walker, raised(best.recipe, best.recipe.step.height_m + by_m), rounds=rounds)
        count, climbs = count + there.rounds, climbs + there.climbs
        if tell:
            height, least = there.recipe.step.height_m * 1000, there.least
            tell(f"{height:.1f} mm: least margin {least:.3f} ({there.kind}), {climbs} climbs")
        if there.least > 0 and check(plan(walker, there.recipe)).valid:
            best = there
        else:
            by_m /= 2
    return replace(best, rounds=count, climbs=climbs)
