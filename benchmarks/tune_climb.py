"""Tunes the fields of the climbs and searches footfalls for them: makes the recipes that come with the package.

    python benchmarks/tune_climb.py [RECIPE ...] [--out FOLDER]

The published work does not print its field parameters, where its robot stands at first, nor the angles of its paths.
Here they are chosen so that the least margin of the climb, over all frames and all rules, is as large as can be found
(`climb_search.py`, linear programs by scipy). Every run starts from the numbers of `seed`, nothing is random:

- published-50: the published footfalls; fields, stance and angles tuned.
- published-35: the same for a step of 35 mm, heights in proportion, from published-50.
- found-50: forward lengths of the footfalls searched too.
- spatial-50: the same, and the torso rolls and yaws, from found-50.
- highest: the highest step for which a climb is found, from published-35, raised little by little.
- highest-spatial: the same with six degrees of freedom, from spatial-50.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from climb_search import Found, highest, improve

from recon.robotics.climb import Recipe, Walker, check, load_recipe, plan, raised, save_recipe
from recon.robotics.climb.equilibrium import TorsoDynamics
from recon.robotics.climb.fields import PLANAR, SPATIAL, Fields, Stand, Well, evaluate
from recon.robotics.climb.paths import Step
from recon.robotics.climb.recipe import RECIPES, Footfall, Primitive, Swing
from recon.robotics.robot.robot_file import load_robot

ROBOT = "aibo"
PACE = 0.95
COMMAND = "python benchmarks/tune_climb.py"

PUBLISHED_STEP_M = 0.05
PUBLISHED = {
    "front-up": ((2, 65, 0), (1, 70, 50), (3, 70, 50), (4, 60, 0)),
    "move-forward": ((1, 70, 0), (3, 70, 0), (2, 70, 0), (4, 60, 0)),
    "rear-up": ((1, 85, 0), (2, 75, 50), (3, 85, 0), (4, 60, 50)),
}
"""Leg, from 1 as in `LEGS`; forward and up, mm (D. Cohen, SUNFEST, University of Pennsylvania, 2005). The heights in
rear-up are printed as 0, 30, -10, 30 mm, with the plastic casings of the feet; here feet are points: 0, 50, 0, 50."""


def published(step_m: float) -> dict[str, tuple[Footfall, ...]]:
    """The published footfalls by primitive, their heights in proportion to the step's."""
    ratio = step_m / PUBLISHED_STEP_M
    return {
        name: tuple(Footfall(leg - 1, forward / 1000, up / 1000 * ratio) for leg, forward, up in falls)
        for name, falls in PUBLISHED.items()
    }


def seed() -> Recipe:
    """A plausible start: legs 118 mm long, feet 10 mm outside the hips, the step 27 mm before the front feet."""
    fields = Fields(
        radial=Well(gain=1.0, natural=0.118, least=0.1, most=0.135, low=125.0, high=125.0),
        swing=Well(gain=0.002, natural=0.0, least=-0.6, most=0.6, low=8.0, high=8.0),
        flap=Well(gain=0.002, natural=0.1, least=-0.1, most=0.4, low=8.0, high=8.0),
        balance_gain=0.2,
        balance_sharpness=50.0,
    )
    return Recipe(
        ROBOT,
        Step(edge_m=0.092, height_m=PUBLISHED_STEP_M),
        np.array([[-0.072, 0.065], [-0.072, -0.065], [0.072, 0.065], [0.072, -0.065]]),
        tuple(Primitive(name, falls, fields, 1.4, 1.4) for name, falls in published(PUBLISHED_STEP_M).items()),
        Swing(),
        TorsoDynamics(mass=60.0, inertia=0.25, max_step_m=0.003, max_turn_rad=0.03, dofs=PLANAR),
        50.0,
        "",
    )


def finished(walker: Walker, recipe: Recipe) -> Recipe:
    """With a mass and an inertia for which riding is stable, that of the stiffest frame of the climb, and so slow that
    no joint needs more than `PACE` of its rate."""
    climb, dofs, arm = plan(walker, recipe), list(recipe.motion.dofs), recipe.motion.arm_m
    scale = np.array([1, 1, 1, 1 / arm, 1 / arm, 1 / arm])[dofs]
    stiffest = 0.0
    for k in range(len(climb)):
        planted = np.arange(4) != climb.lifted[k]
        stand = Stand(walker.hips_m, walker.side, climb.feet_m[k], climb.feet_m[k][planted, :2].mean(axis=0))
        fields = recipe.primitives[climb.primitive[k]].fields
        jacobian = evaluate(fields, stand, climb.position_m[k], climb.rotation[k]).jacobian
        stiffness = -jacobian[np.ix_(dofs, dofs)] * scale[:, None] * scale
        stiffest = max(stiffest, float(np.linalg.eigvalsh(stiffness + stiffness.T).max()) / 2)
    share, swing = check(climb).rate_share, recipe.swing
    slower = PACE / share if np.isfinite(share) else 1.0  # an angle that is out of reach has no rate
    speeds = {n: slower * getattr(swing, n) for n in ("rise_m_s", "traverse_m_s", "lower_m_s")}
    return replace(
        recipe,
        motion=replace(recipe.motion, mass=stiffest, inertia=stiffest * arm**2),
        swing=replace(swing, **speeds),
        fps=slower * recipe.fps,
    )


def made(name: str, walker: Walker, load: Callable[[str], Recipe]) -> Found:
    if name == "published-50":
        return improve(walker, seed(), footfalls=False, tell=print)
    if name == "published-35":
        return improve(walker, raised(load("published-50"), 0.035), footfalls=False, tell=print)
    if name == "found-50":
        return improve(walker, seed(), tell=print)
    if name == "spatial-50":
        found = load("found-50")
        return improve(walker, replace(found, motion=replace(found.motion, dofs=SPATIAL)), rounds=15, tell=print)
    return highest(walker, load("published-35" if name == "highest" else "spatial-50"), tell=print)


NAMES = ("published-50", "published-35", "found-50", "spatial-50", "highest", "highest-spatial")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipes", nargs="*", help=f"of {', '.join(NAMES)}; all without any")
    parser.add_argument("--out", type=Path, default=RECIPES)
    arguments = parser.parse_args()
    walker = Walker.of(load_robot(ROBOT))
    for name in arguments.recipes or NAMES:
        if name not in NAMES:
            parser.error(f"{name}: expected {', '.join(NAMES)}")
        print(name, flush=True)
        found = made(name, walker, lambda other: load_recipe(arguments.out / f"{other}.toml"))
        recipe = replace(finished(walker, found.recipe), made_by=f"{COMMAND} {name}")
        result = check(plan(walker, recipe))
        print(f"{name}: least margin {found.least:.3f} ({found.kind}), {found.climbs} climbs computed")
        print("\n".join(result.problems()) or "valid in every frame")
        save_recipe(recipe, arguments.out / f"{name}.toml")


if __name__ == "__main__":
    main()
