"""The answer of `recon compare`: tables of the comparison, of its mixed models, and of a planned experiment."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from textwrap import fill

import pandas as pd
from rich.table import Table

from recon.api.analysis_settings import CompareSettings
from recon.api.compare import FIGURE, GROUPS, QUANTITIES, Comparison, known_quantities, run_compare
from recon.api.experiment import MODEL, VARIANCES, Experiment
from recon.api.experiment_plan import PLAN, PlanTable, plan_experiment, read_plan, read_variances
from recon.base.errors import InputError, Problem
from recon.base.numbers import counted, interval, percent
from recon.base.progress import Progress
from recon.cli.answers import Answer, table_of
from recon.gait.mixed_model import LEVELS
from recon.show.page.compare_page import value_with_interval
from recon.show.page.own_page import COMPARE_PAGE


def compare_or_plan(settings: CompareSettings, progress: Progress) -> Answer:
    """Compare the clips, plan an experiment, or do both, and return the answer."""
    plan = read_plan(settings.plan) if settings.plan else None
    variances = _earlier_variances(settings)
    if plan is not None and (variances is not None or not settings.folders):
        return _planned(plan_experiment(plan, variances))
    comparison = run_compare(settings, progress)
    answer = _compared(comparison, settings.out or Path())
    if plan is None:
        return answer
    if comparison.experiment is None:
        raise InputError(
            Problem(PLAN, "variances", "clips of unknown animals", "--design or --names, which name the animals")
        )
    planned = _planned(plan_experiment(plan, comparison.experiment.variances))
    return Answer({**answer.data, **planned.data}, [*answer.lines, *planned.lines], notes=answer.notes)


def _compared(comparison: Comparison, out: Path) -> Answer:
    groups, notes, experiment = comparison.groups, comparison.notes, comparison.experiment
    data = {"groups": groups.to_dict("records"), "left_out": comparison.left_out, "notes": notes}
    lines = [*_lines(comparison.clips, groups, out)]
    if experiment is not None:
        data |= {"effects": experiment.effects.to_dict("records")}
        data |= {"variances": experiment.variances.to_dict("records")}
        lines[-2:-2] = _model_lines(experiment)
    return Answer(data, lines, notes=notes)


def _lines(clips: pd.DataFrame, groups: pd.DataFrame, out: Path) -> Iterator[str | Table]:
    levels, unit = clips["verdict"].value_counts(), "run" if "animal" in clips else "clip"
    yield f"{counted(len(clips), unit)}: " + ", ".join(f'{count} "{level}"' for level, count in levels.items())
    known = clips.groupby("group")[[*QUANTITIES]].count()
    rows = (
        (
            *map(
                str,
                (fill(row["group"], 20), QUANTITIES[quantity][0], known.loc[row["group"], quantity], row["strides"]),
            ),
            *_cells(*value_with_interval(row, quantity), row[f"{quantity}_spread"]),
        )
        for row in groups.to_dict("records")
        for quantity in QUANTITIES
    )
    yield table_of("group", "quantity", numbers=(f"{unit}s", "strides", "mean", "90 % interval", "spread"), rows=rows)
    yield (
        "The intervals include the error of the animal's size. Spread: one standard deviation "
        f"between the {unit}s, 0 if they differ by no more than their own uncertainties."
    )
    if missing := [QUANTITIES[quantity][0] for quantity in QUANTITIES if quantity not in known_quantities(clips)]:
        reason = "No clip has a complete stride: no" if not groups["strides"].sum() else "No clip has a known"
        yield f"{reason} {', '.join(missing)}."
    yield f"Rows by stride, clip and group (CSV and Parquet), and {FIGURE}, are in {out}."
    yield f"Open {out / COMPARE_PAGE} in a browser."


def _model_lines(experiment: Experiment) -> Iterator[str | Table]:
    if not experiment.models:
        return
    for quantity, effects in experiment.effects.groupby("quantity", sort=False):
        rows = [
            (row["effect"], *_value(row["value"], row["low"], row["high"]), *(str(row[name]) for name in _COUNTS))
            for row in effects.to_dict("records")
        ]
        numbers = "value", "90 % interval", *_COUNTS
        yield table_of("effect", numbers=numbers, rows=rows, title=QUANTITIES[str(quantity)][0])
    columns = [*(f"{level}_sd" for level in (*LEVELS, "measurement")), "icc", "smallest_detectable_change"]
    rows = [
        (QUANTITIES[row["quantity"]][0], *(_short(row[name]) for name in columns))
        for row in experiment.variances.to_dict("records")
    ]
    headings = (*LEVELS, "measurement", "ICC", "change")
    yield table_of("standard deviation", numbers=headings, rows=rows)
    yield (
        "ICC: intraclass correlation, the fraction of the variance of single strides that is between animals; change: "
        "the change between two runs that an unchanged animal exceeds in only 5 % of cases."
    )
    shared = max(model.shared for model in experiment.models)
    if shared:
        yield f"Intervals contain an error of ± {percent(shared)} (size, lens), which more clips do not reduce."
    yield f"The mixed model's numbers are in {MODEL} and {VARIANCES}."


FEW_ANIMALS = 15
"""Number of animals below which the variation between them is poorly known.

The relative error of a standard deviation from n animals is about 1 / sqrt(2 (n - 1)), 19 % for 15 animals.
"""
_COUNTS = "animals", "runs", "strides"


def _value(value: float, low: float, high: float) -> tuple[str, str]:
    text, _, ends = interval(value, low, high).partition(" (")
    return text, ends.rstrip(")")


def _short(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "-"


def _cells(mean: float, low: float, high: float, spread: float) -> tuple[str, ...]:
    if not math.isfinite(mean):
        return "-", "-", "-"
    text, ends = _value(mean, low, high)
    return text, ends or "-", _short(spread)


def _earlier_variances(settings: CompareSettings) -> pd.DataFrame | None:
    """Return the variances of an earlier comparison, or None unless --plan is given with only one folder."""
    if not settings.plan or len(settings.folders) != 1:
        return None
    (folder,) = settings.folders
    if (folder / VARIANCES).is_file():
        return read_variances(folder / VARIANCES)
    if (folder / GROUPS).is_file() and (folder / COMPARE_PAGE).is_file():  # a comparison without a mixed model
        raise InputError(Problem(folder, VARIANCES, "nothing", "a comparison made with --design or --names"))
    return None


def _planned(table: PlanTable) -> Answer:
    plan = table.plan
    sigmas = {level: getattr(table.sigmas, level) for level in (*LEVELS, "measurement")}
    data = {"effect": table.effect, "quantity": plan.quantity, "power": plan.power, "paired": plan.paired}
    data |= {"sd": sigmas, "icc": table.sigmas.icc, "plan": table.rows.to_dict("records")}
    return Answer({"plan": data}, _plan_lines(table, sigmas))


def _plan_lines(table: PlanTable, sigmas: dict[str, float]) -> Iterator[str | Table]:
    plan = table.plan
    title = QUANTITIES.get(plan.quantity, (plan.quantity, False))[0]
    groups = "two measurements of the same animals" if plan.paired else "two groups of animals"
    effect = f"a difference of {_short(table.effect)} in {title}"
    yield f"To detect {effect} between {groups} at a significance level of 5 %:"
    rows = (
        (
            *(str(int(row[name])) for name in ("runs", "strides", "cameras")),
            f"{row['animals']:.0f}" if row["animals"] else "over 1000",
            f"{row['clips']:.0f}" if row["animals"] else "-",
            percent(row["power"]) if row["animals"] else "-",
            *([_short(row["smallest_effect"])] if plan.animals else []),
        )
        for row in table.rows.to_dict("records")
    )
    per_group = "animals" if plan.paired else "animals in each group"
    headings = (
        "strides per run",
        "cameras",
        per_group,
        "clips",
        "power",
        *(["smallest effect"] if plan.animals else []),
    )
    yield table_of("runs per animal", numbers=headings, rows=rows)
    yield "Standard deviations: " + ", ".join(f"{level} {_short(sigma)}" for level, sigma in sigmas.items()) + "."
    if table.animals_known is not None and table.animals_known < FEW_ANIMALS:
        yield f"These variances come from {table.animals_known} animals, which is few: plan with a margin."
    if plan.animals:
        yield f"Smallest effect: the effect that these animals can show with a power of {percent(plan.power)}."
    yield "An error that all clips share (size, lens) changes every difference by the same factor, but not the power."
