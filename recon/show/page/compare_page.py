"""Make the page of a comparison, with a plot of each measure, the groups' numbers, and a table of the clips."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd

from recon.base.numbers import counted, interval
from recon.fit.result import LEVELS
from recon.gait.stances import interval_of
from recon.show.page.pages import rendered
from recon.show.page.scripts import script

HEIGHT, TOP, BOTTOM, LEFT, RIGHT = 250.0, 10.0, 52.0, 46.0, 8.0
"""Height and margins of a plot in pixels; the lower margin has the groups' names and numbers of clips."""
WIDTH, GROUP_WIDTH = 274.0, 84.0
"""Smallest width in pixels of a plot, and of a group's column in the plot."""
LABEL_CHARACTERS, LABEL_LINES = 12, 2
HUES = ("left", "right", "middle", "strong")
"""Names of the style sheet's colours for successive groups."""


def compare_page(
    title: str,
    clips: pd.DataFrame,
    groups: pd.DataFrame,
    measures: Mapping[str, str],
    pages: Mapping[str, str],
    errors_px: Mapping[str, float],
    notes: Sequence[str] = (),
    group_by: str = "",
    effects: pd.DataFrame | None = None,
    variances: pd.DataFrame | None = None,
) -> str:
    """Return the HTML page of a comparison.

    Parameters
    ----------
    title
        The comparison's name.
    clips
        Table with the columns group, clip, verdict and strides, and each measure with its standard deviation
        (`_sigma`). Lines join the clips of an animal in several groups if there is a column `animal`.
    groups
        Table with the columns group, clips and strides, and each measure's mean and standard deviation. The ends of its
        90 % interval may be given as `_low` and `_high`.
    measures
        Title with unit for each column of a measure.
    pages
        Address of each clip's page.
    errors_px
        Median keypoint error of each clip in pixels.
    notes
        Sentences on clips that were left out.
    group_by
        Name of the property by which clips are grouped, or an empty string if it is unknown.
    effects, variances
        Tables of the mixed models, with the columns of `mixed_model.csv` and `variances.csv`.
    """
    order = {str(row["group"]): place for place, row in enumerate(groups.to_dict("records"))}
    clip_rows = [_clip_row(row, measures, pages, errors_px, order) for row in clips.to_dict("records")]
    counter = Counter(row["verdict"] or "no verdict" for row in clip_rows)
    levels = [f"{counter[level]} {level}" for level in dict.fromkeys((*reversed(LEVELS), *counter)) if counter[level]]
    strides = counted(int(clips["strides"].sum()), "stride")
    unit = "clip" if effects is None else "run"
    return rendered(
        "compare.html",
        title=f"Comparison by {group_by}" if group_by else "Comparison",
        subtitle=f"{title}: {counted(len(clips), unit)}, {', '.join(levels)}; {strides}",
        group_by=group_by or "group",
        grouped=len(groups) > 1,
        groups=[_group_row(row, clips, measures) for row in groups.to_dict("records")],
        group_names=list(order),
        clips=sorted(clip_rows, key=lambda row: (row["place"], row["clip"])),
        measures=measures,
        plots=[plot for name in measures if (plot := _plot(name, measures[name], clips, groups, pages)) is not None],
        no_pages=[row["clip"] for row in clip_rows if not row["page"]],
        notes=notes,
        effects=[] if effects is None else [_effect_row(row, measures) for row in effects.to_dict("records")],
        variances=[] if variances is None else [_variance_row(row, measures) for row in variances.to_dict("records")],
        unit=unit,
        script=script("table", "batch"),
    )


def value_with_interval(row: Mapping[Any, Any], name: str) -> tuple[float, float, float]:
    """Return a value of a clip or a group and the ends of its 90 % interval, NaN if unknown.

    The interval comes from the columns `_low` and `_high`, otherwise from the standard deviation in `_sigma`. Its lower
    end is at least 0, because no measure is negative.
    """
    value, sigma = float(row[name]), float(row[f"{name}_sigma"])
    low, high = (row.get(f"{name}{end}", math.nan) for end in ("_low", "_high"))
    if pd.isna(low) or pd.isna(high):
        _, low, high = interval_of(value, sigma)
        low = low if math.isnan(low) else max(low, 0.0)
    return value, float(low), float(high)


def _text(value: float, low: float, high: float) -> list[str]:
    """Return a value and its interval as strings, or an empty list for an unknown value."""
    if not math.isfinite(value):
        return []
    number, _, ends = interval(value, low, high).partition(" (")
    return [number, f"({ends}"] if ends else [number]


def _clip_row(
    row: Mapping[Any, Any],
    measures: Mapping[str, str],
    pages: Mapping[str, str],
    errors_px: Mapping[str, float],
    order: Mapping[str, int],
) -> dict[str, Any]:
    clip, error_px = str(row["clip"]), errors_px.get(str(row["clip"]), math.nan)
    return {
        "clip": clip,
        "group": str(row["group"]),
        "place": order[str(row["group"])],
        "verdict": row["verdict"],
        "page": pages.get(clip),
        "strides": int(row["strides"]),
        "error_px": f"{error_px:.1f}" if math.isfinite(error_px) else "",
        "values": {
            name: {
                "sort": f"{row[name]:.6g}" if math.isfinite(row[name]) else "",
                "text": _text(*value_with_interval(row, name)),
            }
            for name in measures
        },
    }


def _group_row(row: Mapping[Any, Any], clips: pd.DataFrame, measures: Mapping[str, str]) -> dict[str, Any]:
    """Return the mean of each measure in a group with its interval, the median over clips, and the number of clips."""
    group_clips = clips[clips["group"] == row["group"]]
    values = {}
    for name in measures:
        known = group_clips[name].dropna()
        value, low, high = value_with_interval(row, name)
        digits = interval(value, low, high).partition(" ")[0].partition(".")[2] if math.isfinite(value) else ""
        median_text = f"{known.median():.{len(digits)}f}" if len(known) else ""
        values[name] = {"text": _text(value, low, high), "median": median_text, "clips": len(known)}
    return {"group": str(row["group"]), "clips": int(row["clips"]), "strides": int(row["strides"]), "values": values}


def _effect_row(row: Mapping[Any, Any], measures: Mapping[str, str]) -> dict[str, Any]:
    """Return an effect of a mixed model with its interval and the numbers of animals, runs, clips and strides."""
    value, low, high = (float(row[name]) for name in ("value", "low", "high"))
    counts = [int(row[name]) for name in ("animals", "runs", "clips", "strides")]
    is_difference = not str(row["effect"]).startswith("mean of ")
    return {
        "measure": measures[row["quantity"]],
        "effect": row["effect"],
        "text": _text(value, low, high),
        "counts": counts,
        "excludes_zero": is_difference and (low > 0 or high < 0),
    }


def _variance_row(row: Mapping[Any, Any], measures: Mapping[str, str]) -> dict[str, Any]:
    names = "animal_sd", "run_sd", "stride_sd", "measurement_sd", "smallest_detectable_change"
    numbers = [f"{float(row[name]):.2g}" for name in names]
    icc = float(row["icc"])
    return {"measure": measures[row["quantity"]], "numbers": numbers, "icc": f"{icc:.2f}" if math.isfinite(icc) else ""}


def _plot(
    name: str, title: str, clips: pd.DataFrame, groups: pd.DataFrame, pages: Mapping[str, str]
) -> dict[str, Any] | None:
    """Return a plot of a measure with a column for each group, or None if no clip has the measure.

    `name` is the column of the measure in both tables, and `pages` has the address of each clip's page.
    """
    if not clips[name].notna().any():
        return None
    clip_rows, group_rows = clips.to_dict("records"), groups.to_dict("records")
    ends = [x for row in (*clip_rows, *group_rows) for x in value_with_interval(row, name) if math.isfinite(x)]
    ticks = _ticks(min(ends), max(ends))
    scale = _Scale(min(ticks[0], min(ends)), max(ticks[-1], max(ends)))
    width = max(WIDTH, LEFT + RIGHT + GROUP_WIDTH * len(group_rows))
    step = (width - LEFT - RIGHT) / len(group_rows)
    columns, dots_by_animal = [], dict[str, list[tuple[float, float]]]()
    for place, group_row in enumerate(group_rows):
        middle = LEFT + step * (place + 0.5)
        rows = sorted((row for row in clip_rows if row["group"] == group_row["group"]), key=lambda row: row["clip"])
        rows = [row for row in rows if math.isfinite(row[name])]
        reach = min(0.3 * step, 6.0 * len(rows))
        positions = np.linspace(middle - reach, middle + reach, len(rows) + 2)[1:-1]
        for x, row in zip(positions, rows, strict=True):
            if not pd.isna(animal := row.get("animal", math.nan)):
                dots_by_animal.setdefault(str(animal), []).append((float(x), scale.height(float(row[name]))))
        columns.append(
            {
                "hue": HUES[place % len(HUES)],
                "dots": [_dot(row, name, float(x), scale, pages) for x, row in zip(positions, rows, strict=True)],
                **_mean_of_group(group_row, name, scale, len(rows)),
                "left": round(middle - 0.42 * step, 1),
                "width": round(0.84 * step, 1),
                "middle": round(middle, 1),
                "label": _label(str(group_row["group"])),
                "count": len(rows),
            }
        )
    pairs = [points for points in dots_by_animal.values() if len(points) > 1]
    spoken = [
        f"{row['group']}: {' '.join(_text(*value_with_interval(row, name))) or 'not known'}" for row in group_rows
    ]
    return {
        "title": title,
        "width": round(width),
        "height": round(HEIGHT),
        "floor": HEIGHT - BOTTOM,
        "left": LEFT,
        "right": width - RIGHT,
        "ticks": [(scale.height(value), f"{value:.6g}") for value in ticks],
        "columns": columns,
        "pairs": [" ".join(f"{x:.1f},{y}" for x, y in points) for points in pairs],
        "spoken": "; ".join(spoken),
    }


@dataclass(frozen=True)
class _Scale:
    """Vertical axis of a plot, defined by the values at its lower and upper end."""

    low: float
    high: float

    def height(self, value: float) -> float:
        """Return the distance of a value from the top of the plot in pixels."""
        return round(TOP + (HEIGHT - TOP - BOTTOM) * (self.high - value) / (self.high - self.low), 1)


def _dot(row: Mapping[Any, Any], name: str, x: float, scale: _Scale, pages: Mapping[str, str]) -> dict[str, Any]:
    """Return the dot of a clip at x px, with the ends of its interval if they are known."""
    value, low, high = value_with_interval(row, name)
    clip = str(row["clip"])
    return {
        "x": round(x, 1),
        "y": scale.height(value),
        "ends": [scale.height(low), scale.height(high)] if math.isfinite(low) else [],
        "clip": clip,
        "label": f"{clip}: {' '.join(_text(value, low, high))}",
        "page": pages.get(clip),
        "hollow": row["verdict"] != "use",
    }


def _mean_of_group(row: Mapping[Any, Any], name: str, scale: _Scale, clips: int) -> dict[str, Any]:
    """Return the mean of a group and its band, without a band for a single clip."""
    mean, low, high = value_with_interval(row, name)
    return {
        "mean": scale.height(mean) if math.isfinite(mean) and clips > 1 else None,
        "band": [scale.height(high), scale.height(low)] if math.isfinite(low) and clips > 1 else [],
    }


def _ticks(low: float, high: float) -> list[float]:
    """Return three to six round values that cover an interval."""
    span = max(high - low, 1e-6 * max(abs(low), abs(high), 1e-6))
    power = 10.0 ** math.floor(math.log10(span / 4))
    step = next(power * factor for factor in (1, 2, 2.5, 5, 10) if span / (power * factor) <= 4.5)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [step * number for number in range(first, max(last, first + 1) + 1)]


def _label(group: str) -> list[str]:
    """Return a group's name split into a few short lines, for the label of a plot."""
    lines = wrap(group, LABEL_CHARACTERS) or [""]
    return lines if len(lines) <= LABEL_LINES else [*lines[: LABEL_LINES - 1], lines[LABEL_LINES - 1][:-1] + "…"]
