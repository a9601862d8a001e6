"""Plan an experiment: how many animals, runs, strides and cameras an effect needs.

Variances come from an earlier comparison (`variances.csv`), or are given. An error that all clips share changes an
effect by the same factor in every clip, so it does not change the power.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import product
from pathlib import Path

import pandas as pd

from recon.api.experiment import SPEED
from recon.base.documents import damage_as_input_error
from recon.base.errors import InputError, Problem, raise_problems
from recon.gait.mixed_model import LEVELS, LevelSigmas, animals_needed, power, smallest_effect
from recon.io.common import text_rows

PLAN = "--plan"
COUNTS = "runs", "strides", "cameras"
_SIGMAS = *LEVELS, "measurement"
_WORDS = "effect", "quantity", "power", "animals", *COUNTS, "paired", *_SIGMAS, "mean"
_EXAMPLE = "effect=0.3 animal=0.4 run=0.2 stride=0.2 measurement=0.15, in the unit of the quantity"
_USUAL: Mapping[str, tuple[int, ...]] = {"runs": (1, 2), "strides": (3, 10), "cameras": (1, 2)}
"""Numbers of runs, strides and cameras to try if the plan gives none."""


@dataclass(frozen=True)
class Plan:
    """Effect to detect, and the numbers of animals, runs, strides and cameras to calculate with."""

    effect: float
    """Difference between two groups, in the unit of the quantity or relative to the mean."""
    is_relative: bool
    variances: Mapping[str, float]
    """Given standard deviations, keyed by "animal", "run", "stride" and "measurement"."""
    mean: float | None = None
    quantity: str = SPEED
    power: float = 0.8
    animals: int | None = None
    """Animals in each group; None to find how many are needed."""
    paired: bool = False
    counts: Mapping[str, tuple[int, ...]] | None = None
    """Numbers of runs, strides and cameras to try."""


@dataclass(frozen=True)
class PlanTable:
    """Numbers of animals that an effect needs, for each number of runs, strides and cameras."""

    plan: Plan
    effect: float
    """Difference between two groups, in the unit of the quantity."""
    sigmas: LevelSigmas
    animals_known: int | None
    """Number of animals that the variances come from; None if the variances were given."""
    rows: pd.DataFrame
    """Table of runs, strides, cameras, animals in a group (0 for more than 1000), clips, power and smallest effect."""


def read_plan(texts: Sequence[str]) -> Plan:
    """Return the plan that strings such as "effect=0.3 power=0.9" describe.

    Raises
    ------
    InputError
        If words of the strings cannot be used. The message lists all of these words.
    """
    values, problems = {}, []
    for word in " ".join(texts).split():
        name, equals, text = word.partition("=")
        if not equals or name not in _WORDS:
            meant = get_close_matches(name, _WORDS, 1)
            expected = f"a known word, perhaps {meant[0]}=..." if meant else f"words such as {_EXAMPLE}"
            problems.append(Problem(PLAN, "plan", repr(word), expected))
        values[name] = text
    raise_problems(problems)
    if "effect" not in values:
        raise InputError(Problem(PLAN, "effect", "nothing", "the difference to find, such as effect=0.3 or effect=10%"))

    def number(name: str, text: str, low: float = 0.0, high: float = float("inf"), expected: str = "") -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low < value < high:
            problems.append(Problem(PLAN, name, repr(text), expected or "a number above 0"))
        return value

    def whole(name: str, text: str) -> int:
        if not (text.isdecimal() and int(text) > 0):
            problems.append(Problem(PLAN, name, repr(text), "a whole number above 0"))
            return 1
        return int(text)

    effect_text = values["effect"]
    is_relative = effect_text.endswith("%")
    effect = number("effect", effect_text.removesuffix("%")) * (0.01 if is_relative else 1.0)
    if values.get("paired", "no") not in ("yes", "no"):
        problems.append(Problem(PLAN, "paired", repr(values["paired"]), "yes or no"))
    sigmas = {name: number(name, values[name], -1e-12) for name in _SIGMAS if name in values}
    counts = {name: tuple(whole(name, text) for text in values[name].split(",")) for name in COUNTS if name in values}
    plan = Plan(
        effect,
        is_relative,
        sigmas,
        mean=number("mean", values["mean"]) if "mean" in values else None,
        quantity=values.get("quantity", SPEED),
        power=number("power", values.get("power", "0.8"), 0.05, 1.0, "a number between 0.05 and 1"),
        animals=whole("animals", values["animals"]) if "animals" in values else None,
        paired=values.get("paired") == "yes",
        counts=counts,
    )
    raise_problems(problems)
    return plan


def read_variances(path: Path) -> pd.DataFrame:
    """Return the table of variances of an earlier comparison.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    rows = [cells for _, cells in text_rows(path)]
    table = [dict(zip(rows[0], cells, strict=False)) for cells in rows[1:]] if rows else []
    with damage_as_input_error(path, "the table that recon compare writes"):
        numbers = ("mean", "animals", *(f"{level}_sd" for level in _SIGMAS))
        return pd.DataFrame([{"quantity": row["quantity"], **{n: float(row[n]) for n in numbers}} for row in table])


def plan_experiment(plan: Plan, variances: pd.DataFrame | None = None) -> PlanTable:
    """Return how many animals an effect needs for each number of runs, strides and cameras.

    Parameters
    ----------
    plan : Plan
        The effect to detect, and the numbers that are known or to be tried.
    variances : DataFrame, optional
        Variances of an earlier comparison, one row for each quantity. Variances in the plan take precedence.

    Raises
    ------
    InputError
        If a variance or the mean is not known.
    """
    earlier, problems = None, []
    if variances is not None:
        rows = {str(row["quantity"]): row for row in variances.to_dict("records")}
        earlier = rows.get(plan.quantity)
        if earlier is None:
            raise InputError(Problem(PLAN, "quantity", plan.quantity, f"one of {', '.join(rows) or 'none'}"))
    sigmas = {}
    for level in _SIGMAS:
        if level in plan.variances:
            sigmas[level] = plan.variances[level]
        elif earlier is not None:
            sigmas[level] = float(earlier[f"{level}_sd"])
        elif level == "measurement":
            sigmas[level] = 0.0
        else:
            expected = f"standard deviations of all levels, as in {_EXAMPLE}; or the folder of an earlier comparison"
            problems.append(Problem(PLAN, level, "nothing", expected))
    mean = plan.mean if plan.mean is not None or earlier is None else float(earlier["mean"])
    if plan.is_relative and mean is None:
        problems.append(Problem(PLAN, "mean", "nothing", "the quantity's mean, as the effect is given in %"))
    raise_problems(problems)
    effect = plan.effect * (abs(mean) if plan.is_relative and mean is not None else 1.0)
    known = LevelSigmas(**sigmas)
    tried = {name: (plan.counts or {}).get(name, _USUAL[name]) for name in COUNTS}
    rows = [_row(plan, effect, known, *numbers) for numbers in product(*tried.values())]
    animals_known = None if earlier is None else int(earlier["animals"])
    return PlanTable(plan, effect, known, animals_known, pd.DataFrame(rows))


def _row(plan: Plan, effect: float, sigmas: LevelSigmas, runs: int, strides: int, cameras: int) -> dict[str, float]:
    numbers = runs, strides, cameras
    animals = plan.animals or animals_needed(effect, sigmas, *numbers, plan.power, plan.paired) or 0
    row: dict[str, float] = {"runs": runs, "strides": strides, "cameras": cameras, "animals": animals}
    row["clips"] = 2 * animals * runs * cameras
    row["power"] = power(effect, sigmas, animals, *numbers, plan.paired)
    row["smallest_effect"] = smallest_effect(sigmas, animals, *numbers, plan.power, plan.paired)
    return row
