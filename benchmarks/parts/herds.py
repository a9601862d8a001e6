"""Simulate herds: variance components, intervals of effects and planned power of the mixed model.

    python benchmarks/parts/herds.py [--quick]

There are two groups of animals, two runs of each, and six strides per run; known standard deviations of animals, runs,
strides and measurement; and a lens error that all clips share. Components: the mean over herds, relative to the truth.
Intervals: how often 90 % intervals contain the effect. Power: planned, and how often the effect is found in as many
herds.
"""

from __future__ import annotations

import numpy as np
from arguments import parser_of
from markdown_table import print_table
from scipy.stats import t

from recon.gait.mixed_model import MixedModel, Variances, fit_mixed_model, power

TRUE = Variances(animal=0.30, run=0.20, stride=0.25, measurement=0.15)
RUNS, STRIDES, SHARED = 2, 6, 0.05


def herd(rng: np.random.Generator, animals: int, effect: float) -> MixedModel:
    """Return one simulated experiment, fitted."""
    lens = 1 + SHARED * rng.normal()
    values, groups, names, runs = [], [], [], []
    for k in range(animals):
        group = k % 2
        animal = 4.0 + effect * group + rng.normal(0, TRUE.animal)
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
        rng, effect = np.random.default_rng(animals), 0.5
        models = [herd(rng, animals, effect) for _ in range(herds)]
        squares = {level: np.mean([getattr(m.variances, level) ** 2 for m in models]) for level in LEVELS_SHOWN}
        intervals = [m.contrast(np.array([0.0, 1.0]), SHARED) for m in models]
        held = np.mean([low <= effect <= high for *_, low, high in intervals])
        freedom = animals - 2
        reached = np.mean([abs(m.effects[1]) / m.covariance[1, 1] ** 0.5 > t.ppf(0.975, freedom) for m in models])
        row = {"animals": animals, "herds": herds}
        row |= {
            f"{level}, variance / true": f"{square / getattr(TRUE, level) ** 2:.2f}"
            for level, square in squares.items()
        }
        row |= {"effect in 90 % interval": f"{held:.0%}"}
        row |= {"power planned": f"{power(effect, TRUE, animals // 2, RUNS, STRIDES):.0%}", "reached": f"{reached:.0%}"}
        table.append(row)
    return table


LEVELS_SHOWN = "animal", "run", "stride"


def main() -> None:
    arguments = parser_of(__doc__, "--quick").parse_args()
    table = rows(40 if arguments.quick else 300)
    print("### Made-up herds\n")
    print_table(list(table[0]), [row.values() for row in table])


if __name__ == "__main__":
    main()
