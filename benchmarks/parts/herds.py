"""Test the mixed model on simulated herds: variance components, intervals of effects and planned power.

    python benchmarks/parts/herds.py [--quick]

There are two groups of animals, with two runs of each animal and six strides per run. The standard deviations of
animals, runs, strides and measurement are known, and all clips share a lens error. The table has the estimated variance
components relative to the truth, as means over the herds, and how often 90 % intervals contain the effect and the mean
of the first group. To test the planned power, the simulated effect has the size that should be found in 80 % of such
herds, and `reached` is the fraction of herds in which it was found.

The designs are balanced, so the interval of the effect is exact without the lens error. Its coverage then differs from
90 % only by chance, with a standard deviation of 1 % for 1000 herds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from arguments import parser_of
from markdown_table import print_table
from scipy.stats import t

from recon.gait.mixed_model import LevelSigmas, MixedModel, fit_mixed_model, smallest_effect

TRUE = LevelSigmas(animal=0.30, run=0.20, stride=0.25, measurement=0.15)
RUNS, STRIDES, SHARED = 2, 6, 0.05
MEAN, POWER = 4.0, 0.8
LEVELS_SHOWN = "animal", "run", "stride"


def herd(rng: np.random.Generator, animals: int, effect: float) -> MixedModel:
    """Simulate one experiment, and return the mixed model fitted to it."""
    lens = 1 + SHARED * rng.normal()
    values, groups, names, runs = [], [], [], []
    for k in range(animals):
        group = k % 2
        animal = MEAN + effect * group + rng.normal(0, TRUE.animal)
        for j in range(RUNS):
            run = animal + rng.normal(0, TRUE.run) + rng.normal(0, TRUE.measurement)
            values += [*(lens * (run + rng.normal(0, TRUE.stride, STRIDES)))]
            groups += [group] * STRIDES
            names += [f"a{k}"] * STRIDES
            runs += [f"r{j}"] * STRIDES
    design = np.column_stack([np.ones(len(values)), groups])
    known = np.full(len(values), TRUE.measurement)
    return fit_mixed_model(np.array(values), design, ("all", "group"), names, runs, known)


def rows(herds: int) -> list[dict]:
    table = []
    for animals in (10, 20, 40, 60):
        effect = smallest_effect(TRUE, animals // 2, RUNS, STRIDES, wanted=POWER)
        rng = np.random.default_rng(animals)
        models = [herd(rng, animals, effect) for _ in range(herds)]
        limit = t.ppf(0.975, animals - 2)
        reached = np.mean([abs(model.effects[1]) / model.covariance[1, 1] ** 0.5 > limit for model in models])
        row: dict[str, object] = {"animals": animals, "herds": herds}
        for level in LEVELS_SHOWN:
            square = np.mean([getattr(model.sigmas, level) ** 2 for model in models])
            row[f"{level}, variance / true"] = f"{square / getattr(TRUE, level) ** 2:.2f}"
        row["effect in 90 % interval"] = f"{coverage(models, [0, 1], effect):.0%}"
        row["mean in 90 % interval"] = f"{coverage(models, [1, 0], MEAN):.0%}"
        row |= {"effect": f"{effect:.2f}", "power planned": f"{POWER:.0%}", "reached": f"{reached:.0%}"}
        table.append(row)
    return table


def coverage(models: Sequence[MixedModel], weights: Sequence[float], truth: float) -> float:
    """Return the fraction of the models whose 90 % interval of a sum of effects contains the truth."""
    intervals = [model.contrast(weights, SHARED) for model in models]
    return float(np.mean([low <= truth <= high for *_, low, high in intervals]))


def main() -> None:
    arguments = parser_of(__doc__, "--quick").parse_args()
    table = rows(40 if arguments.quick else 1000)
    print("### Simulated herds\n")
    print_table(list(table[0]), [row.values() for row in table])


if __name__ == "__main__":
    main()
